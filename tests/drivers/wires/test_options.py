"""What a bench file says of a device is checked before anything is opened: all of it, each with its place."""

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pmabench_drivers.modbus import ModbusDevice
from pmabench_drivers.modbus.registers import TABLES, TYPES
from pmabench_drivers.serial_ascii import SerialIndicator

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, InvalidFile
from pmabench.bench.compile import mount
from pmabench.files.shipped import shipped_folder
from tests.drivers.wires.rigs import MAP, cell, gauge, regulator

INPUT = {"table": "input", "address": 0}
WRONG_MAPS = {
    "an unknown key": ({"wrds": "big"}, ("options", "map", "wrds"), "unknown key"),
    "an unknown order": ({"words": "big"}, ("options", "map", "words"), "is not known here"),
    "no unit of time": ({"timeout": 100}, ("options", "map", "timeout"), 'for instance "100 ms"'),
    "a time-out longer than a call": ({"timeout": "3 s"}, ("options", "map", "timeout"), "outside 0.002 to 0.2 s"),
    "an address out of range": (
        {"inputs": {"pressure": {"table": "input", "address": 65536}}},
        ("options", "map", "inputs", "pressure", "address"),
        "from 0 to 65535",
    ),
    "a value beyond the last address": (
        {"inputs": {"pressure": {**INPUT, "address": 65535, "type": "float32"}}},
        ("options", "map", "inputs", "pressure", "address"),
        "beyond address 65535",
    ),
    "an unknown type": (
        {"inputs": {"pressure": {**INPUT, "type": "float"}}},
        ("options", "map", "inputs", "pressure", "type"),
        'did you mean "float32"',
    ),
    "an output that cannot be written": (
        {"outputs": {"pressure": {"table": "input", "address": 1}}},
        ("options", "map", "outputs", "pressure", "table"),
        "is not known here",
    ),
    "an output that cannot be read": (
        {"outputs": {"pressure": {"address": 1, "read_back": False}}},
        ("options", "map", "outputs", "pressure", "read_back"),
        "unknown key",
    ),
    "a bit of a float": (
        {"inputs": {"pressure": {**INPUT, "type": "float32", "bit": 1}}},
        ("options", "map", "inputs", "pressure", "bit"),
        "only an input register",
    ),
    "an uptime that begins again": ({"uptime": INPUT}, ("options", "map", "uptime", "type"), "needs 32 bits"),
    "a channel without register": ({"inputs": {"presure": INPUT}}, ("channels", "pressure", "input"), "did you mean"),
    "an output without register": (
        {"outputs": {"dump": {"address": 1}}},
        ("outputs", "pressure", "output"),
        "no output",
    ),
    "a range that does not fit": (
        {"outputs": {"pressure": {"address": 1, "type": "int16"}, "dump": {"table": "coil", "address": 0}}},
        None,
        None,
    ),
    "an interlock without register": (
        {"inputs": {"pressure": INPUT}},
        ("interlocks", "e-stop", "input"),
        'no input "e_stop"',
    ),
    "two outputs at one register": (
        {"outputs": {**MAP["outputs"], "pressure": MAP["outputs"]["dump"]}},
        ("outputs", "dump_valve", "output"),
        'is the register of "pressure" in the map, too',
    ),
    "a watchdog without registers": ({"watchdog": None}, ("watchdog",), 'no "watchdog"'),
    "a trigger value that does not fit": (
        {"watchdog": {**MAP["watchdog"], "on": 70000}},
        ("options", "map", "watchdog", "on"),
        "does not fit",
    ),
}


@pytest.mark.parametrize("what", WRONG_MAPS)
def test_a_wrong_map_is_named_at_its_place(what):
    changes, place, message = WRONG_MAPS[what]
    record = regulator(**changes)
    found = list(ModbusDevice.check(record))
    if place is None:
        assert found == []  # 600 kPa fit 16 bits with sign
        return
    assert any(at == place and message in text for at, text in found), found
    with pytest.raises(DeviceError, match="^regulator: "):
        ModbusDevice(record, RealClock())


def test_a_good_map_has_no_problem_and_all_problems_come_at_once():
    assert list(ModbusDevice.check(regulator())) == []
    found = list(ModbusDevice.check(regulator(wrds=1, timeout="1 h", unit_id=300)))
    assert len(found) == 3


def test_a_device_without_the_functions_for_single_writes_is_written_by_the_others():
    written = {}
    for single in (True, False):
        device = ModbusDevice(regulator(write_single=single), RealClock())
        words = {"timeout": device._map.watchdog.timeout, **device._map.outputs}
        written[single] = {name: device._function(register) for name, register in words.items()}
    assert written == {
        True: {"timeout": 6, "pressure": 16, "dump": 5},
        False: {"timeout": 16, "pressure": 16, "dump": 15},
    }


SCHEMA = jsonschema.Draft202012Validator(ModbusDevice.map_schema())
BEYOND_A_SCHEMA = {
    "a value beyond the last address",
    "a bit of a float",
    "a time-out longer than a call",
    "a channel without register",
    "an output without register",
    "a range that does not fit",
    "an interlock without register",
    "two outputs at one register",
    "a watchdog without registers",
    "a trigger value that does not fit",
}
"""What is wrong only beside other values or other files."""


@pytest.mark.parametrize("what", [*WRONG_MAPS])
def test_the_schema_of_maps_refuses_what_it_can(what):
    data = {**MAP, **WRONG_MAPS[what][0]}
    if data["watchdog"] is None:
        del data["watchdog"]
    fits = SCHEMA.is_valid(data)
    assert fits == (what in BEYOND_A_SCHEMA)


