"""A program with a display, as `pmabench run` is one: writes what comes from it into a file, one JSON object a line.

`python -m tests.display.operated FOLDER LOG [die]`: asks at once, ends at the key q; with `die` it dies at the key v.
"""

import json
import os
import sys
import time
from pathlib import Path

from pmabench.display.child import Display


def main(folder, log, die=""):
    """Until q, or the display is gone."""
    display = Display()
    display.start(Path(folder))
    display.ask("Put 6 kg on [/dev/ttyUSB0] [/].", ("clear", "no"))
    with Path(log).open("w", buffering=1) as out:
        out.write(json.dumps({"pid": display._process.pid}) + "\n")
        while display.alive:
            display.live({"pressure": 1230.0})
            for message in display.poll():
                out.write(json.dumps(message) + "\n")
                if message.get("key") == "v" and die:
                    os._exit(9)
                if message.get("key") == "q":
                    display.close()
            time.sleep(0.02)
        out.write(json.dumps({"over": True}) + "\n")
    display.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
