"""Examples that the help of each command ends with."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

# by command
EXAMPLES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "run": (
            "slipflow run live --for 30s --page",
            "slipflow run record --set out=lab --set delay=70ms",
            "slipflow run live --replay recordings --json",
            "slipflow run felt.py:gentle --replay trace.csv --pace 1",
        ),
        "check": ("slipflow check record --set delay=70ms", "slipflow check felt.py:gentle"),
        "graph": ("slipflow graph record", "slipflow graph felt.py --mermaid > felt.mmd"),
        "demo": ("slipflow demo --for 1min", "slipflow demo --mqtt mqtt://localhost --rig left --no-page"),
        "train": (
            "slipflow train recordings -o mine.safetensors",
            "slipflow train lab simulated --filters 32 --lag 70ms --curve curve.svg",
        ),
        "evaluate": ("slipflow evaluate recordings --model mine.safetensors --method psd --out judged",),
        "chart": ("slipflow chart recordings --model mine.safetensors",),
        "stress": ("slipflow stress --method tcn --method psd --jobs 2",),
        "onnx": ("slipflow onnx mine.safetensors mine.onnx",),
        "verify": (
            "slipflow verify recordings -o report.html",
            "slipflow verify recordings/sessions/stroke-9 --json",
        ),
        "recover": ("slipflow recover recordings",),
        "collect": (
            "slipflow collect tiny --dry-run --robot 10.0.0.2",
            "slipflow collect tiny --virtual --out lab",
            "slipflow collect paper --robot 10.0.0.2 --force 2N --speeds 0.01,0.02",
            "slipflow collect tiny --robot 10.0.0.2 --surface sphere:60mm@0.4,0,0.1,3.1416,0,0",
        ),
        "rig": ("slipflow rig", "slipflow rig --surface sphere --gripper -1 --for 5min"),
        "export": (
            "slipflow export recordings lerobot --to lerobot --rate 50",
            "slipflow export recordings/sessions/stroke-9 stroke.mcap --to mcap",
        ),
        "show": ("slipflow show recordings/sessions/stroke-9 --detector psd",),
        "simulate": (
            "slipflow simulate recordings --plan tiny --seed 1",
            "slipflow simulate late --delay 70ms --jobs 2",
            "slipflow simulate --report scene",
        ),
        "watch": (
            "slipflow watch mqtt://localhost --site lab",
            "slipflow watch mqtts://broker --since start --json",
        ),
        "import": (
            "slipflow import trace.csv recordings --dry-run",
            "slipflow import trace.csv lab --map time=t,counts=p0..p5,speed=v --units time=ms,speed=mm/s",
        ),
        "tap": ("slipflow experiment tap --method tcn --object ball --trials 5",),
        "lift": (
            "slipflow experiment lift --object ball --trials 5",
            "slipflow experiment lift --method tcn --rule steps --delay 50ms",
            "slipflow experiment lift --ablation --method psd --trials 10",
        ),
        "learn": ("slipflow experiment learn -o mine.safetensors",),
    }
)


def examples(command: str) -> str:
    """The end of a command's help.

    >>> examples("recover").splitlines()[1:]
    ['Examples:', '  slipflow recover recordings']
    """
    lines = "\n  ".join(EXAMPLES[command])
    return f"\b\nExamples:\n  {lines}"  # after \b lines stay as they are
