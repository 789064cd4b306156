"""What a bench file may say about a bus, and what is wrong with it, each with its place."""

import shutil
from dataclasses import replace

import pytest
from pmabench_drivers.canbus import CanBus

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import InterlockRecord, ValveRecord
from pmabench.files.shipped import shipped_folder
from tests.drivers.can.rigs import NODES, bus, channel
from tests.drivers.can.test_dbc import LOAD_CELL

DRIVE = NODES["drive"]


def problems(record):
    return {".".join(map(str, place)): message for place, message in CanBus.check(record)}


def test_the_rigs_are_right():
    assert problems(bus()) == {}
    cell = channel("force", "force", "LoadCell.Force", unit="N")
    assert problems(bus(nodes={}, dbc=LOAD_CELL, channels=(cell,))) == {}


@pytest.mark.parametrize(
    ("record", "place", "message"),
    [
        (bus("127.0.0.1:15805"), "address", 'INTERFACE:CHANNEL is expected, for instance "socketcan:can0"'),
        (bus("kvaser:can0"), "address", "needs the number of its channel"),
        (bus("slcan:socket://nowhere"), "address", "slcan:socket://HOST:PORT"),
        (bus(bitrate=123_456), "options.bitrate", "not possible here"),
        (bus(sync="1 us"), "options.sync", "outside 0.002 to 0.1 s"),
        (bus(sync="30.5 ms"), "options.sync", "whole milliseconds"),
        (bus(own_node=5), "options.nodes.drive.node", "the number of the program itself"),
        (bus(nodes={"drive": {**DRIVE, "node": 12}, "t": {"profile": 406, "node": 12}}), "options.nodes.t.node", "two nodes"),
        (bus(nodes={"drive": {**DRIVE, "profile": 401}}), "options.nodes.drive.profile", "402 .drive. or 406"),
        (bus(nodes={"drive": {"profile": 402, "node": 5}}), "options.nodes.drive", '"approach" is missing'),
        (bus(nodes={"drive": {**DRIVE, "approach": "fast"}}), "options.nodes.drive.approach", "a speed with its unit"),
        (bus(nodes={"drive": {**DRIVE, "approach": "500 mm/s"}}), "options.nodes", "above the bench's 200 mm/s"),
        (bus(nodes={"drive": {**DRIVE, "speed": "5 mm/s"}}), "options.nodes.drive.speed", "unknown key"),
        (bus(nodes={}, channels=()), "options", '"nodes" or "dbc" is needed'),
        (bus(dbc="BO_ A: 8 X"), "options.dbc", "the DBC file line 1: no message can be read"),
        (bus(channels=(channel("x", "length", "drive.positon"),)), "channels.x.input", "drive.position"),
        (bus(watchdog=0.001), "watchdog", "50 ms to 60 s"),
        (replace(bus(), valves=(ValveRecord("v", "bus", "drive.brake"),)), "outputs.v.output", "switches a valve"),
        (replace(bus(), interlocks=(InterlockRecord("d", "bus", "drive.redy"),)), "interlocks.d.input", "drive.ready"),
        (replace(bus(), outputs=(replace(bus().outputs[0], rate=0.0),)), "outputs.displacement.output", "highest speed"),
        (replace(bus(), outputs=(replace(bus().outputs[0], resolution=0.0),)), "outputs.displacement.resolution", "whole steps"),
        (replace(bus(), outputs=(replace(bus().outputs[0], output="transducer.position"),)), "outputs.displacement.output", "no output"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported_at_its_place(record, place, message):
    import re

    found = problems(record)
    assert place in found, found
    assert re.search(message, found[place]), found[place]
    with pytest.raises(DeviceError):
        CanBus(record, RealClock())


@pytest.fixture
def folder(tmp_path):
    """The shipped bench with its calibrations, the force from a CAN sensor that a DBC file describes."""
    shutil.copytree(shipped_folder("bench") / "calibrations", tmp_path / "calibrations")
    text = (shipped_folder("bench") / "can.yaml").read_text()
    text = text.replace("      sync: 10 ms\n", "      sync: 10 ms\n      dbc: cell.dbc\n")
    text = text.replace(
        "{device: board, input: a2, range: [-50 N, 1950 N], at: fixed end, calibration: LINE-F}",
        "{device: bus, input: LoadCell.Force, range: [-50 N, 1950 N], at: fixed end, unit: N}",
    )
    (tmp_path / "bench.yaml").write_text(text)
    (tmp_path / "cell.dbc").write_bytes(LOAD_CELL.replace("Cell Bench", 'Cell Bench\nCM_ "°";').encode("latin-1"))
    return tmp_path


def test_a_dbc_file_next_to_the_bench_file_is_read_and_kept(folder):
    mounted = mount(folder / "bench.yaml", shipped_folder("specimen") / "mas-20-250-paper0.yaml")
    [device] = [device for device in mounted.bench.devices if device.name == "bus"]
    assert device.options["dbc"].startswith('VERSION "1"')
    assert mounted.documents["cell.dbc"] == device.options["dbc"]
    assert problems(device) == {}


@pytest.mark.parametrize(
    ("name", "message"),
    [("../cell.dbc", "a .dbc file next to this one"), ("/etc/passwd", "a .dbc file next to this one"), ("no.dbc", "cannot read")],
)  # fmt: skip
def test_another_file_is_refused_at_its_place(folder, name, message):
    path = folder / "bench.yaml"
    path.write_text(path.read_text().replace("dbc: cell.dbc", f"dbc: {name}"))
    with pytest.raises(InvalidFile, match=message) as raised:
        mount(path, shipped_folder("specimen") / "mas-20-250-paper0.yaml")
    assert ":31:" in str(raised.value) or "dbc" in str(raised.value)
