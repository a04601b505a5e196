"""Pure operators over typed batches: no I/O, no clock, no event loop."""

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
    Faults,
    Labelled,
    Motion,
    Sample,
    Scores,
    Slips,
    Touch,
    Windows,
    Zeroed,
    concat,
    ms,
    s,
    us,
)
from operators.debounce import Debounce
from operators.device_clock import DeviceClock, WatchClock, fit_clock
from operators.errors import (
    BatchError,
    EndpointError,
    FlowError,
    InputError,
    OperatorError,
    ParameterError,
    SlipflowError,
)
from operators.grip import Grip, Gripping, StepGrip
from operators.health import FaultKind, Health
from operators.label import Label
from operators.lifted import Lifted
from operators.operator import Join, Operator
from operators.ports import (
    Clock,
    ClockStep,
    Gap,
    Recording,
    Run,
    Sink,
    SinkStatus,
    Source,
    SourceStatus,
)
from operators.score import Score
from operators.window import Window
from operators.zero import Zero

__all__ = [
    "BAROMETERS",
    "EVERY",
    "SLIP",
    "STATIC",
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
    "FaultKind",
    "Faults",
    "FlowError",
    "Gap",
    "Grip",
    "Gripping",
    "Health",
    "InputError",
    "Join",
    "Label",
    "Labelled",
    "Lifted",
    "Motion",
    "Operator",
    "OperatorError",
    "ParameterError",
    "Recording",
    "Run",
    "Sample",
    "Score",
    "Scores",
    "Sink",
    "SinkStatus",
    "SlipflowError",
    "Slips",
    "Source",
    "SourceStatus",
    "StepGrip",
    "Touch",
    "WatchClock",
    "Window",
    "Windows",
    "Zero",
    "Zeroed",
    "concat",
    "fit_clock",
    "ms",
    "s",
    "us",
]
