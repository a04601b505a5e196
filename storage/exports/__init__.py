"""Sessions as files of other tools: LeRobot, MCAP, Rerun."""
