"""Bench files that are wrong in one place, made from the right ones of five rigs."""

import json
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from itertools import combinations

from ruamel.yaml import YAML

from pmabench.files.shipped import shipped_folder

RIGS = ("labjack", "festo-sine", "serial", "can", "ni")
SESSION = {
    "self_test": {"step": "25 kPa", "settle": "1.5 s", "load": "6 kg"},
    "zeros": {"pressure": {"most": "5 kPa"}, "force": {"most": "5 N"}},
}
"""For the LabJack's bench, which has none."""
ELSEWHERE = {
    "labjack": {"pressure": "DAC1", "dump_valve": "FIO2"},
    "festo-sine": {"pressure": "ao4.1", "dump_valve": "do2.1"},
    "serial": {"dump_valve": "v1"},
    "can": {"pressure": "o1", "dump_valve": "v1"},
    "ni": {"pressure": "ao1"},
}
"""Other terminals for outputs."""
OFFSETS = {"pressure": 60e3, "force": 110.0, "displacement": 11e-3, "displacement_command": 11e-3}
"""Just above 5 % of the range of pressure or force, above 10 mm [SI]."""
UNITS = {"pressure": ("kPa", 1e3), "force": ("N", 1.0), "displacement": ("mm", 1e-3)}


@dataclass(frozen=True)
class Fault:
    """What is wrong in a file, and how the terminal (device.input) is called that must be named."""

    name: str
    damage: Callable
    terminals: tuple

    def wrong_file(self, right, folder):
        """A copy of the bench file `right` with the fault, in `folder`, with calibrations of its own."""
        folder.mkdir(parents=True)
        for folder_name in ("calibrations", "registers"):
            shutil.copytree(shipped_folder("bench") / folder_name, folder / folder_name)
        bench = plain(right)
        self.damage(bench, folder)
        write(folder / right.name, bench)
        return folder / right.name


def plain(path):
    """A YAML file as plain data."""
    return deepcopy(_loaded(path.read_text()))


@cache
def _loaded(text):
    """A shipped file is read for each of its faults."""
    return YAML(typ="safe", pure=True).load(text)


def write(path, data):
    """Plain data as JSON, which is YAML, and written ten times as fast."""
    path.write_text(json.dumps(data, default=str))


def quantity_of(name):
    return name.removesuffix("_command")


def rescaled(name, slope=1.0, offset=0.0):
    """The calibration of a channel with SI -> slope SI + offset."""

    def damage(bench, folder):
        channel = bench["channels"][name]
        unit, factor = UNITS[quantity_of(name)]
        if "calibration" in channel:
            calibration = plain(folder / "calibrations" / f"{channel['calibration']}.yaml")
        else:
            raw = channel.pop("unit")
            calibration = {
                "schema": "pmabench.calibration/1", "quantity": "pressure", "reference": "made for a test",
                "date": "2026-11-22", "expanded_uncertainty": "1 kPa",
                "points": [[f"0 {raw}", "0 kPa"], [f"1000 {raw}", f"{ {'kPa': 1000, 'hPa': 100}[raw]} kPa"]],
            }  # fmt: skip
        calibration["id"] = channel["calibration"] = f"WRONG-{name}".upper().replace("_", "-")
        (low, below), (high, above) = [(raw.split(), si.split()) for raw, si in calibration["points"]]
        points = []
        for share in (-12.0, 13.0):  # far beyond the range, so that `check` has nothing to say about it
            raw = float(low[0]) + share * (float(high[0]) - float(low[0]))
            si = float(below[0]) + share * (float(above[0]) - float(below[0]))
            points.append([f"{raw:.9g} {low[1]}", f"{slope * si + offset / factor:.9g} {unit}"])
        calibration["points"] = points
        write(folder / "calibrations" / f"{calibration['id']}.yaml", calibration)

    return damage


def exchanged(one, other):
    """Two channels with each other's input."""

    def damage(bench, _folder):
        a, b = bench["channels"][one], bench["channels"][other]
        for key in ("device", "input"):
            a[key], b[key] = b[key], a[key]

    return damage


def output(name, slope=1.0, **changes):
    """An output with other entries; `slope` multiplies what the same raw value is said to make."""

    def damage(bench, _folder):
        given = bench["outputs"][name]
        given |= changes
        if slope != 1.0:
            scale = [(raw, *si.split()) for raw, si in given["scale"]]
            given["scale"] = [[raw, f"{float(value) * slope:.9g} {unit}"] for raw, value, unit in scale]

    return damage


def faults_of(rig, bench):
    """Every fault of a rig whose right bench file has the plain data `bench`."""
    channels, outputs = bench["channels"], bench["outputs"]
    reads = {name: f"{entry['device']}.{entry['input']}" for name, entry in channels.items()}
    sets = {name: f"{entry['device']}.{entry['output']}" for name, entry in outputs.items()}
    found = []
    for name, terminal in reads.items():
        for slope in (-1.0, 0.1, 0.5, 2.0, 10.0):
            word = "sign" if slope < 0 else f"slope {slope:g}"
            found.append(Fault(f"{name}: {word}", rescaled(name, slope), (terminal,)))
        for off in (OFFSETS[name], -OFFSETS[name]) if name in OFFSETS else ():
            found.append(Fault(f"{name}: offset {off:+g}", rescaled(name, offset=off), (terminal,)))
    for one, other in combinations(channels, 2):
        device = channels[one]["device"]
        if device == channels[other]["device"] and bench["devices"][device]["driver"] != "can":
            both = (f"{reads[one]} and {reads[other]}", f"{reads[other]} and {reads[one]}")
            found.append(Fault(f"{one} and {other} exchanged", exchanged(one, other), both))
    driven = ["displacement"] if "displacement" in outputs else []
    for name in ("pressure", *driven):
        for slope in (0.1, 0.5, 2.0, 10.0):
            found.append(Fault(f"output {name}: slope {slope:g}", output(name, slope), (sets[name],)))
    found += [Fault(f"output {name}: sign", output(name, -1.0), (sets[name],)) for name in driven]
    for name, other in ELSEWHERE[rig].items():
        wire = f"{outputs[name]['device']}.{other}"
        found.append(Fault(f"output {name} at {other}", output(name, output=other), (wire,)))
    inverted = output("dump_valve", energised="open")
    return [*found, Fault("dump_valve: energised open", inverted, (sets["dump_valve"],))]


def right_file(rig, folder):
    """The right bench file of a rig, with a session."""
    bench = plain(shipped_folder("bench") / f"{rig}.yaml")
    bench.setdefault("session", SESSION)
    folder.mkdir(parents=True, exist_ok=True)
    for folder_name in ("calibrations", "registers"):
        if not (folder / folder_name).exists():
            (folder / folder_name).symlink_to(shipped_folder("bench") / folder_name)
    write(folder / f"{rig}.yaml", bench)
    return folder / f"{rig}.yaml"
