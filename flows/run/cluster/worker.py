"""The work on the claims of one share of the fingertips: state in, state out; no engine is needed to do it.

Claims may come more than once and in any order: they are numbered, so that each is worked off once, in turn.
"""

import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from flows.graph import Flow
from flows.graph.compiled_flow import CompiledFlow, Delivery, Entry
from flows.graph.node import Node
from flows.run.cluster.cluster_segment import Tap, segment
from flows.run.cluster.part_files import PartReader
from flows.run.cluster.staging import Given, stage, staged_name
from flows.run.cluster.work_units import Claim, Done, Slice
from operators.batch import Batch
from operators.errors import EndpointError, SlipflowError


@dataclass
class _State:
    """What is remembered of a share between its claims."""

    next: int = 0  # number of the claim whose turn it is; -1: there will be none
    waiting: dict[int, str] = field(default_factory=dict[int, str])  # claims that came early, as lines
    operators: bytes = b""  # a snapshot; empty before the first claim


class Work:
    """Works off claims, one at a time, and stages what they come to.

    Args:
        flow: The flow that they are of.
        place: Where it is staged.
    """

    def __init__(self, flow: Flow, place: Path) -> None:
        self._flow, self._place = flow, place
        self._reader = PartReader()

    def take(self, state: bytes | None, claim: Claim) -> tuple[bytes, Done | None]:
        """Take a claim; give the state after it, and what is done if nothing remains to be done.

        An error that would come again ends the work on the share and is told in what is done.

        Args:
            state: What the claim before gave; None: there was none.
            claim: Of any number.

        Raises:
            EndpointError: if it cannot be staged; the state before still holds.
        """
        now = _State() if state is None else cast("_State", pickle.loads(state))  # noqa: S301 - our own
        done = None
        if now.next >= 0 and claim.number >= now.next:
            try:
                done = self._advance(now, claim)
            except EndpointError:
                raise
            except SlipflowError as error:
                done = Done(
                    claim.session,
                    claim.folder,
                    claim.turn,
                    claim.share,
                    claim.deal - claim.share,
                    None,
                    str(error),
                )
            if done:
                now = _State(next=-1)
        return pickle.dumps(now, pickle.HIGHEST_PROTOCOL), done

    def _advance(self, now: _State, newest: Claim) -> Done | None:
        """Work off what is due."""
        if newest.number > now.next:
            now.waiting[newest.number] = newest.line()
            return None
        flow = segment(self._flow, newest.sources)
        plan = CompiledFlow(flow, only=newest.fingers)
        if now.operators:
            plan.restore(now.operators)
        entries = {node.name: node for node in flow.sources()}
        due: Claim | None = newest
        while claim := due:
            given: Given = {}
            for each in claim.slices:
                batches: dict[Entry, Batch] = {
                    (entries[rows.source], rows.finger): batch
                    for rows, batch in zip(each.rows, self._rows(claim, each, entries), strict=True)
                }
                _collect(given, each.number, plan.push(batches), claim.fingers)
            if claim.end:
                _collect(given, claim.end.slices, plan.flush(), claim.fingers)
            stage(self._place / claim.key / staged_name(claim.number), given)
            if claim.end:
                return Done(
                    claim.session, claim.folder, claim.turn, claim.share, claim.deal - claim.share, claim.end
                )
            now.next += 1
            line = now.waiting.pop(now.next, None)
            due = Claim.read(line) if line else None
        now.operators = plan.snapshot()
        return None

    def _rows(self, claim: Claim, each: Slice, entries: dict[str, Node]) -> list[Batch]:
        batches = list[Batch]()
        for rows in each.rows:
            kind = cast("type[Batch]", entries[rows.source].gives)
            part = self._reader.read(Path(claim.folder), kind, rows.path, rows.sha256)
            batches.append(part[rows.finger][rows.start : rows.stop])
        return batches


def _collect(given: Given, number: int, deliveries: list[Delivery], fingers: tuple[int, ...]) -> None:
    """Keep what is the share's own: what belongs to every fingertip is the work of one share."""
    for sink, batch in deliveries:
        if batch.finger in fingers:
            given[number, cast("Tap", sink.part).operator, batch.finger] = batch
