"""Crops of labelled recordings on the device that a network is trained on."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from flows.learn.labelled_recordings import LabelledRecording
from operators.batch import Codes


class Crops:
    """Recordings joined on a device, and the crops of one length that lie within a recording.

    Args:
        recordings: Recordings; those shorter than a crop are left out.
        length: Samples of a crop.
        device: Device of the counts.
    """

    def __init__(self, recordings: Sequence[LabelledRecording], length: int, device: torch.device) -> None:
        usable = [recording for recording in recordings if len(recording) >= length]
        cells = usable[0].counts.shape[1] if usable else 0
        counts = np.concatenate([np.empty((0, cells), np.int16), *(recording.counts for recording in usable)])
        begins = np.cumsum([0, *(len(recording) for recording in usable)]).tolist()
        first: list[NDArray[np.int64]] = [
            np.arange(begin, end - length + 1) for begin, end in pairwise(begins)
        ]
        self.counts = torch.as_tensor(counts).to(device)  # (n, cells) int16
        self.label: Codes = np.concatenate([np.empty(0, np.int8), *(each.label for each in usable)])  # (n,)
        self.first = np.concatenate([np.empty(0, np.int64), *first])  # (m,) first row of each crop
        self._offsets = torch.arange(length, device=device)

    def rows(self, first: Tensor) -> Tensor:
        """Return the rows (k, length) of crops that begin at rows `first` (k,), on the device."""
        return first[:, None] + self._offsets
