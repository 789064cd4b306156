"""mbpoll (libmodbus) reads and writes every Modbus emulator: values, order of words, exceptions; over TCP and RTU."""

import re
import shutil
import subprocess
from contextlib import contextmanager

import pytest
from pmabench_drivers.emulator import Emulator

from tests.drivers.alicat.rigs import controller
from tests.drivers.festo.rigs import terminal
from tests.drivers.festo_cmmt.rigs import drive
from tests.drivers.labjack.rigs import t7
from tests.drivers.wires.rigs import regulator

MBPOLL = shutil.which("mbpoll")
pytestmark = pytest.mark.skipif(MBPOLL is None, reason="not run: no mbpoll")

SHOWN = {"pressure": 123456.0, "displacement": 0.0123, "force": 58.86, "supply": 690e3, "pressure_command": 0.0}
EXCEPTIONS = {
    1: "Illegal function",
    2: "Illegal data address",
    3: "Illegal data value",
    4: "Slave device or server failure",
}


@contextmanager
def served(device):
    """The emulator of a device in front of a plant that stands still, and how mbpoll reaches it."""
    emulator = Emulator([device], preset="ideal")
    emulator.plant.quantities = lambda: SHOWN
    try:
        yield emulator, emulator.devices[device.name].address
    finally:
        emulator.close()


def poll(address, unit, table, first, *, count=1, write=(), options=()):
    """The values that mbpoll reads, or its complaint; None where it wrote."""
    if address.startswith("/"):
        way = ["-m", "rtu", "-b", "115200", "-P", "none"]
    else:
        address, _, port = address.rpartition(":")
        way = ["-m", "tcp", "-p", port]
    command = [MBPOLL, *way, "-a", str(unit), "-0", "-1", "-o", "2", "-t", table, "-r", str(first), *options]
    if not write:
        command += ["-c", str(count)]
    command += [address, *(["--", *map(str, write)] if write else [])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    refused = re.search(r"(?:Read|Write) .*failed: (.*)", done.stdout + done.stderr)
    if refused:
        return refused[1].strip()
    assert done.returncode == 0, done.stdout + done.stderr
    if write:
        assert f"Written {len(write)} references" in done.stdout
        return None
    values = re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)
    assert len(values) == count, done.stdout
    return [int(value, 0) if re.fullmatch(r"-?(0x)?[0-9A-Fa-f]+", value) else float(value) for value in values]


def wires(tmp_path):
    """A register map over both wires, with either order of words."""
    for words in ("high-first", "low-first"):
        yield words, regulator(words=words)
        yield words, regulator(str(tmp_path / "line"), words=words)


def test_a_register_map_in_either_order_of_words_over_tcp_and_rtu(tmp_path):
    for words, device in wires(tmp_path):
        order = ("-B",) if words == "high-first" else ()
        with served(device) as (emulator, address):
            read = {"address": address, "unit": 7}
            assert poll(**read, table="3:float", first=0, options=order) == [pytest.approx(123.456, rel=1e-6)]
            assert poll(**read, table="4:int", first=110, options=order) == [0x00112233]
            assert poll(**read, table="1", first=0) == [1]  # the emergency stop is not pressed
            assert poll(**read, table="4:float", first=10, write=[250], options=order) is None
            assert poll(**read, table="4:float", first=10, options=order) == [250.0]
            assert emulator.log.of("set", "regulator")[-1]["si"] == 250e3
            assert poll(**read, table="0", first=0, write=[1]) is None
            assert poll(**read, table="0", first=0) == [1]
            assert emulator.log.of("switch", "regulator")[-1]["on"] is True


def test_exceptions(tmp_path):
    for device in (regulator(), regulator(str(tmp_path / "line"))):
        with served(device) as (emulator, address):
            read = {"address": address, "unit": 7}
            assert poll(**read, table="4", first=500) == EXCEPTIONS[2]
            assert poll(**read, table="4", first=10, write=[1]) == EXCEPTIONS[3]  # half of a value
            for code, words in EXCEPTIONS.items():
                emulator.act({"device": "regulator", "fault": "exception", "value": code, "count": 1})
                assert poll(**read, table="3", first=0) == words


def test_an_alicat_on_rtu(tmp_path):
    with served(controller(tmp_path / "line", "modbus")) as (emulator, address):
        read = {"address": address, "unit": 1, "options": ("-B",)}
        assert poll(**read, table="3:float", first=1202) == [pytest.approx(123.456, rel=1e-6)]
        assert poll(**read, table="4:float", first=1009, write=[200]) is None
        assert poll(**read, table="4:float", first=1009) == [200.0]
        assert emulator.log.of("set", "controller")[-1]["si"] == pytest.approx(200e3)
        assert poll(**read, table="4", first=3000) == EXCEPTIONS[2]


def test_a_festo_terminal():
    with served(terminal()) as (emulator, address):
        inside = emulator.devices["terminal"].terminal
        inside.timeout = 0  # it hangs up after 100 ms of silence, also on a program that has just connected
        read = {"address": address, "unit": 1}
        pressure, displacement = (inside._inputs[name].address for name in ("ai3.0", "ai3.1"))
        assert poll(**read, table="4", first=pressure) == [3951]  # 123,456 Pa in steps of 31.25 Pa
        assert poll(**read, table="4", first=displacement) == [1230]
        output = inside._written["ao4.0"].address
        assert poll(**read, table="4", first=output, write=[8000, 0]) is None
        assert emulator.log.of("set", "terminal")[-1]["si"] == pytest.approx(250e3)
        assert poll(**read, table="4", first=9999) == EXCEPTIONS[2]


def test_a_labjack():
    with served(t7()) as (emulator, address):
        read = {"address": address, "unit": 1, "options": ("-B",)}
        assert poll(**read, table="4:int", first=55100) == [0x00112233]
        assert poll(**read, table="4:float", first=60000) == [7.0]
        assert poll(**read, table="4:float", first=0, count=2) == [
            pytest.approx(1.23456, rel=1e-6),
            pytest.approx(1.73, rel=1e-6),
        ]
        assert poll(**read, table="4:float", first=1000, write=[1.5]) is None
        assert emulator.log.of("set", "t7")[-1]["si"] == pytest.approx(300e3)
        assert poll(**read, table="4", first=30000) == EXCEPTIONS[2]


def test_a_festo_drive():
    with served(drive()) as (emulator, address):
        read = {"address": address, "unit": 1}
        assert poll(**read, table="4:int", first=400) == [emulator.devices["drive"].drive.timeout]
        assert poll(**read, table="4:int", first=400, write=[700]) is None
        assert poll(**read, table="4:int", first=400) == [700]
        assert emulator.log.of("watchdog-register", "drive")[-1]["raw"] == 700
        assert poll(**read, table="4:int", first=400, write=[70]) == EXCEPTIONS[3]  # shorter than it can be
        assert poll(**read, table="4", first=9999) == EXCEPTIONS[2]
