"""What a client's script prints: one JSON line a call; standard library only, and nothing of the project."""

import contextlib
import json
import sys
import time

SETTLED = 0.1
"""After a line with values: so long the script does nothing, so that who reads it can look at the plant [s]."""


def line(call, ok, why="", saw=None):
    """One call: `ok` is None where it was not tried."""
    sys.stdout.write(json.dumps({"call": call, "ok": ok, "why": why, "saw": saw or {}}) + "\n")
    sys.stdout.flush()


@contextlib.contextmanager
def call(name):
    """A call that is tried: agrees unless something is raised; what the block puts into the dictionary is `saw`."""
    saw = {}
    try:
        yield saw
    except Exception as error:
        line(name, False, " ".join(f"{type(error).__name__}: {error}".split())[:300])
        return
    line(name, True, "", saw)
    if saw:
        time.sleep(SETTLED)


def not_tried(name, why):
    """A call of the client's page that is not made, and why."""
    line(name, None, why)
