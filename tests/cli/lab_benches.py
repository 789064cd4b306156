"""Benches of a lab with two muscles on a joint and three under a platform, all devices real; made in a folder."""

from pathlib import Path

from pmabench_drivers.labjack import LabJack


class Ours(LabJack):
    """A driver of the lab's own package: a T7 that keeps times of pulses and has a drive behind it; never opened."""

    def __init__(self, *_args: object) -> None:
        raise AssertionError("a dry run made a device")

    def pulse(self, output: str, seconds: float) -> None:
        """Open a valve."""

    def halt(self, output: str) -> None:
        """Stop the drive."""


CALIBRATION = """\
schema: pmabench.calibration/1
id: {name}
quantity: {quantity}
reference: for the tests
date: 2026-11-21
points: [[0 V, {low}], [10 V, {high}]]
expanded_uncertainty: {uncertainty}
"""
CALIBRATIONS = {
    "P": ("pressure", "-50 kPa", "950 kPa", "1.5 kPa"),
    "ANGLE": ("angle", "-60 deg", "60 deg", "0.02 deg"),
    "TORQUE": ("torque", "-50 N.m", "50 N.m", "0.02 N.m"),
    "ACCELERATION": ("acceleration", "-40 m/s2", "40 m/s2", "0.01 m/s2"),
}
HEAD = """\
schema: pmabench.bench/1
name: our own {what}
free_end: {what}
time: real
vents: together
air: {{supply: 700 kPa, relief_valve: 690 kPa, overshoot: 10 kPa}}
hands: {{below: 20 kPa}}
muscles:
"""
MUSCLE = """\
  {number}: {{type: braided, serial: OURS-{number},
      limits: {{pressure: {{command: 550 kPa, never_above: 700 kPa}}, contraction: 25 %, source: ours}}}}
"""
LIMIT = "  pressure_{number}: {{command: 550 kPa, trip: 600 kPa, trip_low: -30 kPa, action: vent{low}}}\n"
JOINT = """\
joint: {stroke: [-45 deg, 45 deg], speed: 60 deg/s, pulley: 25 mm, contraction: 10 %}
devices:
  t7: {driver: labjack, address: "192.0.2.1:502", watchdog: 2 s}
  drive: {driver: "tests.cli.lab_benches:Ours", address: "192.0.2.2:502", watchdog: 2 s}
channels:
  pressure_1: {device: t7, input: AIN0, range: [-50 kPa, 900 kPa], calibration: P}
  pressure_2: {device: t7, input: AIN1, range: [-50 kPa, 900 kPa], calibration: P}
  angle: {device: t7, input: AIN2, range: [-60 deg, 60 deg], calibration: ANGLE}
  torque: {device: t7, input: AIN3, range: [-45 N.m, 45 N.m], calibration: TORQUE}
  pressure_command_1: {device: t7, input: AIN4, range: [-10 kPa, 900 kPa], calibration: P}
  pressure_command_2: {device: t7, input: AIN5, range: [-10 kPa, 900 kPa], calibration: P}
  angle_command: {device: t7, input: AIN6, range: [-60 deg, 60 deg], calibration: ANGLE}
outputs:
  pressure_1: {device: t7, output: DAC0, scale: [[0 V, 0 kPa], [5 V, 1000 kPa]], resolution: 0.00122 V}
  pressure_2: {device: t7, output: DAC1, scale: [[0 V, 0 kPa], [5 V, 1000 kPa]], resolution: 0.00122 V}
  dump_valve_1: {device: t7, output: FIO0, energised: closed}
  dump_valve_2: {device: t7, output: FIO1, energised: closed}
  angle: {device: drive, output: DAC0, scale: [[0 V, -60 deg], [5 V, 60 deg]], resolution: 0.00122 V}
interlocks:
  - {name: e-stop, input: {device: t7, input: FIO2}, safe: high}
safe_state:
  - {drive_quick_stop: angle, within: 200 ms}
  - {set: pressure_1, to: 0 kPa, within: 200 ms}
  - {set: pressure_2, to: 0 kPa, within: 200 ms}
  - {open: dump_valve_1, within: 200 ms}
  - {open: dump_valve_2, within: 200 ms}
  - {confirm: pressure_1, below: 20 kPa, within: 5 s}
  - {confirm: pressure_2, below: 20 kPa, within: 5 s}
limits:
  angle: {command: 45 deg, command_low: -45 deg, trip: 46 deg, trip_low: -46 deg, action: vent}
  torque: {trip: 40 N.m, trip_low: -40 N.m, action: vent}
"""
FREE = (
    "speed: 60 deg/s, ",
    "command: 45 deg, command_low: -45 deg, ",
    "  - {drive_quick_stop: angle, within: 200 ms}\n",
)
"""What a joint without a drive leaves out, with the device, the output and the channel of the drive."""
PLATFORM = """\
platform: {tilt: 20 deg, stops: 24 deg, circle: 55 mm, contraction: 10 %, mass: 2 kg, height: 50 mm, accelerometer: 20 mm}
devices:
  t7: {driver: "tests.cli.lab_benches:Ours", address: "192.0.2.1:502", watchdog: 2 s}
channels:
  pressure_1: {device: t7, input: AIN0, range: [-50 kPa, 900 kPa], calibration: P}
  pressure_2: {device: t7, input: AIN1, range: [-50 kPa, 900 kPa], calibration: P}
  pressure_3: {device: t7, input: AIN2, range: [-50 kPa, 900 kPa], calibration: P}
  acceleration_x: {device: t7, input: AIN3, range: [-30 m/s2, 30 m/s2], calibration: ACCELERATION}
  acceleration_y: {device: t7, input: AIN4, range: [-30 m/s2, 30 m/s2], calibration: ACCELERATION}
  acceleration_z: {device: t7, input: AIN5, range: [-30 m/s2, 30 m/s2], calibration: ACCELERATION}
outputs:
  fill_1: {device: t7, output: FIO0, energised: open, pulse: 20 ms}
  fill_2: {device: t7, output: FIO1, energised: open, pulse: 20 ms}
  fill_3: {device: t7, output: FIO2, energised: open, pulse: 20 ms}
  exhaust_1: {device: t7, output: FIO3, energised: open, pulse: 20 ms}
  exhaust_2: {device: t7, output: FIO4, energised: open, pulse: 20 ms}
  exhaust_3: {device: t7, output: FIO5, energised: open, pulse: 20 ms}
  supply_valve: {device: t7, output: FIO6, energised: open}
  dump_valve: {device: t7, output: FIO7, energised: closed}
safe_state:
  - {close: supply_valve, within: 200 ms}
  - {open: dump_valve, within: 200 ms}
  - {confirm: pressure_1, below: 20 kPa, within: 5 s}
  - {confirm: pressure_2, below: 20 kPa, within: 5 s}
  - {confirm: pressure_3, below: 20 kPa, within: 5 s}
limits:
"""


