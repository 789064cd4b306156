"""Drivers send exactly the bytes of their captures, use every answer in them, and read from them what they should."""

from copy import deepcopy

import pytest

from pmabench.base.errors import DeviceError
from tests.captures.capture import FOLDER, Calls, Capture, Replay, read
from tests.captures.scripts import SCRIPTS, device_of, use

USED = [0.5, True, 250.0, True, ("pressure", [123.456]), False]
EXPECTED = {
    "modbus-tcp": ("Acme", "", USED),
    "modbus-rtu": ("", "", USED),
    "festo-cpx-e": (
        "emulator of pmabench",
        "emulated CPX-E",
        # 12.3 mm in steps of 10 um, 123,456 Pa in steps of 31.25 Pa
        [0.5, True, 8000.0, True, ("displacement", [1230.0]), ("pressure", [3951.0]), False],
    ),
    "festo-cmmt": ("emulator of pmabench", "emulated CMMT-AS", [0.5, 5000.0, [12300.0]]),
    "can": ("CAN", "emulated CiA 402 drive, CiA 406 transducer", [0.5, True, 5000.0, [12300.0]]),
    "ni-daqmx": ("NI", "emulated USB-6215", [True, 2.5, True, 500.0, False]),
    "labjack": ("LabJack", "emulated T7", [1.0, True, 1.5, True, False]),
    "serial-line-daq": ("", "emulated board", [0.5, True, 250.0, True, False]),
    "serial-ascii": ("", "serial ASCII indicator", [("force", [58.86])]),
    "alicat-ascii": ("Alicat", "emulated controller", [200.0, 0.0]),
    "alicat-modbus": ("Alicat", "emulated controller", [200.0, 0.0]),
    "dataq": ("DATAQ", "emulated 2108", [500.0, ("force", True, {0.29}), ("pressure", True, {1.23})]),
    "ild1420": ("Micro-Epsilon", "emulated ILD1420-100", [1000.0, ("displacement", True, {17.3})]),
}
"""Name -> maker, model, and what the script gives: what stood in the plant, in units of the device."""


def replayed(name, capture, tmp_path):
    """What a driver makes of a capture: who answers, what the script gives, and the peer.

    Calls end in time: one that a busy machine made late is tried again, one whose bytes differ is not.
    """
    for attempt in range(3):
        if name == "ni-daqmx":
            peer = Calls(deepcopy(capture))
        else:
            peer = Replay(deepcopy(capture), tmp_path / f"{name}{attempt}" if SCRIPTS[name][2] else None)
        record = device_of(name, peer.address) if SCRIPTS[name][2] else SCRIPTS[name][1](address=peer.address)
        try:
            return use(name, record), peer
        except DeviceError as error:
            expected = peer.wrong.partition(" was expected")[0]  # NI's package asks for this first, and goes on without
            assert peer.wrong == "" or b"GetSystemInfoAttributeUInt32".hex(" ") in expected, error
        finally:
            peer.close()
    pytest.fail(f"{name}: no answer in time, three times")


def test_every_capture_is_replayed():
    assert {path.stem for path in FOLDER.glob("*.txt")} == {*SCRIPTS} == {*EXPECTED}


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_driver_sends_these_bytes_and_reads_these_answers(name, tmp_path):
    (identity, said), peer = replayed(name, read(name), tmp_path)
    assert peer.wrong == ""
    assert peer.unused == []
    maker, model, results = EXPECTED[name]
    assert (identity.maker, identity.model) == (maker, model)
    assert said == results


DOCUMENTED = {
    "labjack": (0, "01 03 d7 3c 00 02"),  # holding 55100, which always reads 0x00112233 (T-series, register TEST)
    "modbus-rtu": (20, "07 05 00 00 ff 00"),  # write single coil: FF00 is on (Modbus Application Protocol, 6.5)
    "alicat-ascii": (0, "41 3f 3f 4d 2a 0d"),  # "A??M*" (serial primer: manufacturing information)
    "serial-ascii": (0, "50 0d"),
    "ild1420": (0, "4f 55 54 50 55 54 20 4e 4f 4e 45 0a"),  # "OUTPUT NONE" LF (instruction manual, ASCII commands)
    "can": (94, b"t00020105\r".hex(" ")),  # NMT: start node 5 (CiA 301, 7.2.8.2.1)
    "dataq": (0, "73 74 6f 70 0d"),  # "stop" CR (protocol of the DI-1100 family)
}
"""Capture -> the run of bytes that its maker's documents give, and its number."""


@pytest.mark.parametrize("name", DOCUMENTED)
def test_bytes_are_those_of_the_documents(name):
    number, data = DOCUMENTED[name]
    run = read(name).runs[number]
    assert run.to_device
    assert bytes.fromhex(data) in run.data


def test_another_byte_and_an_unused_answer_are_reported(tmp_path):
    """The replay itself: a capture that differs by one byte, and one that is longer than what is done."""
    capture = read("serial-ascii")
    capture.runs[2].data = b"Q\r"
    (_identity, said), peer = replayed("serial-ascii", capture, tmp_path)
    assert said == [("force", [])]
    assert peer.wrong == "line 5: 51 0d was expected, and 50 0d came"
    longer = read("serial-ascii")
    longer.add(1.0, True, b"P\r")
    (tmp_path / "serial-ascii0").unlink()
    _said, peer = replayed("serial-ascii", longer, tmp_path)
    assert peer.wrong == ""
    assert peer.unused == ["line 0: > 50 0d"]


def test_a_capture_is_read_as_it_was_written(tmp_path, monkeypatch):
    capture = Capture()
    for time, to_device, data in ((0.0, True, b"P"), (0.001, True, b"\r"), (0.002, False, b"\x00\xff")):
        capture.add(time, to_device, data)
    monkeypatch.setattr("tests.captures.capture.FOLDER", tmp_path)
    (tmp_path / "x.txt").write_text(capture.text(["a remark # in a remark"]))
    assert [(run.time, run.to_device, run.data) for run in read("x").runs] == [
        (0.0, True, b"P\r"),
        (0.002, False, b"\x00\xff"),
    ]
