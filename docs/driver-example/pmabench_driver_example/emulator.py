"""The example controller as its manual describes it, with pmabench's simulated muscle behind it.

Written from the manual, not from the driver: each is a check of the other. What is commanded goes into the log as `set`
(with `output`, `raw` and `si`) and `switch`, so that the conformance suite can count it.
"""

from __future__ import annotations

import contextlib
import socket
import threading

from pmabench_drivers.emulator.faults import LINK, Faults, Outgoing
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import listen

from pmabench.bench.interface import EMULATED, DeviceRecord

HIGHEST = 600.0
"""Highest set-point [kPa]."""
EXCHANGES = (
    ("read_back", ("pressure",), b"02 S*D5\n", b"02 S 0.00*B3\n"),
    ("write", ("pressure", 100.0), b"03 S 100.00*15\n", b"03 S 100.00*15\n"),
    ("is_on", ("dump",), b"04 V*DA\n", b"04 V 0*2A\n"),
)
"""Calls after `open`, in this order, with the bytes of the manual for question and answer."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> Controller:
    """The controller that a device of this driver talks to, at its address."""
    return Controller(device, plant, log)


class Controller:
    """One controller; several connections may be open."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._device, self._plant, self._log, self._tap = device, plant, log, log.tap(device.name)
        self.faults = Faults(LINK)
        host, _, port = device.address.rpartition(":")
        self._listener = listen(device.name, host, int(port))
        self.address = f"{host}:{self._listener.getsockname()[1]}"
        self._setpoint, self._valve = 0.0, False
        self._open: set[socket.socket] = set()

    def start(self) -> None:
        """Begin to serve."""
        threading.Thread(target=self._accept, name=f"emulated {self._device.name}", daemon=True).start()

    def close(self) -> None:
        """Hang up."""
        for end in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _peer = self._listener.accept()
            except OSError:
                return
            self._open.add(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        outgoing = Outgoing()
        with connection, contextlib.suppress(OSError):
            for data in connection.makefile("rb"):
                self._tap("received", data)
                fault = self.faults.next()
                if fault.kind in {"hang-up", "reset"}:
                    break
                answer = b"" if fault.kind == "silence" else self._answer(data.strip())
                leaves = outgoing.of(answer, fault)
                self._tap("sent", leaves)
                connection.sendall(leaves)
        self._open.discard(connection)

    def _answer(self, data: bytes) -> bytes:
        """The line that answers a line, nothing to one whose sum is wrong."""
        body, _, told = data.rpartition(b"*")
        if told != b"%02X" % (sum(body) % 256):
            return b""
        number, _, text = body.decode("ascii", "replace").partition(" ")
        back = f"{number} {self._carry_out(*text.partition(' ')[::2])}".encode("ascii", "replace")
        return back + b"*%02X\n" % (sum(back) % 256)

    def _carry_out(self, word: str, argument: str) -> str:
        name = self._device.name
        if word == "ID":
            return f"{EMULATED}EX-1,1,1.0"
        if word == "P":
            return f"P {self._plant.quantities()['pressure'] / 1e3:.2f}"
        if word == "S" and argument:
            try:
                value = float(argument)
            except ValueError:
                return "E no number"
            if not 0 <= value <= HIGHEST:
                return f"E above {HIGHEST:g} kPa"
            self._setpoint = value
            self._log.note("set", name, output="pressure", raw=value, si=1e3 * value)
            self._plant.command(1e3 * value)
        if word == "V" and argument:
            self._valve = argument == "1"
            self._log.note("switch", name, valve="dump_valve", on=self._valve)
            self._plant.switch(on=self._valve)
        return {"S": f"S {self._setpoint:.2f}", "V": f"V {int(self._valve)}"}.get(word, "E unknown")
