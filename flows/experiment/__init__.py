"""The paper's robot experiments on the simulated scene, closed loop: `slipflow experiment tap|lift|learn`."""
