import numpy as np

from tests.scene.scene_ablation import Ablation

# changes of two measures, for three seeds: one clear, one within its spread, one without any
FOUND = Ablation(
    ("distance", "F1"),
    np.zeros((3, 2)),
    {
        "texture": np.array([[3.0, 0.1], [3.2, -0.1], [3.4, 0.0]]),
        "creep": np.array([[0.3, 0.2], [-0.3, -0.2], [0.1, 0.0]]),
        "pivot": np.zeros((3, 2)),
    },
)


def test_an_effect_is_the_mean_over_the_seeds() -> None:
    np.testing.assert_allclose(FOUND.effect("texture"), [3.2, 0.0], atol=1e-12)


def test_errors_are_at_least_their_median() -> None:
    errors = {name: values.std(axis=0, ddof=1) / np.sqrt(3) for name, values in FOUND.change.items()}
    np.testing.assert_allclose(FOUND.sigma("creep"), errors["creep"])
    np.testing.assert_allclose(FOUND.sigma("pivot"), errors["texture"])


def test_a_term_that_changes_no_measure_by_two_errors_is_unclear() -> None:
    assert FOUND.unclear(["texture", "creep", "pivot"]) == ["creep", "pivot"]
