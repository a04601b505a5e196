"""Answering requests for events that did not come, a little at a time."""

import logging
from collections import deque

from connectors.mqtt.gap_request import GapAnswer, GapRequest
from connectors.mqtt.message import Message
from connectors.mqtt.numbers import Numbers
from connectors.mqtt.outbox import Outbox
from operators.errors import EndpointError, InputError

log = logging.getLogger("slipflow")

REQUESTS = 32  # that may wait; who gets no answer asks again
PAGE = 500  # events of one answer: fewer than a client's queue takes
SLICE = 16  # events at a time


class GapAnswers:
    """The requests that wait, and the answer that is being given.

    After each slice the next request has its turn, so that nobody waits for a long answer to another.
    """

    def __init__(self, outbox: Outbox, topic: str) -> None:
        """Answer from `outbox` for the rig at `topic`."""
        self._outbox, self._topic = outbox, topic
        self._requests = deque[_Answering]()
        self._refused = False  # one was, and logged

    def __bool__(self) -> bool:
        """Whether there is anything to answer."""
        return bool(self._requests)

    def ask(self, payload: bytes) -> None:
        """Take a request; what is malformed is logged, the first time, and ignored."""
        try:
            request = GapRequest.decode(payload, self._topic)
        except InputError as error:
            if not self._refused:
                log.warning("ignored, as all that are like it: %s", error)
            self._refused = True
            return
        waiting = any(each.request == request for each in self._requests)
        if not waiting and len(self._requests) < REQUESTS:
            self._requests.append(_Answering(request))

    def forget(self) -> None:
        """Answer none of them: who asked was cut off too, and asks again."""
        self._requests.clear()

    async def next(self) -> list[Message]:
        """A slice of an answer; [] when there is none."""
        if not self._requests:
            return []
        answering = self._requests.popleft()
        request, wanted = answering.request, min(SLICE, PAGE - answering.sent)
        try:
            found, last = await self._outbox.between(request.epoch, answering.first, request.last, wanted)
        except EndpointError:
            return []  # it cannot be read now: that is no reason to say it were lost
        for entry in found:
            answering.found.add(entry.seq)
        answering.first, answering.sent = last + 1, answering.sent + len(found)
        messages = [Message(request.reply_to, entry.payload, retain=False) for entry in found]
        if len(found) == wanted and answering.sent < PAGE and last < request.last:
            self._requests.append(answering)
        elif last >= request.first:
            missing = tuple(answering.found.gaps(request.first, last))
            closing = GapAnswer(request.epoch, request.first, last, missing)
            messages.append(Message(request.reply_to, closing.encode(), retain=False))
        return messages


class _Answering:
    """How far the answer to a request is."""

    def __init__(self, request: GapRequest) -> None:
        self.request, self.found = request, Numbers()
        self.first, self.sent = request.first, 0
