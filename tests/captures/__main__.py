"""Makes captures anew, against the emulators."""

import json
import sys
import tempfile
from pathlib import Path
from time import sleep
from unittest.mock import patch

from pmabench_drivers.emulator import Emulator
from pmabench_drivers.emulator.plant import RealPlant

from pmabench.bench.interface import EMULATED
from tests.captures.capture import FOLDER, Capture
from tests.captures.scripts import SCRIPTS, device_of, reached, use

SHOWN = {
    "pressure": 123456.0,
    "displacement": 0.0123,
    "force": 58.86,
    "supply": 690e3,
    "pressure_command": 0.0,
    "displacement_command": 0.0,
}
"""What the plant shows [SI]."""


def record(name, folder):
    """The exchange of one script with the emulator of its device."""
    log = Path(folder) / f"{name}.jsonl"
    device = device_of(name, Path(folder) / name)
    with patch.object(RealPlant, "model", lambda _plant, shown: f"{EMULATED}{shown}"):  # it is about bytes, not scales
        emulator = Emulator([device], preset="ideal", log=log)
    emulator.plant.quantities = lambda: SHOWN
    emulator.plant.at = lambda _moment: SHOWN
    try:
        said = use(name, reached(device, emulator.devices[device.name].address))
        sleep(0.1)  # for the last answer to be written down
    finally:
        emulator.close()
    capture, begin = Capture(whole="server" in device.options), 0.0
    for entry in map(json.loads, log.read_text().splitlines()):
        if entry["kind"] == "received" or (begin and entry["kind"] == "sent"):
            begin = begin or entry["t"]
            capture.add(entry["t"] - begin, entry["kind"] == "received", bytes.fromhex(entry["data"]))
    return capture, said


def main(names):
    FOLDER.mkdir(exist_ok=True)
    for name in names or SCRIPTS:
        with tempfile.TemporaryDirectory() as folder:
            capture, said = record(name, folder)
        about = (
            f"{name}: driver and emulator of pmabench; no real device",
            f"made by: python -m tests.captures {name}",
        )
        (FOLDER / f"{name}.txt").write_text(capture.text(about))
        print(name, len(capture.runs), *said)


main(sys.argv[1:])
