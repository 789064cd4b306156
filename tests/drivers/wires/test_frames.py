"""The driver's frames, byte by byte against bytes written by hand, and its answer to everything a peer can send back."""

import math
import struct
import threading
from dataclasses import replace
from time import monotonic

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pmabench_drivers.emulator import modbus_server as frames
from pmabench_drivers.modbus import ModbusDevice
from pmabench_drivers.modbus.adapter import Line, Unanswered

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, NotSent
from tests.drivers.common import timed
from tests.drivers.wires.rigs import Peer, regulator

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""The contract is 0.2 s; the rest is for a busy machine."""


def line_to(peer, unit_id=7, timeout=0.1):
    return Line("regulator", peer.address, unit_id, timeout, slowest=1.0)


def soon():
    return monotonic() + 0.19


def head(request, size, unit=7):
    return request[:2] + struct.pack(">HHB", 0, size + 1, unit)


READS = [
    ("coil", 3, 10, "01 0003 000A", "01 02 CD 01", [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]),
    ("discrete", 196, 3, "02 00C4 0003", "02 01 05", [1, 0, 1]),
    ("holding", 107, 3, "03 006B 0003", "03 06 022B 0000 0064", [555, 0, 100]),
    ("input", 8, 1, "04 0008 0001", "04 02 000A", [10]),
]
"""Mostly the examples of the Modbus Application Protocol Specification 1.1b3, sections 6.1 to 6.4."""


@pytest.mark.parametrize(("table", "address", "count", "asked", "answered", "values"), READS)
def test_reads_are_the_bytes_of_the_specification(table, address, count, asked, answered, values):
    answer = bytes.fromhex(answered)
    with Peer(lambda request: head(request, len(answer)) + answer) as peer:
        line = line_to(peer)
        assert line.read(table, address, count, soon()) == values
        line.close()
    pdu = bytes.fromhex(asked)
    assert peer.requests[0][2:] == struct.pack(">HHB", 0, len(pdu) + 1, 7) + pdu


WRITES = [
    (5, 172, [1], "05 00AC FF00", "05 00AC FF00"),
    (5, 172, [0], "05 00AC 0000", "05 00AC 0000"),
    (6, 1, [3], "06 0001 0003", "06 0001 0003"),
    (15, 19, [1, 0, 1, 1, 0, 0, 1, 1, 1, 0], "0F 0013 000A 02 CD01", "0F 0013 000A"),
    (16, 1, [10, 258], "10 0001 0002 04 000A 0102", "10 0001 0002"),
]
"""Sections 6.5, 6.6, 6.11, 6.12."""


@pytest.mark.parametrize(("function", "address", "words", "asked", "answered"), WRITES)
def test_writes_are_the_bytes_of_the_specification(function, address, words, asked, answered):
    answer = bytes.fromhex(answered)
    with Peer(lambda request: head(request, len(answer)) + answer) as peer:
        line = line_to(peer)
        line.write(function, address, words, soon())
        line.close()
    assert [request[7:] for request in peer.requests] == [bytes.fromhex(asked)]


def test_a_poll_that_waits_for_its_turn_does_not_open_what_is_closed_meanwhile():
    """A thread that polls is not waited for; the connection it would open then would be nobody's."""
    asked, reported = threading.Event(), []

    def silent(_request):
        asked.set()
        return b""

    def poll():
        try:
            line.read("holding", 0, 1, monotonic() + 20.0)
        except DeviceError as error:
            reported.append(error.message)

    with Peer(silent) as peer:
        line = line_to(peer, timeout=20.0)
        threads = [threading.Thread(target=poll) for _ in range(2)]
        threads[0].start()
        asked.wait(1.0)
        threads[1].start()
        line.close()
        for thread in threads:
            thread.join()
        assert len(peer.requests) == 1
    assert any("was closed" in message for message in reported)


CODES = {
    1: "does not know this function",
    2: "has no such address",
    3: "does not accept this value",
    4: "failed while doing it",
    5: "needs long",
    6: "is busy",
    7: "refused",
    8: "parity error",
    10: "no path",
    11: "no answer from it",
    99: "does not define",
}


@pytest.mark.parametrize("code", CODES)
def test_each_exception_code_is_said_in_words(code):
    with Peer(lambda request: head(request, 2) + bytes([request[7] | 0x80, code])) as peer:
        line = line_to(peer)
        with pytest.raises(DeviceError, match=rf"^regulator.pressure: answers with exception {code}: .*{CODES[code]}"):
            line.read("input", 0, 1, soon(), "pressure")
        with pytest.raises(DeviceError) as raised:
            line.write(6, 0, [1], soon(), "pressure")
        assert isinstance(raised.value, NotSent) == (code in {1, 2, 3, 4, 7, 8, 99})  # the others may be done yet
        line.close()


