"""Export of sessions to LeRobot, MCAP and Rerun."""
