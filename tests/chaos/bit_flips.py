"""Bit flips: a flipped bit of a file causes an error or a warning, never a wrong value."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import numpy as np

from operators import SlipflowError
from storage import load_debounce, load_detector, load_weights
from storage.models import load_card, shipped
from tests.chaos.processes import scratch
from tests.chaos.promise import Promise
from tests.chaos.scale import Scale
from tests.chaos.session import Contents, begin, read, write

ROWS, PART = 60, 25  # of each stream; of a part
MODEL = "tcn"
OTHERS = "silent errors: Arrow IPC 666 and 2 crashes, plain Parquet 908"


def flips(scale: Scale) -> Promise:
    """Flip bits in each kind of file of a session and of a model."""
    random = np.random.default_rng(scale.seed)
    count = 100 if scale.short else 1600
    outcomes = Counter[str]()
    first_wrong = ""
    with scratch(memory=True) as folder:
        targets = _targets(folder)
        for turn in range(count):
            name, pattern, check = targets[turn % len(targets)]
            copy = folder / "flipped"
            copytree(folder / name, copy)
            path, bit = _flip(random, copy, pattern)
            outcome = check(copy)
            outcomes[outcome] += 1
            if outcome == WRONG:
                first_wrong = first_wrong or f"; the first: bit {bit} of {path} in {name}"
            rmtree(copy)
    return Promise(
        f"bit flips x{count}: journal, parts, manifest, session.json, model, card",
        f"{outcomes[WRONG]} silent errors; {outcomes[REFUSED]} refused, {outcomes[FEWER]} with fewer rows"
        f" and a message, {outcomes[RIGHT]} correct{first_wrong}",
        "0 silent errors",
        passed=not outcomes[WRONG],
        others=OTHERS,
    )


RIGHT, FEWER, REFUSED, WRONG = "right", "fewer", "refused", "wrong"


def _targets(folder: Path) -> list[tuple[str, str, Callable[[Path], str]]]:
    """Return folders, patterns of the files to flip, and functions that check what is read afterwards."""
    writer = begin(folder / "data", part_rows=PART)
    for number in range(ROWS):
        write(writer, number)
    copytree(writer.folder, folder / "killed")
    writer.close()
    copytree(writer.folder, folder / "closed")
    model = shipped(MODEL)
    assert model, "the model is part of the package"
    (folder / "model").mkdir()
    for path in (model, model.with_suffix(".json")):
        (folder / "model" / path.name).write_bytes(path.read_bytes())

    def checker(name: str) -> Callable[[Path], str]:
        copytree(folder / name, folder / "whole")
        whole = read(folder / "whole")
        rmtree(folder / "whole")
        return lambda copy: _check_session(copy, whole)

    weights = _model(folder / "model")

    def check_model(copy: Path) -> str:
        try:
            found = _model(copy)
        except SlipflowError:
            return REFUSED
        return RIGHT if found == weights else WRONG

    killed, closed = checker("killed"), checker("closed")
    return [
        ("killed", "journal/*.wal", killed),
        ("killed", "session.json", killed),
        ("killed", "*/*.parquet", killed),
        ("killed", "MANIFEST.json", killed),
        ("closed", "**/*.parquet", closed),
        ("closed", "MANIFEST.json", closed),
        ("closed", "session.json", closed),
        ("model", "*.safetensors", check_model),
        ("model", "*.json", check_model),
    ]


def _flip(random: np.random.Generator, copy: Path, pattern: str) -> tuple[str, int]:
    paths = sorted(copy.glob(pattern))
    path = paths[random.integers(len(paths))]
    data = bytearray(path.read_bytes())
    bit = int(random.integers(8 * len(data)))
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    return path.relative_to(copy).as_posix(), bit


def _check_session(copy: Path, whole: Contents) -> str:
    try:
        found = read(copy)
    except SlipflowError:
        return REFUSED
    if found.same(whole):
        return RIGHT
    return FEWER if found.lost and found.first_of(whole) else WRONG


def _model(folder: Path) -> Any:  # noqa: ANN401 - only compared
    """Return all that is read from a model."""
    path = folder / f"{MODEL}.safetensors"
    load_detector(path)
    weights, about = load_weights(path)
    arrays = {name: (array.dtype, array.shape, array.tobytes()) for name, array in weights.items()}
    return arrays, about, load_card(path), load_debounce(path)


PROMISES = (flips,)
