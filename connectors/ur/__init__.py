"""A UR arm: its motion over RTDE, and its control."""
