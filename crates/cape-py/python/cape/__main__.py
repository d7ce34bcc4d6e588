"""The command line, also as ``python -m cape``."""

from __future__ import annotations

import signal
import sys

from . import _cape


def main() -> int:
    """Run the command line on the arguments of the process and return its exit code."""
    # Ctrl-C ends a command as it ends the program; Python's handler would wait for its return.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _cape.main(["cape", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