def lab_bench(folder: Path, what: str, *changes: tuple[str, str]) -> Path:
    """The file of a `joint`, a `free joint` or a `platform`, with pieces of its text changed."""
    (folder / "calibrations").mkdir(exist_ok=True)
    for name, (quantity, low, high, uncertainty) in CALIBRATIONS.items():
        text = CALIBRATION.format(name=name, quantity=quantity, low=low, high=high, uncertainty=uncertainty)
        (folder / "calibrations" / f"{name}.yaml").write_text(text)
    kind, count = what.split()[-1], 3 if what == "platform" else 2
    low = ", command_low: 20 kPa" if what == "platform" else ""
    text = HEAD.format(what=kind) + "".join(MUSCLE.format(number=i + 1) for i in range(count))
    text += {"joint": JOINT, "platform": PLATFORM}[kind]
    text += "".join(LIMIT.format(number=i + 1, low=low) for i in range(count))
    if what == "free joint":
        text = without_drive(text)
    for old, new in changes:
        assert text.count(old), old
        text = text.replace(old, new)
    path = folder / "ours.yaml"
    path.write_text(text)
    return path


def without_drive(text: str) -> str:
    """A joint that turns freely."""
    for piece in FREE:
        text = text.replace(piece, "")
    gone = ("  drive: ", "  angle_command: ", "  angle: {device: drive")
    return "".join(f"{line}\n" for line in text.splitlines() if not line.startswith(gone))
