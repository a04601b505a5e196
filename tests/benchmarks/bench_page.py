"""How far the live page is behind, and what browsers cost that stop reading.

Run by `make bench`. A process of its own runs the demo's flow on the simulated rig, in real time, and serves
its page; headless Chromium looks at it. Lag is from the time of the newest sample in a frame to the frame's
arrival in the page, by the clocks of the run and of the browser, which are those of one machine. Then eight
clients that never read connect, and again whenever they are dropped; the same demo without a page beside it
shows what of its memory is not the page's.
"""

import argparse
import asyncio
import os
import platform
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flows import demo as ready_made
from flows.cli.live_view import add_page
from flows.cli.terminal import note
from flows.run.clocks import LoopClock
from flows.run.live_runner import LiveRunner
from tests.benchmarks.machine import commit, real_time_priority
from tests.connectors.web.browsing import chromium

if TYPE_CHECKING:
    from playwright.sync_api import Page

WARM = 8.0  # s that do not count: physics is compiled, the baseline is learned
SILENT = 8  # clients that never read
NOTE = """
window.lags = [];
document.addEventListener("frame", ({ detail }) => window.lags.push(detail.received - detail.newest));
"""


@contextmanager
def demo(*options: str) -> Generator[tuple[subprocess.Popen[str], str]]:
    """The demo in a process of its own, and the address of its page."""
    command = [sys.executable, __file__, "--serve", *options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        found = next(filter(None, (re.search(r"page: (\S+)", line) for line in process.stderr)))
        try:
            yield process, found[1]
        finally:
            process.terminate()


async def serve(*, page: bool) -> None:
    """Run the demo until it is stopped."""
    with tempfile.TemporaryDirectory() as out:
        flow = ready_made.demo(out)
        if page:
            add_page(flow, "127.0.0.1:0")
        else:
            note("page: none")
        await LiveRunner(flow, "demo", clock=LoopClock()).execute()


def lags(tab: "Page", address: str, seconds: float) -> list[float]:
    """Of each frame, ms."""
    tab.add_init_script(NOTE)
    tab.goto(address)
    tab.wait_for_timeout(1000 * WARM)
    tab.evaluate("() => { window.lags = []; }")
    tab.wait_for_timeout(1000 * seconds)
    found: list[float] = tab.evaluate("() => window.lags")
    return found


def silent(port: int) -> socket.socket:
    """A client that asks for frames and never reads."""
    client = socket.create_connection(("127.0.0.1", port))
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    opening = f"GET /live HTTP/1.1\r\nHost: localhost:{port}\r\nOrigin: http://localhost:{port}\r\n"
    upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    client.sendall(f"{opening}{upgrade}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode())
    client.sendall(10_000 * b"\x81\x80\0\0\0\0")  # masked text messages without content
    return client


def gone(client: socket.socket) -> bool:
    """Whether the server has dropped a client, which reads nothing to find out."""
    state = client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)[0]
    return state != 1  # TCP_ESTABLISHED


def resident(process: int) -> float:
    """Memory of a process, MB."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(processes: Sequence[int], port: int, seconds: float) -> tuple[list[list[float]], int]:
    """Memory of processes each second, MB, while clients take nothing; how often one of these was dropped."""
    used, dropped = [list[float]() for _ in processes], 0
    with ExitStack() as stack:
        clients = [stack.enter_context(silent(port)) for _ in range(SILENT)]
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(1)
            for mine, process in zip(used, processes, strict=True):
                mine.append(resident(process))
            for k, client in enumerate(clients):
                if gone(client):
                    dropped += 1
                    client.close()
                    clients[k] = stack.enter_context(silent(port))
    return used, dropped


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--without", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=20.0, help="of lag")
    parser.add_argument("--memory", type=float, default=600.0, help="seconds with clients that never read")
    options = parser.parse_args()
    if options.serve:
        asyncio.run(serve(page=not options.without))
        return
    machine = platform.processor() or platform.machine()
    print(f"commit {commit()}, {machine}, {os.cpu_count()} cores")
    print(f"{'ms from sample to page':28}{'priority':>10}{'load':>6}{'frames':>8}", end="")
    print("".join(f"{name:>8}" for name in ("p50", "p90", "p99", "max")))
    for context in (nullcontext("normal"), real_time_priority()):
        with context as priority, demo() as (_, address), chromium() as browser:
            found = lags(browser.new_page(), address, options.seconds)
        values = "".join(f"{value:8.1f}" for value in np.percentile(found, (50, 90, 99, 100)))
        print(
            f"{'newest of each frame':28}{priority:>10}{os.getloadavg()[0]:6.1f}{len(found):8}{values}",
            flush=True,
        )
    with demo() as (process, address), demo("--without") as (control, _):
        time.sleep(3 * WARM)
        port = int(address.rpartition(":")[2])
        measured, dropped = memory((process.pid, control.pid), port, options.memory)
    print(f"{'MB of the process':28}{'s':>8}{'first':>9}{'last':>9}{'max':>9}{'dropped':>9}")
    names = f"{SILENT} clients that never read", "no page"
    for name, used, times in zip(names, measured, (dropped, 0), strict=True):
        tenth = max(1, len(used) // 10)
        columns = np.median(used[:tenth]), np.median(used[-tenth:]), max(used)
        print(f"{name:28}{len(used):8}{''.join(f'{value:9.1f}' for value in columns)}{times:9}")


if __name__ == "__main__":
    main()
