"""Entry point of `slipflow`, also as `python -m flows.cli`."""

import os
import signal


def main() -> None:
    """Import the command line and run it; Ctrl-C during the import ends the process with exit code 130."""
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # as a script's `slipflow ... &` inherits it
    if not ignored:
        signal.signal(signal.SIGINT, _end)
    from flows.cli.main import main as run

    if not ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: unfinished output is deleted
    run()


def _end(*_: object) -> None:
    os._exit(130)


if __name__ == "__main__":
    main()
