"""`slipflow export`; docs/how-to/lerobot.md, which the tests run, shows the export for LeRobot."""

from pathlib import Path
from shutil import copytree

import pytest

from operators.batch import Touch
from storage.files import put_checked, read_checked
from tests.command import error, slipflow, succeed
from tests.storage.made import new_batch, record, session_names


def test_a_dataset_becomes_a_file_per_session_or_one_session_one_file(tiny: Path, tmp_path: Path) -> None:
    done = succeed("export", str(tiny), "out", "--to", "mcap", cwd=tmp_path)
    names = session_names(tiny)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{name}.mcap" for name in names}
    assert done.stdout.startswith("12 files, ")
    session = tiny / "sessions" / names[0]
    one = slipflow("export", str(session), "one.mcap", "--to", "mcap", cwd=tmp_path)
    assert one.stdout.endswith("rows\nwrote one.mcap\n")
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "out" / f"{names[0]}.mcap").read_bytes()


@pytest.mark.parametrize("path", ["data", "data/sessions/one"])
def test_a_name_in_session_json_leads_out_of_no_folder(tiny: Path, tmp_path: Path, path: str) -> None:
    copy = copytree(min((tiny / "sessions").iterdir()), tmp_path / "data" / "sessions" / "one")
    (copy.parent.parent / "dataset.json").write_bytes((tiny / "dataset.json").read_bytes())
    put_checked(copy / "session.json", {**read_checked(copy / "session.json"), "session": "../../evil"})
    (copy / "MANIFEST.json").write_text(
        (copy / "MANIFEST.json").read_text().replace(min(session_names(tiny)), "../../evil")
    )
    succeed("export", tmp_path / path, "deep/out", "--to", "mcap", cwd=tmp_path)
    assert [each.relative_to(tmp_path).as_posix() for each in tmp_path.rglob("*.mcap")] == [
        "deep/out/one.mcap"
    ]


def test_a_session_without_samples_is_left_out_of_a_lerobot_dataset(tiny: Path, tmp_path: Path) -> None:
    data = copytree(tiny, tmp_path / "data")
    live = record(data, [new_batch(Touch)], "live")
    done = succeed("export", data, "out", "--to", "lerobot", cwd=tmp_path)
    assert done.stderr == "without samples, so left out: live\n"
    assert done.stdout.startswith("12 episodes ")
    assert "has no samples" in error("export", live.folder, "other", "--to", "lerobot", cwd=tmp_path)
