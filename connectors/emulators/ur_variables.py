"""Names and types of the RTDE variables of a UR controller.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide": the variables of version 3.4, and
the later ones that ur-rtde requests.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

REGISTERS: Final = 48  # per type and direction

_BY_TYPE: Final = {
    "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum"
    " actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0"
    " standard_analog_input1 standard_analog_output0 standard_analog_output1 payload",
    "VECTOR3D": "actual_tool_accelerometer payload_cog",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current"
    " actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force"
    " target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
}

OUTPUTS: Final[Mapping[str, str]] = MappingProxyType(
    {name: kind for kind, names in _BY_TYPE.items() for name in names.split()}
    | {f"output_int_register_{i}": "INT32" for i in range(REGISTERS)}
    | {f"output_double_register_{i}": "DOUBLE" for i in range(REGISTERS)}
)
INPUTS: Final[Mapping[str, str]] = MappingProxyType(
    {f"input_int_register_{i}": "INT32" for i in range(REGISTERS)}
    | {f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)}
    | {"external_force_torque": "VECTOR6D"}
)