HOSTILE = {
    "silence": lambda request: b"",
    "another transaction": lambda r: bytes([r[0], r[1] ^ 1]) + head(r, 4)[2:] + b"\x04\x02\x00\x0a",
    "transaction 0": lambda r: b"\0\0" + head(r, 4)[2:] + b"\x04\x02\x00\x0a",
    "another unit": lambda r: head(r, 4, unit=8) + b"\x04\x02\x00\x0a",
    "another function": lambda r: head(r, 4) + b"\x03\x02\x00\x0a",
    "fewer registers": lambda r: head(r, 2) + b"\x04\x00",
    "more registers": lambda r: head(r, 6) + b"\x04\x04\x00\x0a\x00\x0b",
    "a byte count that lies": lambda r: head(r, 4) + b"\x04\x20\x00\x0a",
    "an odd byte count": lambda r: head(r, 3) + b"\x04\x01\x0a",
    "another protocol": lambda r: r[:2] + b"\x12\x34" + head(r, 4)[4:] + b"\x04\x02\x00\x0a",
    "half of it": lambda r: head(r, 4) + b"\x04\x02\x00",
    "a length without end": lambda r: r[:4] + b"\xff\xff\x07\x04\x02\x00\x0a",
    "a byte every 30 ms": lambda r: [(0.03, bytes([byte])) for byte in head(r, 4) + b"\x04\x02\x00\x0a"],
    "an exception for another function": lambda r: head(r, 2) + b"\x83\x02",
    "text": lambda request: b"HTTP/1.1 400 Bad Request\r\n\r\n",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_no_answer_but_the_right_one_is_taken_and_none_is_waited_for_too_long(what, caplog):
    with Peer(HOSTILE[what]) as peer:
        line = line_to(peer)
        took, outcome = timed(line.read, "input", 8, 1, soon(), "pressure")
        line.close()
    assert isinstance(outcome, DeviceError), outcome
    assert str(outcome).startswith("regulator.pressure: ")
    assert took < BOUND
    assert caplog.text == ""  # the library's own log would stand in the operator's terminal


@pytest.mark.parametrize("what", HOSTILE)
def test_after_a_bad_answer_the_next_question_gets_its_own(what):
    answers = [HOSTILE[what]]

    def reply(request):
        if answers:
            return answers.pop()(request)
        return head(request, 4) + b"\x04\x02\x01\x02"

    with Peer(reply) as peer:
        line = line_to(peer)
        with pytest.raises(DeviceError):
            line.read("input", 8, 1, soon())
        assert line.read("input", 8, 1, soon()) == [0x0102]
        line.close()


def test_nobody_listens():
    with Peer(lambda request: b"") as peer:
        pass
    took, outcome = timed(line_to(peer).read, "input", 0, 1, soon(), "pressure")
    assert isinstance(outcome, DeviceError)
    assert "no connection to 127.0.0.1" in str(outcome)
    assert took < BOUND


def test_a_write_is_sent_once_whatever_happens():
    with Peer(lambda request: b"") as peer:
        line = line_to(peer)
        with pytest.raises(Unanswered):
            line.write(16, 10, [1, 2], soon())
        line.close()
    assert len(peer.requests) == 1


def constant_in_wrong_order(request):
    address, count = struct.unpack(">HH", request[8:12])
    data = struct.pack(">HH", 0x2233, 0x0011) if address == 110 else bytes(2 * count)
    return head(request, 2 + len(data)) + bytes([request[7], len(data)]) + data


def test_words_in_the_wrong_order_are_found_when_it_is_opened():
    with Peer(constant_in_wrong_order) as peer:
        device = ModbusDevice(regulator(peer.address), RealClock())
        with pytest.raises(DeviceError, match=r"regulator.constant: gives .* in the other order: change \"words\""):
            device.open()
        low_first = ModbusDevice(regulator(peer.address, words="low-first"), RealClock())
        assert low_first.open().maker == "Acme"
        low_first.close()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_pressure_is_never_sent(value):
    with Peer(lambda request: b"") as peer:
        device = ModbusDevice(replace(regulator(peer.address), options={"map": plain_map()}), RealClock())
        device._link = device._new_line()
        before = len(peer.requests)
        with pytest.raises(DeviceError):
            device.write("pressure", value)
        device.close()
        assert len(peer.requests) == before


def plain_map():
    from tests.drivers.wires.rigs import MAP

    return {**MAP, "identity": {}}


@settings(max_examples=300)
@given(st.binary(min_size=1, max_size=300))
def test_the_emulators_own_decoder_survives_any_bytes(data):
    try:
        request = frames.parse(data)
    except frames.Refused as refused:
        assert refused.code in {1, 2, 3}
    else:
        assert len(frames.answer(request, [0] * request.count)) <= 253
    assert frames.split_rtu(data) is None or len(data) >= 8
    try:
        parts = frames.split_mbap(data)
    except ValueError:
        parts = None
    assert parts is None or len(parts[2]) >= 1


def test_crc_of_the_specification():
    assert frames.crc16(bytes.fromhex("0207")) == bytes.fromhex("4112")  # Modbus over Serial Line 1.02, page 39
    assert frames.crc16(b"123456789") == bytes.fromhex("374B")  # the catalogue's check value of CRC-16/MODBUS
