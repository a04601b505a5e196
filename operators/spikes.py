"""Test of single readings: one wrong bit on the bus must not look like a slip.

A reading is a spike if only its cell jumps, in that row only. Loops over rows call `find_spike` and keep the
state, of which `forget` makes the initial one. With x the readings of one cell, k a row, o any other cell::

    jump    |x[k] - x[k-1]| > 2 max(|o[k] - o[k-1]|, recent jumps of the cell)       suspicious: wait for k+1
    return  |x[k+1] - x[k-1]| <= |x[k] - x[k-1]| / 2
    bend    |x[k] - (x[k-1] + x[k+1]) / 2| > 5 max(that of each o, recent bends of the cell)

Recent values are maxima that decay by 3 % per row. A blow, an onset of slip or a vibration moves several
cells, lasts for several rows, or comes after jumps of similar size. Not found: two spikes in one row, a spike
in a cell that slips or shakes as much, and any spike while only one cell is valid.
"""

from math import isnan
from typing import Final

import numpy as np

from operators.batch import Counts, Flags, Reals

NO_CELL: Final = -1
_EARLIER, _LATEST, _JUMP, _BEND, _SUSPECT = range(5)  # rows of the state; the last one holds a cell's number
_DECAY: Final = 0.97  # per row
_CLEAR: Final = 2.0  # ratio of a suspicious jump to others, and to what is left of it in the next row
_SHARP: Final = 5.0  # ratio of the bend of a spike to others


def forget(cells: int) -> Reals:
    """Return the state before the first row, (5, cells)."""
    state = np.full((5, cells), np.nan)
    state[_JUMP:_SUSPECT], state[_SUSPECT] = 0.0, NO_CELL
    return state


def is_suspicious(state: Reals) -> bool:
    """Return whether the next row decides if the latest one has a spike."""
    return bool(state[_SUSPECT, 0] != NO_CELL)


def find_spike(counts: Counts, valid: Flags, least: float, state: Reals) -> int:
    """Take the next row, (cells,); return the cell of which the row before was a spike, or `NO_CELL`.

    Jumps up to `least` (counts) are never suspicious.
    """
    spike = _confirm(counts, valid, state)
    suspect, largest, second, number = -1, 0.0, 0.0, 0
    for cell in range(len(counts)):
        if valid[cell]:
            if isnan(state[_LATEST, cell]):
                state[_EARLIER, cell] = state[_LATEST, cell] = counts[cell]
            number += 1
            jump = abs(counts[cell] - state[_LATEST, cell])
            if jump > largest:
                suspect, largest, second = cell, jump, largest
            elif jump > second:
                second = jump
    if number < 2 or largest <= max(least, _CLEAR * second, _CLEAR * state[_JUMP, suspect]):
        suspect = -1
    for cell in range(len(counts)):
        if valid[cell]:
            if cell != suspect:
                jump, bend = abs(counts[cell] - state[_LATEST, cell]), _bend(counts, state, cell)
                state[_JUMP, cell] = max(_DECAY * state[_JUMP, cell], jump)
                state[_BEND, cell] = max(_DECAY * state[_BEND, cell], bend)
            state[_EARLIER, cell], state[_LATEST, cell] = state[_LATEST, cell], counts[cell]
    state[_SUSPECT, 0] = suspect
    return spike


def _confirm(counts: Counts, valid: Flags, state: Reals) -> int:
    """Return the suspicious cell of the latest row if this row shows that it was a spike, else -1."""
    suspect = int(state[_SUSPECT, 0])
    if suspect < 0:
        return -1
    others = state[_BEND, suspect]
    for cell in range(len(counts)):
        if valid[cell] and cell != suspect and not isnan(state[_LATEST, cell]):
            others = max(others, _bend(counts, state, cell))
    jump = abs(state[_LATEST, suspect] - state[_EARLIER, suspect])
    left = abs(counts[suspect] - state[_EARLIER, suspect])
    if valid[suspect] and _CLEAR * left <= jump and _bend(counts, state, suspect) > _SHARP * others:
        state[_LATEST, suspect] = state[_EARLIER, suspect]
        return suspect
    state[_JUMP, suspect] = max(state[_JUMP, suspect], jump)
    state[_BEND, suspect] = max(state[_BEND, suspect], jump / 2)
    return -1


def _bend(counts: Counts, state: Reals, cell: int) -> float:
    """Return the distance of a cell's latest reading from the middle of its neighbours."""
    return float(abs(state[_LATEST, cell] - (state[_EARLIER, cell] + counts[cell]) / 2))
