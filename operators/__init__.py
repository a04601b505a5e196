"""Operators over typed batches: pure functions with state; no I/O, no clock, no event loop."""

from operators.align import Align
from operators.batch import (
    BAROMETERS,
    EVERY,
    SLIP,
    STATIC,
    UNKNOWN,
    Batch,
    Clocks,
    Commands,
    Episodes,
    Faults,
    Labelled,
    Motion,
    Sample,
    Scores,
    Slips,
    Touch,
    Truth,
    Windows,
    Zeroed,
    concat,
    minute,
    ms,
    s,
    us,
)
from operators.debounce import Debounce
from operators.device_clock import DeviceClock, WatchClock
from operators.errors import (
    BatchError,
    EndpointError,
    FingertipError,
    FlowError,
    InputError,
    OperatorError,
    OutputClosedError,
    ParameterError,
    SlipflowError,
    os_error_reason,
)
from operators.fingertip import TAKKTILE, Fingertip
from operators.follow import Follow
from operators.grip import Grip, GripController, StepGrip
from operators.health import FaultKind, Health
from operators.label import Label
from operators.mask_lifted import MaskLifted
from operators.operator import Join, Operator
from operators.pool import Pool
from operators.ports import (
    Clock,
    ClockStep,
    Finding,
    Gap,
    Recording,
    Run,
    Sink,
    SinkStatus,
    Source,
    SourceStatus,
)
from operators.resample import Resample
from operators.score import Score
from operators.sliding_motion import SlidingMotion
from operators.window import Window
from operators.zero import Zero

__all__ = [
    "BAROMETERS",
    "EVERY",
    "SLIP",
    "STATIC",
    "TAKKTILE",
    "UNKNOWN",
    "Align",
    "Batch",
    "BatchError",
    "Clock",
    "ClockStep",
    "Clocks",
    "Commands",
    "Debounce",
    "DeviceClock",
    "EndpointError",
    "Episodes",
    "FaultKind",
    "Faults",
    "Finding",
    "Fingertip",
    "FingertipError",
    "FlowError",
    "Follow",
    "Gap",
    "Grip",
    "GripController",
    "Health",
    "InputError",
    "Join",
    "Label",
    "Labelled",
    "MaskLifted",
    "Motion",
    "Operator",
    "OperatorError",
    "OutputClosedError",
    "ParameterError",
    "Pool",
    "Recording",
    "Resample",
    "Run",
    "Sample",
    "Score",
    "Scores",
    "Sink",
    "SinkStatus",
    "SlidingMotion",
    "SlipflowError",
    "Slips",
    "Source",
    "SourceStatus",
    "StepGrip",
    "Touch",
    "Truth",
    "WatchClock",
    "Window",
    "Windows",
    "Zero",
    "Zeroed",
    "concat",
    "minute",
    "ms",
    "os_error_reason",
    "s",
    "us",
]
