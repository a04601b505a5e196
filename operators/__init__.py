"""Pure operators over typed batches: no I/O, no clock, no event loop."""

from operators.align import Align
from operators.batch import (
    BAROMETERS,
    EVERY,
    SLIP,
    STATIC,
    UNKNOWN,
    Batch,
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
from operators.errors import (
    BatchError,
    EndpointError,
    FlowError,
    InputError,
    OperatorError,
    ParameterError,
    SlipflowError,
)
from operators.health import FaultKind, Health
from operators.label import Label
from operators.operator import Join, Operator
from operators.ports import (
    Clock,
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
    "Debounce",
    "EndpointError",
    "FaultKind",
    "Faults",
    "FlowError",
    "Gap",
    "Health",
    "InputError",
    "Join",
    "Label",
    "Labelled",
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
    "Touch",
    "Window",
    "Windows",
    "Zero",
    "Zeroed",
    "concat",
    "ms",
    "s",
    "us",
]
