"""Deterministic simulation of the whole system: `make faults`, or `python -m tests.faults --help`."""

import argparse
import sys

from tests.faults.planted_bugs import PLANTED
from tests.faults.search import replay, search


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--seed", type=int, help="simulate this seed only, print its faults, and shrink them")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--count", type=int, help="number of schedules (default: until stopped)")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default 2)")
    parser.add_argument("--bug", choices=PLANTED, help="plant this bug, which a schedule must find")
    options = parser.parse_args()
    if options.seed is not None:
        sys.exit(replay(options.seed, options.bug))
    try:
        sys.exit(search(options.first, options.count, options.jobs, options.bug))
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
