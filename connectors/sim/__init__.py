"""The simulated scene: fingertips, arm, gripper and objects."""
