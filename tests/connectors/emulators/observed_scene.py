"""A shared scene that keeps its ground truth."""

from collections import defaultdict
from dataclasses import replace

from connectors.emulators.shared_scene import SharedScene
from operators.batch import Touch, Truth, concat


class ObservedScene(SharedScene):
    """A shared scene that keeps the truth of each sample."""

    _truth: dict[int, list[Truth]] | None = None

    def truth(self, finger: int | None = None) -> Truth:
        """Return the truth of a fingertip (default the first) at each of its samples."""
        assert self._truth
        truth = concat(Truth, self._truth[self.fingers[0] if finger is None else finger])
        return replace(truth, time=truth.time + self.origin)

    def _sense(self, finger: int, instant: float) -> tuple[Touch, Truth]:
        if self._truth is None:
            self._truth = defaultdict(list)
        sample = super()._sense(finger, instant)
        self._truth[finger].append(sample[1])
        return sample
