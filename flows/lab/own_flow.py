"""Flow file of a user's own: it follows a growing file with the map of an import, and detects slip."""

from pathlib import Path
from string import Template
from typing import Final

from connectors.files.column_map import ColumnMap
from operators.errors import EndpointError, ParameterError, os_error_reason

_FLOW: Final = Template('''"""Detect slip live in a file that grows, such as $source."""

from pathlib import Path

from connectors import Console, LineSource
from flows.graph import Flow
from operators import Debounce, Score, Zero
from storage import Dataset, load_debounce, load_detector

HERE = Path(__file__).parent


def $name(source: str = "$source", model: str = "$name.safetensors", out: str = "live") -> Flow:
    """Print slip events of a file that grows, or of a serial port, and record the touch.

    Args:
        source: The file, or a device such as /dev/ttyACM0.
        model: Detector, as `slipflow train` writes it.
        out: Dataset to record into.
    """
    flow = Flow("$name")
    touch = flow.source(LineSource(source, HERE / "$name.toml"))
    slips = touch | Zero() | Score(load_detector(model)) | (load_debounce(model) or Debounce())
    slips.to(Console())
    touch.to(Dataset(out))
    return flow
''')


def write_flow(path: Path, source: Path, columns: ColumnMap) -> Path:
    """Write a flow file and, next to it, the map; return the path of the map.

    Args:
        path: The flow file; its name is that of the flow.
        source: File that the flow follows by default.
        columns: Complete map.

    Raises:
        ParameterError: if the name is no name of a function in Python, or the file exists.
        EndpointError: if a file cannot be written.
    """
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise ParameterError("import", "--flow", str(path), "a new Python file such as own.py")
    toml = path.with_suffix(".toml")
    try:
        for file, text in ((path, _FLOW.substitute(name=path.stem, source=source)), (toml, columns.toml())):
            with file.open("x", encoding="utf-8") as opened:
                opened.write(text)
    except OSError as error:
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from None
    return toml