REGISTERS = st.fixed_dictionaries(
    {"address": st.one_of(st.integers(-1, 65536), st.sampled_from(["0x10", "ten"]))},
    optional={
        "table": st.sampled_from([*TABLES, "coils"]),
        "type": st.sampled_from(["bit", *TYPES, "text", "float"]),
        "words": st.sampled_from(["high-first", "low-first", "big"]),
        "bit": st.integers(-1, 32),
        "length": st.integers(0, 61),
        "expect": st.sampled_from([1, 2.5, "0x1F", "1F"]),
    },
)


@settings(max_examples=100)
@given(use=st.sampled_from(["inputs", "outputs", "identity"]), register=REGISTERS)
def test_every_register_that_is_read_fits_the_schema(use, register):
    """Nothing that the driver takes is marked as a mistake by an editor."""
    name = "model" if use == "identity" else "extra"
    data = {**MAP, use: {**MAP[use], name: register}}
    if list(ModbusDevice.check(regulator(**{use: data[use]}))) == []:
        SCHEMA.validate(data)


@pytest.mark.parametrize(
    "address", ["", "regulator", "192.168.0.10", "regulator.example:502", "127.0.0.1:99999", "COM3x:", ":502"]
)
def test_an_address_is_a_number_with_a_port_or_a_path(address):
    [(place, message)] = ModbusDevice.check(regulator(address))
    assert place == ("address",)
    assert '"192.168.0.10:502"' in message


@pytest.mark.parametrize("address", ["192.168.0.10:502", "127.0.0.1:15020", "localhost:502", "/dev/ttyUSB0"])
def test_addresses_that_are_taken(address):
    assert list(ModbusDevice.check(regulator(address))) == []


@pytest.mark.parametrize(
    ("changes", "key", "message"),
    [
        ({"pattern": r"(?P<value>(\d+)+)"}, "pattern", "repeats a group"),
        ({"baud": 9601}, "baud", "not possible here"),
        ({"rate": "10"}, "rate", "with its unit"),
        ({"terminator": ""}, "terminator", "what ends a line"),
        ({"poll": "µ"}, "poll", "ASCII"),
        ({"good_status": ["OK"], "pattern": r"(?P<value>\d+)"}, "good_status", 'no group "status"'),
        ({"errors": ["E1"]}, "errors", "what they mean"),
        ({"emulate": "%s %s"}, "emulate", "one number"),
        ({"pool": "P"}, "pool", 'did you mean "poll"'),
    ],
)
def test_a_wrong_option_of_an_indicator_is_named_at_its_place(changes, key, message):
    found = list(SerialIndicator.check(cell("/dev/ttyUSB0", **changes)))
    assert any(at == ("options", key) and message in text for at, text in found), found


def test_good_indicators_have_no_problem():
    assert list(SerialIndicator.check(cell("/dev/ttyUSB0"))) == []
    assert list(SerialIndicator.check(gauge("/dev/ttyUSB1"))) == []


# -- through the files ----------------------------------------------------------------------------------------------

SPECIMEN = shipped_folder("specimen") / "mas-20-250-paper0.yaml"


def bench(tmp_path, old="", new="", registers=("", "")):
    folder = shipped_folder("bench")
    text = (folder / "wires.yaml").read_text()
    assert old in text
    (tmp_path / "wires.yaml").write_text(text.replace(old, new, 1) if old else text)
    (tmp_path / "calibrations").symlink_to(folder / "calibrations")
    map_text = (folder / "registers" / "pressure-regulator.yaml").read_text()
    assert registers[0] in map_text
    (tmp_path / "registers").mkdir()
    (tmp_path / "registers" / "pressure-regulator.yaml").write_text(map_text.replace(*registers, 1))
    return tmp_path / "wires.yaml"


def problems(path):
    with pytest.raises(InvalidFile) as caught:
        mount(path, SPECIMEN)
    return [str(problem) for problem in caught.value.problems]


def test_the_shipped_bench_compiles_and_keeps_the_map_in_the_snapshot(tmp_path):
    mounted = mount(bench(tmp_path), SPECIMEN)
    regulator_ = next(device for device in mounted.bench.devices if device.name == "regulator")
    assert regulator_.options["map"]["outputs"]["dump_valve"] == {"table": "coil", "address": 0}
    assert regulator_.guarded
    assert "pmabench.registers/1" in mounted.documents["registers/pressure-regulator.yaml"]
    assert type(mounted.bench).from_json(mounted.bench.to_json()) == mounted.bench


def test_a_mistake_in_the_map_is_reported_with_line_and_column_of_the_map(tmp_path):
    [problem] = problems(bench(tmp_path, registers=("type: float32", "type: flaot32")))
    place, _, message = problem.partition("  ")
    line = int(place.split(":")[1])
    assert "registers/pressure-regulator.yaml" in place
    assert "flaot32" in (tmp_path / "registers" / "pressure-regulator.yaml").read_text().splitlines()[line - 1]
    assert message == '"flaot32" is not known here; did you mean "float32"?'


def test_mistakes_in_the_bench_file_are_reported_there(tmp_path):
    found = problems(bench(tmp_path, "input: e_stop", "input: e_stp"))
    assert len(found) == 1
    assert "wires.yaml:" in found[0]
    assert 'no input "e_stp"; did you mean "e_stop"?' in found[0]


@pytest.mark.parametrize("name", ["registers/nothing.yaml", "../elsewhere.yaml", "/etc/passwd", "registers"])
def test_a_map_that_cannot_be_read_is_one_problem(tmp_path, name):
    assert len(problems(bench(tmp_path, "registers/pressure-regulator.yaml", name))) == 1
