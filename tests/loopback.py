"""Loopback addresses for servers on the fixed ports of ur-rtde."""

import os


def own_host(number: int) -> str:
    """Return the loopback address with a number (1 to 250) that no other test process uses."""
    process = os.getpid()
    return f"127.{1 + process // 250 % 250}.{1 + process % 250}.{number}"
