import json
from dataclasses import replace
from pathlib import Path

import pytest

from operators import Labelled, Touch, Zeroed, concat, ms
from operators.errors import InputError, ParameterError
from operators.fingertip import TAKKTILE, Fingertip, grid
from storage import Session
from storage.exports.mcap_file import message_schema
from storage.layout import SESSION, TOUCH
from storage.verification import verify
from tests.storage.made import leave, new_batch, new_run, same, write

PAD = Fingertip(grid(16), 1000.0, "kPa", 0.01, (0, 4000))
BATCHES = [new_batch(Touch, 5, start=turn * 50 * ms, seed=turn, cells=16) for turn in range(5)]


@pytest.mark.parametrize("cells", [1, 6, 16, 64, 128])
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "killed"])
def test_rows_of_any_number_of_cells_are_read_back_bit_for_bit(
    tmp_path: Path, cells: int, *, closed: bool
) -> None:
    touch = [new_batch(Zeroed, 5, start=turn * 50 * ms, seed=turn, cells=cells) for turn in range(5)]
    samples = [new_batch(Labelled, 5, start=turn * 50 * ms, seed=turn, cells=3) for turn in range(5)]
    batches = [each for pair in zip(touch, samples, strict=True) for each in pair]
    if closed:
        write(tmp_path, new_run(), batches).close()
    else:
        leave(tmp_path, new_run(), batches)
    session = Session.open(tmp_path)
    same(concat(Zeroed, list(session.read(Zeroed, 0))), concat(Zeroed, touch))
    found = concat(Labelled, list(session.read(Labelled, 0)))
    assert found.counts.tobytes() == concat(Labelled, samples).counts.tobytes()
    assert (found.cells, found.temperature.shape) == (3, found.counts.shape)
    assert len(session.frame("touch")) == 25
    assert verify(tmp_path).worst == ("note" if closed else "repaired")


def test_a_session_has_one_number_of_cells_per_table(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cells of a Touch is 6, must be 16, as in the previous rows"):
        write(tmp_path, new_run(), [BATCHES[0], new_batch(Touch, 1, start=60 * ms)])


def test_a_session_states_its_fingertip_or_it_is_measured(tmp_path: Path) -> None:
    run = new_run()
    run.fingertips = {str(tmp_path): {Touch: PAD}}
    write(tmp_path, run, BATCHES).close()
    session = Session.open(tmp_path)
    assert session.fingertip(Touch) == session.fingertip(Zeroed) == PAD
    assert session.fingertip(Labelled) is None
    about = {key: value for key, value in session.about.items() if key != "fingertips"}
    measured = replace(session, about=about).fingertip(Touch)
    assert measured is not None
    assert (measured.cells, measured.rate) == (16, 100.0)
    wrong = replace(session, about={**about, "fingertips": {"touch": {**TAKKTILE.describe(), "unit": ""}}})
    with pytest.raises(InputError, match=rf"{SESSION}: has an invalid"):
        wrong.fingertip(Touch)


def test_messages_of_an_export_have_as_many_counts_as_cells() -> None:
    counts = message_schema(TOUCH, Touch, 16)["properties"]["counts"]
    assert (counts["minItems"], counts["maxItems"]) == (16, 16)
    assert json.dumps(counts)
