"""slipflow, live, with four sinks: an event is there when the last one has it."""

from functools import partial

from tests.benchmarks.peers.live import carry_out_live
from tests.benchmarks.peers.slipflow_live import run

if __name__ == "__main__":
    carry_out_live(partial(run, sinks=4))
