"""What a check of a dataset finds, and how bad it is."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

Weight = Literal["note", "repairable", "repaired", "lossy", "lost"]

_ORDER: Final[tuple[Weight, ...]] = ("note", "repairable", "repaired", "lossy", "lost")


@dataclass(frozen=True)
class Finding:
    """Something about a session that is not as it should be; a mere note says nothing against it.

    Repairable is what a recovery can put right, repaired what one has; neither has lost a row. Lossy is what
    was known not to be there: rows dropped, or cut off with the recorder. Lost is what had been recorded.
    """

    session: str
    weight: Weight
    text: str


def heaviest(findings: Iterable[Finding]) -> Weight:
    """The weight of the worst finding; a note if there is none."""
    return _ORDER[max((severity(finding.weight) for finding in findings), default=0)]


def severity(weight: Weight) -> int:
    """How bad it is: 0 for a note.

    >>> severity("lossy") < severity("lost")
    True
    """
    return _ORDER.index(weight)
