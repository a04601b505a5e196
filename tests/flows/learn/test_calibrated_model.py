import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.graph.loading import load as load_flow
from flows.learn.alarm_calibration import Calibrated, TooLittleDataError, calibrate_model
from flows.learn.event_metrics import EventMetrics, debounce_settings
from flows.learn.labelled_recordings import load
from flows.learn.training.trained_model import learned, provenance
from operators import Debounce, minute
from operators.errors import InputError
from storage import load_debounce, load_detector
from storage.models import load_card, save_card, shipped_path


def model(folder: Path) -> Path:
    """Copy the shipped tcn and its card."""
    for suffix in (".safetensors", ".json"):
        shutil.copy(shipped_path("tcn").with_suffix(suffix), folder)
    return folder / "tcn.safetensors"


def test_the_card_records_setting_rate_confidence_and_data(tiny: Path, tmp_path: Path) -> None:
    path = model(tmp_path)
    before = load_card(path)
    _, found = calibrate_model(str(path), [tiny], 12.0, 0.9)
    card = load_card(path)
    assert {name: value for name, value in card.items() if name not in {"alarms", "check"}} == {
        name: value for name, value in before.items() if name != "check"
    }
    [entry] = card["alarms"]
    assert (entry["false_alarms_per_min"], entry["confidence"]) == (12.0, 0.9)
    assert 0 < entry["bound_per_min"] <= 12
    assert entry["static_minutes"] > 0.5
    assert entry["data"] == provenance(load(tiny))
    assert f"{found.debounce.threshold:g}" in found.report(path)
    assert load_detector(path).name == "tcn"


def test_a_flow_uses_the_setting_of_its_rate_and_refuses_others(tiny: Path, tmp_path: Path) -> None:
    path = model(tmp_path)
    for rate in (12.0, 30.0):
        _, found = calibrate_model(str(path), [tiny], rate, 0.95)
        assert load_debounce(path, rate / minute) == found.debounce
    _, again = calibrate_model(str(path), [tiny], 12.0, 0.8)
    assert [each["false_alarms_per_min"] for each in load_card(path)["alarms"]] == [12.0, 30.0]
    assert load_debounce(path, 12 / minute) == again.debounce
    flow = load_flow("live").flow({"detector": str(path), "false_alarms": "12/min"})
    [debounce] = [node.part for node in flow.nodes if isinstance(node.part, Debounce)]
    assert debounce == again.debounce
    with pytest.raises(
        InputError, match=r"calibrated for 12/min, 30/min only; run `slipflow calibrate .* 1/min`"
    ):
        load_debounce(path, 1 / minute)
    with pytest.raises(InputError, match="tcn: is not calibrated; run `slipflow calibrate tcn --on SESSIONS"):
        load_flow("relabel").flow({"false_alarms": "6/h"})


def test_the_rate_that_the_report_states_is_that_of_the_card(tmp_path: Path) -> None:
    path, per_hour, none = model(tmp_path), round(1 / 60, 9), EventMetrics(np.empty(0), 0, 0, 0, 200.0)
    entry = {"false_alarms_per_min": per_hour, "debounce": debounce_settings(Debounce(0.7))}
    save_card(path, {**load_card(path), "alarms": [entry]})
    report = Calibrated(per_hour, 0.95, Debounce(0.7), 0.015, none).report(path)
    stated = report.partition("--set false_alarms=")[2].partition("/min")[0]
    assert load_debounce(path, float(stated) / minute) == Debounce(0.7)


def test_a_damaged_entry_is_reported(tmp_path: Path) -> None:
    path = model(tmp_path)
    for damage in ([{"false_alarms_per_min": 1}], [3], 3):
        save_card(path, {**load_card(path), "alarms": damage})
        for use in (lambda: load_debounce(path, 1 / minute), lambda: calibrate_model(str(path), [], 1, 0.9)):
            with pytest.raises(InputError, match="remove them, then calibrate it again"):
                use()


@pytest.mark.parametrize(("missed", "text"), [(0, "; no slips\n"), (2, "; 100.0 % of slips missed\n")])
def test_the_report_has_no_delay_without_detected_slips(missed: int, text: str) -> None:
    events = EventMetrics(np.empty(0), missed, false_alarms=0, repeats=0, minutes=9.0)
    assert text in Calibrated(1.0, 0.95, Debounce(), 0.5, events).report(Path("m"))


def test_recordings_that_the_model_has_learned_from_are_left_out(tiny: Path, tmp_path: Path) -> None:
    path, recordings, notes = model(tmp_path), load(tiny), list[str]()
    known = [each for each in recordings if each.split != "test"]
    save_card(path, {**load_card(path), "data": provenance(recordings)})
    calibrate_model(str(path), [tiny], 40.0, 0.8, log=notes.append)
    assert load_card(path)["alarms"][0]["data"][0]["recordings"] == {"test": len(recordings) - len(known)}
    assert f"left out {len(known)} recordings: {path} has learned from them" in notes
    with pytest.raises(InputError, match="no recordings are left"):
        calibrate_model(str(path), [tiny / "sessions" / known[0].name], 40.0, 0.8)


def test_a_recording_that_a_model_has_learned_from_is_known_wherever_it_lies(
    tiny: Path, tmp_path: Path
) -> None:
    one, other = sorted((tiny / "sessions").iterdir())[:2]
    copied = shutil.copytree(one, tmp_path / "sessions" / "copy")
    shutil.copytree(other, tmp_path / "sessions" / "other")  # added later
    card = {"data": provenance([replace(each, split="train") for each in load(one)])}
    assert learned(card, load(one))
    assert learned(card, load(copied))
    assert {each.name for each in learned(card, load(tmp_path))} == {each.name for each in load(copied)}


def test_repeated_recordings_are_refused(tiny: Path, tmp_path: Path) -> None:
    path, name = model(tmp_path), load(tiny)[0].name
    before = load_card(path)
    copied = shutil.copytree(tiny / "sessions" / name, tmp_path / "again")
    for paths in ([tiny, tiny], [tiny, tiny / "sessions" / name], [tiny, copied]):
        with pytest.raises(InputError, match=r"is the same recording as .*: give each recording once"):
            calibrate_model(str(path), paths, 12.0, 0.95)
    assert load_card(path) == before


def test_a_shipped_model_is_copied_and_a_failure_writes_nothing(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TooLittleDataError, match=r"record .* more static minutes"):
        calibrate_model("tcn", [tiny], 0.1, 0.95)
    with pytest.raises(InputError, match="has no weights"):
        calibrate_model("psd", [tiny], 12.0, 0.95)
    assert list(tmp_path.iterdir()) == []
    assert calibrate_model("tcn", [tiny], 12.0, 0.95)[0] == Path("tcn.safetensors")
    with pytest.raises(InputError, match="exists: calibrate it, or delete it"):
        calibrate_model("tcn", [tiny], 20.0, 0.95)
    assert load_detector("tcn.safetensors").name == "tcn"
