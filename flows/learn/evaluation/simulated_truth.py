"""What truly happened in a simulated recording: played again from what its session says of the scene."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from connectors.sim.paper_plan import Recording
from connectors.sim.physics_parameters import Parameters
from connectors.sim.scene import Faults, Scene, Timing, Vibration
from flows.learn.labelled_recordings import LabelledRecording, simulated_recording
from operators.errors import SlipflowError
from operators.ports import Json
from storage import Session
from storage.layout import session_folder

_PARTS: Final[Mapping[str, type[Any]]] = {
    "plan": Recording,
    "vibration": Vibration,
    "touch": Timing,
    "motion": Timing,
    "faults": Faults,
    "parameters": Parameters,
}


def with_truth(dataset: Path, recorded: LabelledRecording) -> LabelledRecording:
    """The recording with its true sliding, where that can be had: else as it is.

    The scene is simulated again; only if that gives the very same counts is its truth believed.
    """
    try:
        about: Any = Session.open(session_folder(dataset, recorded.name)).about
        touch = about["sources"]["touch"]
        again = simulated_recording(scene(touch["scene"]), int(touch["seed"]))
    except (AttributeError, KeyError, TypeError, ValueError, SlipflowError):
        return recorded
    if again.sliding is None or not np.array_equal(again.counts, recorded.counts):
        return recorded
    return replace(recorded, sliding=again.sliding)


def scene(described: Mapping[str, Any]) -> Scene:
    """The scene of a collection plan that a session describes.

    Raises:
        ValueError: on another plan: some go on for ever.
        AttributeError, KeyError, TypeError, SlipflowError: if it is no scene.
    """
    values = _values(described)
    if set(values["plan"]) != {field.name for field in fields(Recording)}:
        raise ValueError(f"no plan of a collection has the fields {sorted(values['plan'])}")
    for key, kind in _PARTS.items():
        if values.get(key) is not None:
            values[key] = kind(**_values(values[key]))
    return Scene(**values)


def _values(described: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _tuples(value) for name, value in described.items()}


def _tuples(value: Json) -> Any:  # noqa: ANN401 - a scene's values are of many types
    """JSON has lists where a scene has tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
