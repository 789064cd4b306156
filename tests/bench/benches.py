"""A real bench file with every key about safety, for tests: shipped mock bench below, its calibrations copied."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCHES = ROOT / "fixtures" / "benches"
SPECIMEN = ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"

RIG = """\
schema: pmabench.bench/1
name: rig 3
free_end: weights
weights: {hanger: 1.1 kg, plates: [10 x 5 kg], catch_height: 50 mm}
air: {supply: 690 kPa, relief_valve: 680 kPa, overshoot: 10 kPa}
devices:
  daq: {driver: mock-realtime, watchdog: 1 s}
channels:
  pressure: {device: daq, input: pressure, range: [0 count, 65535 count], calibration: MOCK-P}
  displacement: {device: daq, input: displacement, range: [-5 mm, 90 mm], calibration: MOCK-X}
  force: {device: daq, input: force, range: [0 count, 65535 count], at: fixed end, calibration: MOCK-F}
  supply: {device: daq, input: supply, range: [0 kPa, 1000 kPa], unit: Pa}
outputs:
  pressure: {device: daq, output: pressure, scale: [[0 V, 0 kPa], [10 V, 1000 kPa]]}
  dump_valve: {device: daq, output: dump_valve, energised: closed}
interlocks:
  - {name: e-stop, input: {device: daq, input: e_stop}, safe: high}
limits:
  pressure: {command: 600 kPa, trip: 650 kPa, trip_low: -30 kPa, delay: 4 ms, action: vent}
  contraction: {trip: 25 %, action: vent}
  force: {trip: 1900 N, action: stop}
watch:
  - {stale: pressure, for: 100 ms, action: vent}
  - {frozen: pressure, for: 5 s, action: stop}
  - {off_range: force, action: vent}
  - {rate: pressure, faster_than: 5000 kPa/s, for: 20 ms, action: vent}
  - {rate: force, faster_than: 50000 N/s, action: warn}
  - {following: pressure, more_than: 60 kPa, for: 2 s, action: hold}
  - {burst: pressure, falls: 60 kPa, within: 50 ms, action: vent}
  - {slack: force, below: 1 N, for: 100 ms, action: warn}
safe_state:
  - {ramp_down: pressure, at: 500 kPa/s, within: 2 s}
  - {hold: 100 ms}
  - {set: pressure, to: 0 kPa, within: 200 ms}
  - {open: dump_valve, within: 200 ms}
  - {confirm: pressure, below: 20 kPa, within: 5 s}
stop: {ramp: 500 kPa/s}
proof: {pressure: 50 kPa, below: 20 kPa, within: 2 s}
setup_pressure: 80 kPa
hands: {below: 20 kPa}
session:
  self_test: {}
  warm_up: {pressure: 300 kPa}
  zeros: {pressure: {most: 5 kPa}, force: {most: 5 N}, displacement: {most: 0.5 mm, at: free end on its support}}
"""
"""A bench that lacks nothing."""


def rig(folder: Path, changes: str = "", **replaced: str) -> Path:
    """The rig in `folder`; `replaced` are old texts and new ones by turns of `old=`, `new=`; `changes` go on top."""
    calibrations = folder / "calibrations"
    calibrations.mkdir(exist_ok=True)
    for file in (BENCHES / "calibrations").iterdir():
        (calibrations / file.name).write_text(re.sub(r"gain_uncertainty:.*\n", "", file.read_text()))
    text = RIG
    if replaced:
        assert replaced["old"] in text, f"{replaced['old']} does not stand in the rig"
        text = text.replace(replaced["old"], replaced["new"])
    (folder / "rig.yaml").write_text(text)
    if not changes:
        return folder / "rig.yaml"
    path = folder / "bench.yaml"
    path.write_text("include: rig.yaml\n" + changes)
    return path


def specimen(folder: Path, old: str = "", new: str = "") -> Path:
    """The specimen of paper 0 with one text replaced."""
    text = SPECIMEN.read_text()
    assert old in text, f"{old} does not stand in the specimen"
    path = folder / "specimen.yaml"
    path.write_text(text.replace(old, new) if old else text)
    return path
