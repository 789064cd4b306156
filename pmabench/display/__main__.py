"""`python -m pmabench.display RUN --link FD`: the display of `pmabench run`, as its child process."""

from __future__ import annotations

import argparse
import os
import socket
import sys
from contextlib import suppress
from pathlib import Path

from pmabench.base.system import ordinary
from pmabench.display.child import Link
from pmabench.display.console import Console, Terminate, tidy_signals


def main() -> int:
    """Show the run until the link ends."""
    parser = argparse.ArgumentParser(prog="python -m pmabench.display", description=__doc__)
    parser.add_argument("run", type=Path, help="the run folder")
    parser.add_argument("--link", type=int, required=True, metavar="FD", help="an inherited socket")
    parser.add_argument("--no-color", action="store_true")
    given = parser.parse_args()
    ordinary()
    with suppress(OSError):
        os.nice(5)  # the bench goes first
    link = Link(socket.socket(fileno=given.link))
    color = not given.no_color and "NO_COLOR" not in os.environ
    plain = not sys.stderr.isatty() or os.environ.get("TERM") == "dumb"
    console = Console(given.run, sys.stderr, link=link, color=color, plain=plain)
    with suppress(Terminate, BrokenPipeError), tidy_signals(child=True):
        console.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
