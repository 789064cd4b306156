"""tshark decodes what drivers and emulators exchange: no malformed frame, and the values that were commanded."""

import contextlib
import json
import shutil
import subprocess
from dataclasses import replace

import pytest
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.modbus import ModbusDevice

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.captures.capture import read
from tests.drivers.wires.rigs import regulator
from tests.peers.pcap import pcap

TSHARK = shutil.which("tshark")
pytestmark = pytest.mark.skipif(TSHARK is None, reason="not run: no tshark")
TCP, RTU = "tcp.port==502,mbtcp", "tcp.port==502,mbrtu"
FIELDS = ("_ws.malformed", "_ws.expert.message", "mbtcp.trans_id", "modbus.func_code", "modbus.exception_code")


def decoded(exchange, tmp_path, protocol, *options):
    """What tshark finds in each segment: the fields, by their names."""
    file = tmp_path / "exchange.pcap"
    file.write_bytes(pcap(exchange))
    fields = [part for field in FIELDS for part in ("-e", field)]
    command = [TSHARK, "-n", "-r", str(file), "-d", protocol, *options, "-T", "fields", "-E", "separator=|", *fields]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    rows = [dict(zip(FIELDS, line.split("|"), strict=True)) for line in done.stdout.splitlines()]
    assert len(rows) == len(exchange)
    return rows


def of_capture(name):
    return [(run.time, run.to_device, run.data) for run in read(name).runs]


@pytest.mark.parametrize("name", ["modbus-tcp", "festo-cpx-e", "labjack"])
def test_captures_over_tcp(name, tmp_path):
    exchange = of_capture(name)
    rows = decoded(exchange, tmp_path, TCP)
    for (_time, _to_device, data), row in zip(exchange, rows, strict=True):
        assert row["_ws.malformed"] == ""
        assert row["_ws.expert.message"] == "", row
        assert int(row["mbtcp.trans_id"]) == int.from_bytes(data[:2], "big")
        assert int(row["modbus.func_code"]) == data[7] & 0x7F
    assert [row["mbtcp.trans_id"] for row in rows[::2]] == [row["mbtcp.trans_id"] for row in rows[1::2]]


@pytest.mark.parametrize("name", ["modbus-rtu", "alicat-modbus"])
def test_captures_on_serial_lines(name, tmp_path):
    rows = decoded(of_capture(name), tmp_path, RTU, "-o", "mbrtu.crc_verification:TRUE")
    for row in rows:
        assert row["_ws.malformed"] == ""
        assert row["_ws.expert.message"] == "", row
        assert row["modbus.func_code"] != ""


def test_a_wrong_checksum_and_a_frame_that_is_cut_are_seen(tmp_path):
    """That the tests above can fail."""
    exchange = of_capture("modbus-rtu")
    time, to_device, data = exchange[2]
    exchange[2] = time, to_device, data[:-1] + bytes([data[-1] ^ 1])
    row = decoded(exchange, tmp_path, RTU, "-o", "mbrtu.crc_verification:TRUE")[2]
    assert row["_ws.expert.message"] != ""
    exchange = of_capture("modbus-tcp")
    time, to_device, data = exchange[0]
    exchange[0] = time, to_device, data[:4] + b"\0\3" + data[6:9]  # a question that ends in its address
    row = decoded(exchange, tmp_path, TCP)[0]
    assert row["_ws.malformed"] + row["_ws.expert.message"] != ""


def test_an_exchange_with_refusals_while_it_is_polled(tmp_path):
    log, device = tmp_path / "log.jsonl", regulator(timeout="200 ms")
    emulator = Emulator([device], preset="ideal", log=log)
    driver = ModbusDevice(replace(device, address=emulator.devices["regulator"].address), RealClock())
    try:
        driver.open()
        driver._streaming = True
        for number in range(200):
            if number == 100:
                emulator.act({"device": "regulator", "fault": "exception", "value": 6, "count": 1})
            with contextlib.suppress(DeviceError):  # the refusal, and what a busy machine makes late
                driver._poll()
    finally:
        driver.close()
        emulator.close()
    entries = [json.loads(line) for line in log.read_text().splitlines()]
    exchange = [
        (entry["t"], entry["kind"] == "received", bytes.fromhex(entry["data"]))
        for entry in entries
        if entry["kind"] in {"received", "sent"}
    ]
    rows = decoded(exchange, tmp_path, TCP)
    assert len(rows) > 350
    assert all(row["_ws.malformed"] == "" for row in rows)
    assert [row["modbus.exception_code"] for row in rows if row["modbus.exception_code"]] == ["6"]
