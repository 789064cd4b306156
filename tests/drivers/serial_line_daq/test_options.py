"""What a bench file says of a board is checked before anything is opened, each with its place."""

from dataclasses import replace

import pytest
from pmabench_drivers.serial_line_daq import SerialLineDaq

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import Scale
from pmabench.files.shipped import shipped_folder
from tests.drivers.serial_line_daq.rigs import board

RIG = board("/dev/ttyACM0")
SPECIMEN = shipped_folder("specimen") / "mas-20-250-paper0.yaml"


def changed(what, **changes):
    return replace(RIG, **{what: tuple(replace(item, **changes) for item in getattr(RIG, what))})


WRONG = {
    "an unknown key": (replace(RIG, options={"bauds": 1}), ("options", "bauds"), "did you mean"),
    "no usual rate": (replace(RIG, options={"baud": 12345}), ("options", "baud"), "not possible here"),
    "no address": (replace(RIG, address=""), ("address",), "/dev/ttyACM0"),
    "no such input": (changed("channels", input="a6"), ("channels", "pressure", "input"), "a0 to a5"),
    "no such level": (changed("interlocks", input="e_stop"), ("interlocks", "e-stop", "input"), "d0 to d5"),
    "no such output": (changed("outputs", output="pressure"), ("outputs", "pressure", "output"), "o0 to o3"),
    "no such valve": (changed("valves", output="o0"), ("outputs", "dump_valve", "output"), "v0 to v3"),
    "parts of a count": (changed("outputs", resolution=0.0), ("outputs", "pressure"), "resolution: 1 count"),
    "a safe value that is not at 0": (changed("outputs", scale=Scale(1e3, 5e4)), ("outputs", "pressure"), "vents to 0"),
    "a valve that stays shut": (
        changed("valves", energised="open"),
        ("outputs", "dump_valve", "energised"),
        "without power",
    ),
    "no watchdog": (replace(RIG, watchdog=0.0), (), 'add "watchdog: 500 ms"'),
    "too long a watchdog": (replace(RIG, watchdog=1.5), ("watchdog",), "50 ms to 1 s"),
}


@pytest.mark.parametrize(("record", "place", "says"), WRONG.values(), ids=WRONG)
def test_each_mistake_has_its_place_and_the_driver_refuses_it_too(record, place, says):
    [problem] = [(where, text) for where, text in SerialLineDaq.check(record) if says in text][:1]
    assert problem[0] == place
    with pytest.raises(DeviceError):
        SerialLineDaq(record, RealClock())


def test_a_board_that_only_measures_needs_no_watchdog():
    record = replace(RIG, outputs=(), valves=(), interlocks=(), watchdog=0.0)
    assert list(SerialLineDaq.check(record)) == list(SerialLineDaq.check(RIG)) == []


def test_the_shipped_bench_is_right_and_a_mistake_in_it_is_reported_with_its_line(tmp_path):
    path = shipped_folder("bench") / "serial-line-daq.yaml"
    mounted = mount(path, SPECIMEN)
    [device] = mounted.bench.devices
    assert device.watchdog == 0.5
    text = path.read_text()
    folder = tmp_path / "calibrations"
    folder.mkdir()
    for file in (path.parent / "calibrations").glob("LINE-*"):
        (folder / file.name).write_text(file.read_text())
    wrong = tmp_path / "bench.yaml"
    wrong.write_text(text.replace("input: a0", "input: a9").replace("watchdog: 500 ms", "watchdog: 2 s"))
    with pytest.raises(InvalidFile) as error:
        mount(wrong, SPECIMEN)
    said = str(error.value)
    for line, part in (("input: a0", "a0 to a5"), ("watchdog: 500 ms", "50 ms to 1 s")):
        number = next(i for i, row in enumerate(text.splitlines(), 1) if line in row)
        assert any(f":{number}:" in row and part in row for row in said.splitlines()), said
