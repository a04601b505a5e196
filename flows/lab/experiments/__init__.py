"""The paper's robot experiments in the simulated scene, closed loop: tap and lift."""
