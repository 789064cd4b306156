"""Modbus TCP by hand in front of a T7: there is no maker's library for this machine, and the maker documents the wire.

Calls: LabJack, Protocol Details (Direct Modbus TCP), https://support.labjack.com/docs/protocol-details-direct-modbus-tcp
(functions 3, 4, 16); test register, identity, DACs, lines, watchdog: the maker's register table, LabJack/ljm_constants,
2025.12.18; DACs: T-series datasheet, 15.0 DAC. Here are the registers that the driver uses.
"""

import socket
import struct
import sys
import time

from said import call

HOST, PORT = sys.argv[1].rsplit(":", 1)


class Refused(Exception):
    """An exception of Modbus, with its code."""


class T7:
    """One connection."""

    def __init__(self):
        self._socket = socket.create_connection((HOST, int(PORT)), timeout=2)
        self._number = 0

    def ask(self, pdu):
        """The answer to a request, both without the header."""
        self._number += 1
        self._socket.sendall(struct.pack(">HHHB", self._number, 0, len(pdu) + 1, 1) + pdu)
        number, protocol, length, unit = struct.unpack(">HHHB", self._whole(7))
        assert (number, protocol, unit) == (self._number, 0, 1)
        answer = self._whole(length - 1)
        if answer[0] & 0x80:
            raise Refused(answer[1])
        assert answer[0] == pdu[0]
        return answer[1:]

    def _whole(self, count):
        data = b""
        while len(data) < count:
            piece = self._socket.recv(count - len(data))
            if not piece:
                raise ConnectionError("the device closed the connection")
            data += piece
        return data

    def read(self, address, form, function=3):
        """Values from an address on, by their letters of `struct`."""
        size = struct.calcsize(f">{form}")
        answer = self.ask(struct.pack(">BHH", function, address, size // 2))
        assert answer[0] == size
        found = struct.unpack(f">{form}", answer[1:])
        return found[0] if len(found) == 1 else found

    def write(self, address, form, *values):
        """Values by function 16."""
        data = struct.pack(f">{form}", *values)
        answer = self.ask(struct.pack(">BHHB", 16, address, len(data) // 2, len(data)) + data)
        assert answer == struct.pack(">HH", address, len(data) // 2)

    def refused(self, act, code):
        """Something that must be refused with an exception code."""
        try:
            act()
        except Refused as refused:
            assert refused.args == (code,), f"exception {refused} instead of {code}"
        else:
            raise AssertionError("it was not refused")


def near(found, wanted, within):
    assert abs(found - wanted) <= within, f"{found:g} instead of {wanted:g}"


t7 = T7()
with call("read TEST (55100)"):
    assert t7.read(55100, "I") == 0x00112233
with call("read PRODUCT_ID (60000), FIRMWARE_VERSION (60004)"):
    assert t7.read(60000, "f") == 7.0
    assert t7.read(60004, "f") > 1.0
with call("read SERIAL_NUMBER (60028) by function 4"):
    t7.read(60028, "I", 4)
with call("refuse one word of a 32-bit value"):
    for address in (0, 1, 1000, 55100, 60000, 61500):
        t7.refused(lambda address=address: t7.read(address, "H"), 4)
        assert t7.read(55000, "H") == 2315
    t7.refused(lambda: t7.ask(struct.pack(">BHH", 6, 1000, 0)), 4)
with call("refuse an address that is not in the table"):
    t7.refused(lambda: t7.read(3999, "H"), 2)
with call("refuse a function that is not supported"):
    t7.refused(lambda: t7.ask(struct.pack(">BHH", 1, 2000, 1)), 1)
with call("AIN0_RANGE (40000), AIN0_NEGATIVE_CH (41000)"):
    t7.write(40000, "f", 1.0)
    assert t7.read(40000, "f") == 1.0
    t7.refused(lambda: t7.write(40000, "f", 3.0), 4)
    t7.write(40000, "f", 10.0)
    t7.write(41000, "H", 199)
with call("FIO0 (2000) as an output, DIO_STATE (2800), DIO_DIRECTION (2850)") as saw:
    t7.write(2000, "H", 1)
    assert t7.read(2800, "I") & 1
    assert t7.read(2850, "I") & 1
    saw["valve"] = 1.0
with call("DAC0 (1000)") as saw:
    t7.write(1000, "f", 1.5)
    near(t7.read(1000, "f"), 1.5, 0.002)
    saw["commanded"] = 1.5 * 2e5
with call("AIN0, AIN1, AIN2 (0)") as saw:
    time.sleep(3.0)
    pressure, displacement, force = t7.read(0, "fff")
    assert pressure > 2.0
    saw["pressure"], saw["displacement"], saw["force"] = 1e5 * pressure, 0.01 * displacement - 0.005, 200 * force - 50
with call("DAC0 beyond its range reads back as its end"):
    t7.write(1000, "f", 7.0)
    near(t7.read(1000, "f"), 5.0, 0.1)
    t7.write(1000, "f", -1.0)
    assert t7.read(1000, "f") == 0.0
with call("a NaN for DAC0 leaves the connection and the DAC as they are"):
    t7.refused(lambda: t7.write(1000, "f", float("nan")), 3)
    assert t7.read(1000, "f") == 0.0
with call("watchdog (61600): is set while it is off, vents, and counts again") as saw:
    t7.write(1000, "f", 0.5)
    t7.write(61600, "I", 0)
    t7.write(61602, "III", 0, 1, 0)
    t7.write(61610, "II", 1, 77)
    t7.write(61640, "If", 1, 0.0)
    t7.write(61614, "I", 77)
    t7.write(61600, "I", 1)
    t7.refused(lambda: t7.write(61604, "I", 5), 4)
    assert t7.read(55000, "H") == 2671
    for _ in range(4):
        t7.write(61614, "I", 77)
        time.sleep(0.4)
    near(t7.read(1000, "f"), 0.5, 0.002)
    time.sleep(1.3)
    assert t7.read(1000, "f") == 0.0
    t7.write(1000, "f", 0.5)
    time.sleep(1.5)
    assert t7.read(1000, "f") == 0.0
    t7.write(61600, "I", 0)
