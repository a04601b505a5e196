"""A Robotiq 3-finger gripper over Modbus TCP."""
