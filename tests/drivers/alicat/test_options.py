"""What a bench file says of a controller is checked before anything is opened."""

from dataclasses import replace

import pytest
from pmabench_drivers.alicat import AlicatController

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import Follower, Rescue, Scale, SetPoint, Stream, Switch, Watchdog
from pmabench.files.shipped import find_file, shipped_folder
from tests.drivers.alicat.rigs import controller

SPECIMEN = find_file("specimen", "mas-20-250-paper0")
WRONG = {
    "no protocol": ({"protocol": "tcp"}, ("options", "protocol"), "is not known here"),
    "an unknown key": ({"watchdog": "1 s"}, ("options", "watchdog"), "unknown key"),
    "a slow line": ({"baud": 9600}, ("options", "baud"), "from 19200"),
    "a rate of its own": ({"baud": 20000}, ("options", "baud"), "not possible here"),
    "a number for a letter": ({"unit_id": "12"}, ("options", "unit_id"), "one letter"),
    "three valves": ({"valves": 3}, ("options", "valves"), "from 1 to 2"),
    "a long time-out": ({"timeout": "1 s"}, ("options", "timeout"), "outside 0.01 to 0.1 s"),
    "a unit of flow": ({"unit": "SLPM"}, ("options", "unit"), "no unit of pressure"),
    "another unit": ({"unit": "psi"}, ("channels", "pressure", "input"), 'the device speaks "psi"'),
    "a letter for a number": (
        {"protocol": "modbus", "unit": "kPa", "unit_id": "A"},
        ("options", "unit_id"),
        "1 to 247",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_options_are_named(name):
    options, place, said = WRONG[name]
    record = controller("/dev/ttyUSB0")
    record = replace(record, options={**record.options, **options})
    problems = list(AlicatController.check(record))
    assert any(found == place and said in message for found, message in problems), problems
    with pytest.raises(DeviceError):
        AlicatController(record, RealClock())


def test_good_options_pass():
    for protocol in ("ascii", "modbus"):
        for unit in ("kPa", "bar", "psi"):
            assert list(AlicatController.check(controller("/dev/ttyUSB0", protocol, unit))) == []


def test_over_modbus_the_unit_must_be_said():
    record = controller("/dev/ttyUSB0", "modbus")
    options = {key: value for key, value in record.options.items() if key != "unit"}
    [(place, message)] = AlicatController.check(replace(record, options=options))
    assert place == ("options",)
    assert "look at its display" in message


def test_channels_and_outputs_are_those_of_a_controller():
    record = controller("/dev/ttyUSB0")
    pressure, command = record.channels
    [output] = record.outputs
    for changed, place, said in (
        (replace(record, address="COM3:"), ("address",), "path of a serial port"),
        (
            replace(record, channels=(replace(pressure, input="flow"), command)),
            ("channels", "pressure", "input"),
            'no input "flow"',
        ),
        (
            replace(record, channels=(replace(pressure, reference="absolute"), command)),
            ("channels", "pressure", "input"),
            "only gauge pressure",
        ),
        (
            replace(record, outputs=(replace(output, output="dump"),)),
            ("outputs", "pressure", "output"),
            'no output "dump"',
        ),
        (
            replace(record, outputs=(replace(output, scale=Scale(6894.757)),)),
            ("outputs", "pressure", "output"),
            "the device speaks kPa",
        ),
        (
            replace(record, outputs=(output, replace(output, name="second"))),
            ("outputs", "second", "output"),
            "one set-point",
        ),
    ):
        problems = list(AlicatController.check(changed))
        assert [found for found, _ in problems] == [place], problems
        assert said in problems[0][1]


def test_it_says_what_it_can_and_nothing_more():
    """No watchdog and no second way: who needs one must know."""
    assert all(issubclass(AlicatController, kind) for kind in (Stream, SetPoint, Follower))
    assert not any(issubclass(AlicatController, kind) for kind in (Watchdog, Switch, Rescue))


@pytest.fixture
def copied(tmp_path):
    folder = shipped_folder("bench")
    (tmp_path / "calibrations").symlink_to(folder / "calibrations")
    path = tmp_path / "bench.yaml"
    path.write_text((folder / "alicat.yaml").read_text())
    return path


def test_the_shipped_bench_passes_and_a_watchdog_is_refused(copied):
    mounted = mount(copied, SPECIMEN)
    devices = {device.name: device for device in mounted.bench.devices}
    assert devices["controller"].watchdog == 0.0
    assert devices["relay"].watchdog == 0.5
    assert [valve.name for valve in devices["relay"].valves] == ["dump_valve"]
    copied.write_text(copied.read_text().replace("    driver: alicat\n", "    driver: alicat\n    watchdog: 500 ms\n"))
    with pytest.raises(InvalidFile, match='the driver "alicat" has no watchdog'):
        mount(copied, SPECIMEN)


def test_without_its_acceptance_the_shipped_bench_names_what_it_lacks(copied):
    text = copied.read_text()
    begin, end = text.index("no_watchdog:"), text.index("safe_state:")
    copied.write_text(text[:begin] + text[end:])
    lacks = " ".join(mount(copied, SPECIMEN).lacks)
    assert "no watchdog of controller" in lacks
    assert "relay" not in lacks
