"""Entry point of `slipflow`, also as `python -m flows.cli`."""

import faulthandler
import os
import resource
import signal
import sys
from typing import Final

_ADDRESS_SPACE_MIN: Final = 300_000_000  # bytes; with less, libraries abort instead of raising errors


def _raise_again(swallowed: "sys.UnraisableHookArgs") -> None:
    """Raise KeyboardInterrupt again, soon, if a callback swallowed it, as of LLVM in a compilation."""
    if swallowed.exc_type is KeyboardInterrupt:
        signal.setitimer(signal.ITIMER_REAL, 0.05)  # s, when the callback has ended
    else:
        sys.__unraisablehook__(swallowed)


def main() -> None:
    """Import the command line and run it; Ctrl-C during the import ends the process with exit code 130."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each thread of numpy's library reserves memory
        if limit < _ADDRESS_SPACE_MIN:
            size = f"its address space is limited to {limit // 10**6} MB: raise the limit (ulimit -v)"
            sys.stderr.write(f"error: there is not enough memory: {size}\n")
            sys.exit(2)
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # as a script's `slipflow ... &` inherits it
    if not ignored:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from flows.cli.main import main as run

    if not ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):  # as Ctrl-C: unfinished output is deleted
        if signal.getsignal(number) is not signal.SIG_IGN:  # of nohup
            signal.signal(number, signal.default_int_handler)
    faulthandler.register(signal.SIGQUIT, file=2, all_threads=False, chain=True)  # Ctrl-\ prints the line
    sys.unraisablehook = _raise_again
    run()


if __name__ == "__main__":
    main()
