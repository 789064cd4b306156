"""Devices of two wires as records, and a raw TCP peer whose answers are written by hand."""

import contextlib
import socket
import threading
import time
from dataclasses import replace

from pmabench_drivers.emulator import Emulator

from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord
from tests.drivers.common import timed

MODBUS = "pmabench_drivers.modbus:ModbusDevice"
TEXT = "pmabench_drivers.serial_ascii:SerialIndicator"

MAP = {
    "unit_id": 7,
    "rate": "200 Hz",
    "identity": {"maker": "Acme", "constant": {"address": 110, "type": "uint32", "expect": "0x00112233"}},
    "inputs": {
        "pressure": {"table": "input", "address": 0, "type": "float32"},
        "spare": {"table": "input", "address": 2, "type": "int16"},
        "e_stop": {"table": "discrete", "address": 0},
    },
    "outputs": {"pressure": {"address": 10, "type": "float32"}, "dump": {"table": "coil", "address": 0}},
    "watchdog": {
        "timeout": {"address": 20},
        "resolution": "10 ms",
        "trigger": {"address": 21},
        "on": 1,
        "off": 0,
    },
}


def regulator(address="127.0.0.1:0", options=None, **changes):
    """A pressure regulator in kPa with dump valve, emergency stop and watchdog; `changes` to its map."""
    return DeviceRecord(
        "regulator",
        MODBUS,
        address,
        {"map": {**MAP, **changes}, **(options or {})},
        (ChannelRecord("pressure", "pressure", "regulator", "pressure", "float64", "kPa", Scale(1e3), -50e3, 1e6),),
        (OutputRecord("pressure", "pressure", "regulator", "pressure", Scale(1e3), 0.01, 0.0, 0.0, 6e5),),
        (ValveRecord("dump_valve", "regulator", "dump"),),
        (InterlockRecord("e-stop", "regulator", "e_stop"),),
        0.5,
    )


CELL = {
    "baud": 115200,
    "poll": "P\r",
    "pattern": r"(?P<status>ST|US),(?P<value>[+-]\d{5}\.\d{2}) (?P<unit>[A-Za-z]{1,3})",
    "good_status": ["ST", "US"],
    "rate": "100 Hz",
    "timeout": "50 ms",
    "slowest": "150 ms",
    "emulate": "ST,%+09.2f N\r",
}
GAUGE = {
    "baud": 115200,
    "pattern": r"(?P<value>[+-]\d{3}\.\d{3})(?P<unit>mm|in)",
    "rate": "100 Hz",
    "terminator": "\r\n",
    "emulate": "%+08.3fmm\r\n",
}


def cell(address, **changes):
    """A polled load cell indicator."""
    channel = ChannelRecord("force", "force", "cell", "value", "float64", "N", Scale(), -50.0, 1950.0)
    return DeviceRecord("cell", TEXT, str(address), {**CELL, **changes}, (channel,))


def gauge(address, **changes):
    """A displacement gauge that sends by itself."""
    channel = ChannelRecord("displacement", "length", "gauge", "value", "float64", "mm", Scale(1e-3), -5e-3, 0.09)
    return DeviceRecord("gauge", TEXT, str(address), {**GAUGE, **changes}, (channel,))


@contextlib.contextmanager
def emulated(*devices, **options):
    """An emulator of the devices, and each device with the address that it really has."""
    emulator = Emulator(devices, **options)
    try:
        yield emulator, [replace(device, address=emulator.devices[device.name].address) for device in devices]
    finally:
        emulator.close()


class Peer:
    """A TCP server that answers each request with whatever `reply(request)` gives: bytes, or (delay [s], bytes) pairs."""

    def __init__(self, reply):
        self.reply, self.requests = reply, []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self):
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        with connection, contextlib.suppress(OSError):
            while request := connection.recv(300):
                self.requests.append(request)
                answer = self.reply(request)
                for delay, data in [(0.0, answer)] if isinstance(answer, bytes) else answer:
                    time.sleep(delay)
                    connection.sendall(data)


class Heart:
    """How long this process did not run: a thread that wakes every `PERIOD` notes by how much it wakes late.

    A machine with other work stops a process for half a second at times; no limit of a driver is to blame then. A call
    that waits (for an answer, a lock, a thread) leaves the heart beating, and is counted in full.
    """

    PERIOD = 0.002

    def __init__(self):
        self._lost, self._last, self._end = 0.0, time.monotonic(), threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    def _beat(self):
        while not self._end.wait(self.PERIOD):
            now = time.monotonic()
            self._lost, self._last = self._lost + max(0.0, now - self._last - self.PERIOD), now

    def _ran(self):
        """The time during which the process ran [s]; a stop that the thread has not noticed yet counts as one."""
        now, lost, last = time.monotonic(), self._lost, self._last
        return now - lost - max(0.0, now - last - self.PERIOD)

    def timed(self, call, *arguments):
        """As `timed`, without the time during which the process did not run."""
        start = self._ran()
        _took, outcome = timed(call, *arguments)
        return self._ran() - start, outcome
