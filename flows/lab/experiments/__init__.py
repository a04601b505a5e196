"""The paper's closed-loop robot experiments in simulation."""
