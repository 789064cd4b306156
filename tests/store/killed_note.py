"""Forks programs that take a note and kills each at another step of it; a program of its own, as for killed writers.

`python killed_note.py RUN PICTURE COPIES` prints one JSON line per step: the copy of RUN that was noted on, and whether
the program came to its end.
"""

import json
import os
import shutil
import signal
import sys
import warnings
from pathlib import Path

from pmabench.store.notes import add_note

STEPS = ("open", "os.", "shutil.")
"""What is counted: whatever the interpreter's audit calls a touch of the file system."""


def note_until(run, picture, step):
    """Take a note; die where the file system is touched for the `step`-th time."""
    touched = 0

    def hook(name, _arguments):
        nonlocal touched
        if name.startswith(STEPS):
            touched += 1
            if touched == step:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    add_note(run, "seen afterwards", attach=[picture], operator="N")


def main(run, picture, copies):
    """One copy of the run after another, until a note comes to its end."""
    step, ended = 0, False
    while not ended:
        step += 1
        copy = shutil.copytree(run, copies / f"step-{step:03d}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pid = os.fork()
        if pid == 0:
            try:
                note_until(copy, picture, step)
                os._exit(0)
            finally:
                os._exit(1)
        ended = os.waitpid(pid, 0)[1] == 0
        print(json.dumps({"run": str(copy), "ended": ended}), flush=True)


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
