"""A device for measuring how long a vent takes: notes on the system's monotonic clock when it was sent to its safe value."""

import json
import time
from pathlib import Path

from pmabench.bench.interface import Identity


class Stamping:
    """Takes one set-point; `options: {log}` names the file that gets a line for each write."""

    def __init__(self, device, clock):
        self._log = Path(device.options["log"])
        self._held = 0.0

    def open(self):
        return Identity("test", "stamping", "", "0", simulated=True)

    def close(self):
        pass

    def write(self, output, value):
        self._held = value
        with self._log.open("a") as log:
            log.write(json.dumps([time.monotonic(), value]) + "\n")

    def read_back(self, output):
        return self._held
