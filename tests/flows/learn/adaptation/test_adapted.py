from dataclasses import replace

import numpy as np
import pytest

from flows.learn.adaptation.adapted import Adapted, adapt
from flows.learn.adaptation.alignment import Alignment, aligned, best_alignment, logits
from flows.learn.labelled_recordings import LabelledRecording
from flows.learn.training.trained_model import label_scores
from operators import Score, Zeroed, ms
from operators.batch import UNKNOWN
from operators.detectors import Tcn
from operators.errors import FingertipError, InputError
from operators.fingertip import TAKKTILE
from tests.flows.learn.adaptation.conftest import Stroked

LONG = {"stroke": 1.2, "amplitude": 30.0}  # strokes of another hand, with a quarter of the gain


def unlabelled(strokes: Stroked, seed: int, **how: float) -> LabelledRecording:
    recording = strokes(seed, **how)
    return replace(recording, label=np.full_like(recording.label, UNKNOWN))


@pytest.fixture(scope="module")
def adapted(learned: Tcn, strokes: Stroked) -> Adapted:
    """Return the network adapted, without labels, to longer and weaker strokes."""
    return adapt(learned, [unlabelled(strokes, 10, **LONG)])


def test_adaptation_to_longer_and_weaker_strokes_closes_half_of_the_gap(
    learned: Tcn, strokes: Stroked, adapted: Adapted
) -> None:
    others = [strokes(seed, **LONG) for seed in range(11, 14)]
    home = label_scores(learned, [strokes(7)])["balanced"]
    before = label_scores(learned, others)["balanced"]
    after = label_scores(adapted.tcn, others)["balanced"]
    assert adapted.better
    assert after > before + (home - before) / 2
    assert adapted.alignment.time_scale > 1


def test_labels_do_not_matter_and_the_result_is_always_the_same(
    learned: Tcn, strokes: Stroked, adapted: Adapted
) -> None:
    labelled = adapt(learned, [strokes(10, **LONG)])
    for name, array in labelled.tcn.weights.items():
        np.testing.assert_array_equal(array, adapted.tcn.weights[name])
    assert (labelled.before, labelled.after) == (adapted.before, adapted.after)


def test_an_adapted_network_streams_as_it_scores_windows(
    learned: Tcn, strokes: Stroked, adapted: Adapted
) -> None:
    tcn = adapted.tcn
    assert tcn.fingertip == learned.fingertip
    counts = strokes(11, **LONG).counts[:800]
    time = np.arange(len(counts)) * 10 * ms
    scores = Score(tcn).push(Zeroed(time, counts, 0 * counts, np.ones(counts.shape, np.bool_)))
    windows = np.lib.stride_tricks.sliding_window_view(counts, tcn.length, 0).transpose(0, 2, 1)
    assert scores.probability == pytest.approx(tcn.score(windows), abs=1e-5)


def test_the_gain_of_a_sensor_is_found_and_folded(learned: Tcn, strokes: Stroked) -> None:
    recording = strokes(7)
    target = recording.label.astype(np.float64)
    assert best_alignment(learned, [(16 * recording.counts, target)]).gain < 1
    assert best_alignment(learned, [(recording.counts, target)]) == Alignment()
    counts = np.arange(6 * 300, dtype=np.int16).reshape(300, 6) % 50
    weaker = logits(aligned(learned, Alignment(gain=4.0)), counts)[learned.length :]
    np.testing.assert_allclose(weaker, logits(learned, 4 * counts)[learned.length :], atol=1e-3)


def test_a_network_that_is_already_right_is_kept(strokes: Stroked, adapted: Adapted) -> None:
    again = adapt(adapted.tcn, [strokes(10, **LONG)])
    assert not again.better or again.after - again.before < 2


@pytest.mark.parametrize(
    ("samples", "gain", "noise", "reason"),
    [
        (1500, 1.0, 0.0, r"15 s are too short to adapt to: record 20 s or more"),
        (3000, 0.0, 0.0, r"stroked-5: has no rest or no strokes"),
        (3000, 0.0, 2.0, r"has no rest or no strokes: record several strokes with a second of rest"),
        (3000, 0.0, 80.0, r"has no rest or no strokes"),
    ],
    ids=["short", "constant", "rest only", "slip only"],
)
def test_recordings_without_rest_and_strokes_are_refused(  # noqa: PLR0917
    learned: Tcn, strokes: Stroked, samples: int, gain: float, noise: float, reason: str
) -> None:
    recording = strokes(5).piece(slice(samples))
    shaken = gain * recording.counts + np.random.default_rng(0).normal(0, noise, recording.counts.shape)
    with pytest.raises(InputError, match=reason):
        adapt(learned, [replace(recording, counts=shaken.astype(np.int16))])


def test_another_rate_or_number_of_cells_is_refused(learned: Tcn, strokes: Stroked) -> None:
    slow = replace(strokes(5), fingertip=replace(TAKKTILE, rate=50.0))
    with pytest.raises(FingertipError, match=r"tcn needs 100 Hz; the data has 50 Hz: Resample"):
        adapt(learned, [slow])
    wide = replace(strokes(5), fingertip=replace(TAKKTILE, layout=((0, 1, 2, 3),)))
    with pytest.raises(FingertipError, match="tcn needs 6 cells"):
        adapt(learned, [wide])
