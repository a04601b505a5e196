"""Engines take turns, each in an environment of its own, made on demand and kept."""

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

T = TypeVar("T")

ROOT: Final = Path(__file__).parents[3]
NUMPY: Final = "numpy==2.4.6"
PINS: Final = {  # the newest of November 2026
    "slipflow": (),  # ours
    "plain": (NUMPY,),
    "csp": (NUMPY, "csp==0.19.1"),
}


class Variant(NamedTuple):
    """A row of a table."""

    name: str
    peer: str  # whose environment it runs in
    module: str
    argument: str = "1"  # of the module's program


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


def try_in_turns(
    variants: Sequence[Variant], turns: int, measure: Callable[[Variant], T]
) -> tuple[dict[str, list[T]], dict[str, str]]:
    """Measure variants in turns; return the results of those that never fail, and why the others do."""
    found, failed = defaultdict[str, list[T]](list), dict[str, str]()
    for turn in range(turns):
        for variant in variants:
            if variant.name in failed:
                continue
            try:
                found[variant.name].append(measure(variant))
            except PeerError as error:
                failed[variant.name] = str(error)
                found.pop(variant.name, None)
                print(f"{variant.name}: {error}", file=sys.stderr)
        print(f"turn {turn + 1} of {turns}", file=sys.stderr)
    return found, failed


def carry_out(variant: Variant, source: Path, limit: float) -> Path:
    """Run a variant's program on an input, for `limit` seconds at most; return the file of its result.

    Raises:
        PeerError: if it cannot be installed, fails, or takes longer.
    """
    target = source.with_name("result.npz")
    target.unlink(missing_ok=True)
    command = [python_of(variant.peer), "-m", f"tests.benchmarks.peers.{variant.module}"]
    _run([*command, str(source), str(target), variant.argument], limit)
    return target


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
