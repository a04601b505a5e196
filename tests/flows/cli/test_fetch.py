from pathlib import Path

from tests.command import error, slipflow


def test_without_a_name_the_recipes_are_listed_with_size_licence_and_citation() -> None:
    done = slipflow("fetch")
    assert "grasps: Slip in a grasp while the arm moves" in done.stdout
    assert "  47 recordings, 122 MB; licence: none\n  cite: nomadik" in done.stdout


def test_errors_are_one_line(tmp_path: Path) -> None:
    assert "NAME is 'stroke', must be one of grasps, strokes" in error("fetch", "stroke", tmp_path / "out")
    assert "OUT is None, must be the folder of the new dataset" in error("fetch", "grasps")
    missing = error("fetch", "grasps", tmp_path / "out", "--from", tmp_path)
    assert f"{tmp_path} must be like a clone of https://github.com/imanlab" in missing
    assert not (tmp_path / "out").exists()
