"""csp in real time: a thread pushes each sample into the graph of Python nodes."""

from datetime import UTC, datetime, timedelta
from threading import Thread
from time import perf_counter_ns, sleep

import csp
from csp import ts
from csp.impl.pushadapter import PushInputAdapter
from csp.impl.wiring import py_push_adapter_def

from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.records import Energy, zeroed


class Fingertips(PushInputAdapter):
    """Hands each sample over when it is due, from a thread of its own."""

    def __init__(self, live) -> None:
        self._live = live
        self._thread = Thread(target=self._feed)

    def start(self, starttime, endtime) -> None:
        """The engine runs."""
        self._thread.start()

    def stop(self) -> None:
        """The engine has stopped."""
        self._thread.join()

    def _feed(self) -> None:
        self._live.begin()
        for finger, due, counts in self._live.records:
            if (wait := self._live.wait(due)) > 0:
                sleep(wait)
            self.push_tick((finger, perf_counter_ns(), counts))


fingertips = py_push_adapter_def("fingertips", Fingertips, ts[object], live=object)


@csp.node
def zero(touch: ts[object]) -> ts[object]:
    """Counts relative to the unloaded fingertip."""
    if csp.ticked(touch):
        finger, stamp, counts = touch
        return finger, stamp, zeroed(counts)


@csp.node
def score(touch: ts[object], fingers: int) -> ts[object]:
    """What the window says."""
    with csp.state():
        s_energies = [Energy() for _ in range(fingers)]
    if csp.ticked(touch):
        finger, stamp, counts = touch
        value = s_energies[finger].score(counts)
        if value is not None:
            return finger, stamp, value


@csp.node
def told(event: ts[object], live: object):
    """The sink; the last event ends the run."""
    if csp.ticked(event):
        finger, stamp, value = event
        if live.told(finger, stamp, value):
            csp.stop_engine()


@csp.graph
def graph(live: object):
    """The path."""
    touch = fingertips(live, push_mode=csp.PushMode.NON_COLLAPSING)
    told(score(zero(touch), len(live.job.time)), live)


def run(live: Live, _: str) -> None:
    """To the last event."""
    start = datetime.now(UTC).replace(tzinfo=None)
    csp.run(graph, live, starttime=start, endtime=timedelta(days=1), realtime=True)


if __name__ == "__main__":
    carry_out_live(run)
