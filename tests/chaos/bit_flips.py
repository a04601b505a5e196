"""One bit of a file flips: nobody reads a wrong value without being told."""

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
OTHERS = "silently wrong: Arrow IPC 666 and 2 crashes, plain Parquet 908"


def flips(scale: Scale) -> Promise:
    """Flip bits of everything that a session and a model are made of."""
    random = np.random.default_rng(scale.seed)
    count = 100 if scale.short else 1000
    came = Counter[str]()
    worst = ""
    with scratch(memory=True) as folder:
        targets = _targets(folder)
        for turn in range(count):
            name, pattern, look = targets[turn % len(targets)]
            place = folder / "flipped"
            copytree(folder / name, place)
            path, bit = _flip(random, place, pattern)
            outcome = look(place)
            came[outcome] += 1
            if outcome == WRONG:
                worst = worst or f"; the first: bit {bit} of {name}'s {path}"
            rmtree(place)
    return Promise(
        f"bit flips x{count}: journal, parts (listed or not), manifest, session.json, model, card",
        f"{came[WRONG]} silently wrong; {came[REFUSED]} refused, {came[FEWER]} fewer rows and said so,"
        f" {came[RIGHT]} right{worst}",
        "0 silently wrong",
        kept=not came[WRONG],
        others=OTHERS,
    )


RIGHT, FEWER, REFUSED, WRONG = "right", "fewer", "refused", "wrong"


def _targets(folder: Path) -> list[tuple[str, str, Callable[[Path], str]]]:
    """Folders, what in them is flipped, and how what is read of them is judged."""
    writer = begin(folder / "data", part_rows=PART)
    for number in range(ROWS):
        write(writer, number)
    copytree(writer.folder, folder / "killed")
    writer.close()
    copytree(writer.folder, folder / "closed")
    copytree(writer.folder, folder / "unlisted")
    (folder / "unlisted/MANIFEST.json").unlink()
    model = shipped(MODEL)
    assert model, "it ships"
    (folder / "model").mkdir()
    for path in (model, model.with_suffix(".json")):
        (folder / "model" / path.name).write_bytes(path.read_bytes())

    def judge(name: str) -> Callable[[Path], str]:
        copytree(folder / name, folder / "whole")
        whole = read(folder / "whole")
        rmtree(folder / "whole")
        return lambda place: _judge_session(place, whole)

    weights = _model(folder / "model")

    def judge_model(place: Path) -> str:
        try:
            found = _model(place)
        except SlipflowError:
            return REFUSED
        return RIGHT if found == weights else WRONG

    killed, closed, unlisted = judge("killed"), judge("closed"), judge("unlisted")
    return [
        ("killed", "journal/*.wal", killed),
        ("killed", "session.json", killed),
        ("killed", "*/*.parquet", killed),
        ("killed", "MANIFEST.json", killed),
        ("closed", "**/*.parquet", closed),
        ("closed", "MANIFEST.json", closed),
        ("closed", "session.json", closed),
        ("unlisted", "**/*.parquet", unlisted),
        ("model", "*.safetensors", judge_model),
        ("model", "*.json", judge_model),
    ]


def _flip(random: np.random.Generator, place: Path, pattern: str) -> tuple[str, int]:
    paths = sorted(place.glob(pattern))
    path = paths[random.integers(len(paths))]
    data = bytearray(path.read_bytes())
    bit = int(random.integers(8 * len(data)))
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    return path.relative_to(place).as_posix(), bit


def _judge_session(place: Path, whole: Contents) -> str:
    try:
        found = read(place)
    except SlipflowError:
        return REFUSED
    if found.same(whole):
        return RIGHT
    return FEWER if found.lost and found.first_of(whole) else WRONG


def _model(folder: Path) -> Any:  # noqa: ANN401 - it is only compared
    """All that is read of a model."""
    path = folder / f"{MODEL}.safetensors"
    load_detector(path)
    weights, about = load_weights(path)
    arrays = {name: (array.dtype, array.shape, array.tobytes()) for name, array in weights.items()}
    return arrays, about, load_card(path), load_debounce(path)


PROMISES = (flips,)
