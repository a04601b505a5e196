"""An environment for each engine, made on demand and kept: they need not go together, nor with ours."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[3]
NUMPY: Final = "numpy==2.4.6"
PINS: Final = {  # the newest of November 2026
    "slipflow": (),  # ours
    "plain": (NUMPY,),
    "csp": (NUMPY, "csp==0.19.1"),
    "bytewax": (NUMPY, "bytewax==0.21.1"),
}


class PeerError(Exception):
    """An engine that could not be installed, or whose program failed; the table says so."""


def python_of(name: str) -> str:
    """The Python of an engine's environment, made if need be.

    Raises:
        PeerError: if it cannot be installed.
    """
    if not PINS[name]:
        return sys.executable
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    place, pins = cache / "slipflow-bench" / name, "\n".join((sys.version, *PINS[name]))
    python, stamp = place / "bin" / "python", place / "pins"
    if not stamp.exists() or stamp.read_text() != pins:
        print(f"installing {' '.join(PINS[name])} into {place}", file=sys.stderr)
        _run([sys.executable, "-m", "venv", "--clear", str(place)])
        _run([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PINS[name]])
        stamp.write_text(pins)
    return str(python)


def carry_out(name: str, module: str, *arguments: str, limit: float) -> None:
    """Run an engine's program, for `limit` seconds at most.

    Raises:
        PeerError: if it cannot be installed, fails, or takes longer.
    """
    _run([python_of(name), "-m", f"tests.benchmarks.peers.{module}", *arguments], limit)


def _run(command: list[str], limit: float = 900.0) -> None:
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        raise PeerError(f"took longer than {limit:.0f} s") from None
    except OSError as error:
        raise PeerError(str(error)) from error
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
        raise PeerError(said[-1])
