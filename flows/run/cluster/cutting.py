"""Cutting a recording into claims: at the instants at which a replay in one process would cut it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Entry
from flows.run.cluster.cluster_segment import needed, tapped
from flows.run.cluster.part_files import Stamps, read_stamps
from flows.run.cluster.work_units import Claim, End, Rows, Slice
from flows.run.replay_runner import in_slices, replayed
from operators.batch import EVERY, Batch
from operators.errors import InputError
from operators.ports import Description, SomeBatch
from storage import Session


class _WaitError(Exception):
    """A stream may yet go on."""


@dataclass
class Cutter:
    """Makes the claims of one recording, which may still grow.

    Args:
        flow: What is to be worked out.
        folder: The session's; all machines of the cluster must find it there.
        rows: The most that a batch of one stream holds; who writes the session has to cut it alike.
        slices: That a claim holds.
        shares: The most that the fingertips are split into; each is worked off by itself.
        deal: Which of several recordings it is: workers get recordings, and shares, in turn.
    """

    flow: Flow
    folder: Path
    rows: int = 1000
    slices: int = 8
    shares: int = 8
    deal: int = 0
    _stamps: dict[str, dict[int, Stamps]] = field(default_factory=dict[str, dict[int, Stamps]], init=False)
    _turn: int = field(default=0, init=False)
    _given: int = field(default=0, init=False)  # claims of each share in this turn
    _sources: Mapping[str, tuple[int, ...]] = field(default_factory=dict[str, tuple[int, ...]], init=False)
    ended: bool = field(default=False, init=False)  # its last claims are given

    def claims(self, *, growing: bool = False) -> list[Claim]:
        """The claims that are new since the last call, those of one span of time beside each other.

        Where a fingertip comes up late in a recording that grows, its claims begin anew, in another turn.

        Args:
            growing: Whether to wait for what a session that is not closed may still get.

        Raises:
            InputError: if the recording cannot be read, or lacks a stream that the flow needs.
        """
        if self.ended:
            return []
        session = Session.open(self.folder)
        stamped = _Stamped(session, self._stamps)
        closed = not growing or "end_ns" in session.about
        try:
            flow = replayed(self.flow, stamped, paced=False)
        except InputError:
            if closed:
                raise
            return []  # a stream has no part yet
        sources = {node.name: node.fingers for node in flow.sources()}
        if self._given and sources != self._sources:
            self._turn, self._given = self._turn + 1, 0
        self._sources = sources
        found = list(self._cut(stamped, flow, closed=closed))
        if closed and not found:
            raise InputError(str(self.folder), "holds no rows, so there is nothing to work out")
        self.ended = closed
        return self._claimed(session, flow, found, closed=closed)

    def _cut(self, stamped: "_Stamped", flow: Flow, *, closed: bool) -> Iterator[dict[Entry, Stamps]]:
        streams: dict[Entry, Iterator[Batch]] = {}
        for node, finger in CompiledFlow(flow).entries:
            stream = stamped.read(cast("type[Batch]", node.gives), finger, self.rows)
            streams[node, finger] = stream if closed else _waiting(stream)
        try:
            yield from cast("Iterator[dict[Entry, Stamps]]", in_slices(streams))
        except _WaitError:
            return

    def _claimed(
        self, session: Session, flow: Flow, found: list[dict[Entry, Stamps]], *, closed: bool
    ) -> list[Claim]:
        files = {
            node.name: list(session.files(cast("type[Batch]", node.gives)).items()) for node in flow.sources()
        }
        taken, shares = needed(self.flow), shared(flow, self.shares)
        last = max(-(-len(found) // self.slices) - 1, 0) if closed else len(found) // self.slices - 1
        claims = list[Claim]()
        for number in range(self._given, last + 1):
            first = number * self.slices
            group = list(enumerate(found[first : first + self.slices], first))
            end = End(len(found), last + 1, shares) if closed and number == last else None
            for share, fingers in enumerate(shares):
                own = [
                    (k, tuple(_rows(entry, part, files) for entry, part in each.items()
                              if entry[0].name in taken and entry[1] in (*fingers, EVERY)))
                    for k, each in group
                ]  # fmt: skip
                slices = tuple(Slice(k, rows) for k, rows in own if rows)
                claims.append(
                    Claim(
                        session.name,
                        str(self.folder),
                        self._turn,
                        share,
                        fingers,
                        self.deal + share,
                        number,
                        self._sources,
                        slices,
                        end,
                    )
                )
        self._given = max(self._given, last + 1)
        return claims


def shared(flow: Flow, most: int) -> tuple[tuple[int, ...], ...]:
    """The fingertips whose rows the flow derives, in at most so many shares; EVERY counts as one.

    What belongs to every fingertip is read for each share: few large ones cost less than many small ones.
    """
    fingers = sorted({finger for node in tapped(flow) for finger in node.fingers})
    count = min(most, len(fingers))
    return tuple(tuple(fingers[share::count]) for share in range(count))


def _rows(entry: Entry, stamps: Stamps, files: Mapping[str, list[tuple[str, str | None]]]) -> Rows:
    name = entry[0].name
    path, sha256 = files[name][stamps.part.item(0)]
    return Rows(name, entry[1], path, sha256, stamps.row.item(0), stamps.row.item(-1) + 1)


def _waiting(stream: Iterator[Batch]) -> Iterator[Batch]:
    yield from stream
    raise _WaitError


@dataclass
class _Stamped:
    """A session as a recording of stamps only."""

    session: Session
    stamps: dict[str, dict[int, Stamps]]  # by file; those that were read before stay

    @property
    def name(self) -> str:
        return str(self.session.folder)

    def fingers(self, kind: type[Batch]) -> tuple[int, ...]:
        return tuple(sorted({finger for part in self._parts(kind) for finger in part}))

    def read(self, kind: type[SomeBatch], finger: int, rows: int = 1000) -> Iterator[SomeBatch]:
        for part in self._parts(kind):
            batch = part.get(finger)
            for start in range(0, 0 if batch is None else len(batch), rows):
                yield cast("SomeBatch", cast("Stamps", batch)[start : start + rows])

    def describe(self) -> Description:
        return self.session.about

    def _parts(self, kind: type[Batch]) -> Iterator[dict[int, Stamps]]:
        for number, (path, sha256) in enumerate(self.session.files(kind).items()):
            if path not in self.stamps:
                self.stamps[path] = read_stamps(self.session.folder, kind, path, sha256, number)
            yield self.stamps[path]
