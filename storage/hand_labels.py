"""Labels that a person gave to spans of a session: numbered files that are never changed.

Each version is one JSON file, ``labels/000001.json`` and so on, with all spans and a checksum. The newest
version counts. The recorded streams and the label by arm speed stay as they are.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import islice, pairwise
from operator import index
from pathlib import Path
from typing import Final

from operators.batch import EVERY, SLIP, STATIC, UNKNOWN, Codes, Times
from operators.checks import check_between, check_choice
from operators.errors import InputError, ParameterError
from operators.ports import Description
from storage import files
from storage.description import check_identity, identity
from storage.layout import FINGER_MAX, LABEL_FILES, LABELS, file_name, numbered_files

FORMAT: Final = 1
VALUES: Final = {"slip": SLIP, "static": STATIC, "unknown": UNKNOWN}
SPANS_MAX: Final = 100_000  # of a session
_TIME_LIMIT: Final = 2**63  # ns


@dataclass(frozen=True, slots=True)
class LabelSpan:
    """Label of the samples of one fingertip from `begin` until before `end`.

    Raises:
        ParameterError: if a value is invalid.
        TypeError: if a number is not an integer.
    """

    begin: int  # ns since 1970 UTC, as the time of touch
    end: int  # ns
    finger: int  # as in touch
    value: str  # slip, static or unknown; unknown samples are neither learned from nor judged
    author: str = ""
    note: str = ""
    created: int = 0  # ns since 1970 UTC, when the span was marked

    def __post_init__(self) -> None:
        for name in ("begin", "end", "finger", "created"):
            object.__setattr__(self, name, index(getattr(self, name)))  # of numpy, which is not JSON
        texts: tuple[object, ...] = self.author, self.note
        if not all(isinstance(each, str) for each in texts):
            raise ParameterError("hand labels", "author and note", texts, "texts")
        if not -_TIME_LIMIT <= self.begin < self.end < _TIME_LIMIT:
            raise ParameterError("hand labels", "end", self.end, f"after begin, {self.begin} ns")
        check_between("hand labels", "finger", self.finger, EVERY, FINGER_MAX)
        check_between("hand labels", "created", self.created, 0, _TIME_LIMIT - 1)
        check_choice("hand labels", "value", self.value, VALUES)


@dataclass(frozen=True, slots=True)
class HandLabels:
    """One version of the hand labels of a session; spans of a fingertip do not overlap."""

    version: int = 0  # from 1; 0: none was written
    spans: tuple[LabelSpan, ...] = ()  # in order of fingertip and time

    def replace(self, label: Codes, time: Times, finger: int) -> Codes:
        """Return the labels (n,) of samples at `time` (n,), replaced within spans."""
        label = label.copy()
        for span in self.spans:
            if span.finger == finger:
                label[(time >= span.begin) & (time < span.end)] = VALUES[span.value]
        return label


def read_hand_labels(folder: Path, about: Description) -> HandLabels:
    """Return the newest hand labels of a session.

    Raises:
        InputError: if its file is damaged or belongs to another session.
    """
    versions = numbered_files(folder, LABEL_FILES)
    if not versions:
        return HandLabels()
    number = max(versions)
    path = versions[number]
    content = files.read_checked(path, files.LIST_LIMIT)
    if content.get("format") != FORMAT or content.get("version") != number:
        raise InputError(str(path), f'must have "format": {FORMAT} and "version": {number}; restore a copy')
    check_identity(path, content, about)
    try:
        return HandLabels(number, _ordered(LabelSpan(**each) for each in content["spans"]))
    except (KeyError, TypeError, ParameterError) as error:
        raise InputError(str(path), f"has an invalid span: {error}; restore a copy") from error


def write_hand_labels(
    folder: Path, about: Description, spans: Iterable[LabelSpan], *, based_on: int
) -> HandLabels:
    """Write all spans as the next version of the hand labels of a session; all other files stay.

    The version that they are based on, 0 for none, must be the newest.

    Raises:
        ParameterError: if spans of a fingertip overlap, or there are more than 100,000.
        InputError: if another version was written since `based_on`.
        EndpointError: if the file cannot be written; nothing is changed then.
    """
    ordered = _ordered(spans)
    with files.write_errors(folder / LABELS):
        files.make_folder(folder / LABELS)
        with files.exclusive(folder / LABELS):
            newest = max(numbered_files(folder, LABEL_FILES), default=0)
            if newest != based_on:
                reason = f"has version {newest} of hand labels, not {based_on}: load it and mark again"
                raise InputError(str(folder), reason)
            content = {"format": FORMAT, "version": newest + 1, **identity(about)}
            content["spans"] = [asdict(each) for each in ordered]
            files.put_checked(folder / file_name(LABEL_FILES, newest + 1), content)
    return HandLabels(newest + 1, ordered)


def _ordered(spans: Iterable[LabelSpan]) -> tuple[LabelSpan, ...]:
    """Return spans in order of fingertip and time; check that they are few and do not overlap."""
    ordered = tuple(sorted(islice(spans, SPANS_MAX + 1), key=lambda span: (span.finger, span.begin)))
    if len(ordered) > SPANS_MAX:
        raise ParameterError("hand labels", "number of spans", len(ordered), f"at most {SPANS_MAX:,}")
    for one, other in pairwise(ordered):
        if one.finger == other.finger and other.begin < one.end:
            must_be = f"at least {one.end} ns, the end of the span before"
            raise ParameterError("hand labels", "begin", other.begin, must_be)
    return ordered
