"""Export of sessions to LeRobot and MCAP."""
