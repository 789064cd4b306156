"""The EX-2 as its page says (docs/driver-example/device.md), with pmabench's simulated muscle behind it.

Written from the page, not from the driver: each is a check of the other. What is commanded goes into the log as `set`
(with `output`, `raw` and `si`), `switch` and `watchdog`, and `by_hand` sets an output as its keys would, so that the
conformance suite can compare what the driver says with what the device does.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from time import monotonic

from pmabench_drivers.emulator.faults import EXPIRY, IGNORE, LINK, CommandLog, Faults, Outgoing
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import listen

from pmabench.bench.interface import EMULATED, DeviceRecord

HIGHEST = 600.0
"""Highest set-point [kPa]."""
WATCH = (0.2, 60.0, 0.05)
"""Shortest and longest watch time, and its step [s]."""
LOOK = 0.01
"""How often it looks whether the watch time is over [s]."""
VALVES = {"1": "dump_valve", "2": "supply_valve"}
SERIAL = "4711"


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> Controller:
    """The controller that a device of this driver talks to, at its address."""
    return Controller(device, plant, log)


class Controller:
    """One controller; several connections may be open."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._name, self._plant, self._log, self._tap = device.name, plant, log, log.tap(device.name)
        self.faults = Faults(LINK, IGNORE, EXPIRY)
        host, _, port = device.address.rpartition(":")
        self._listener = listen(device.name, host, int(port))
        self.address = f"{host}:{self._listener.getsockname()[1]}"
        self._open: set[socket.socket] = set()
        self._lock, self._ended = threading.RLock(), threading.Event()
        self._on_since = self._heard = monotonic()
        self._watch = 0.0
        self._rest()

    def start(self) -> None:
        """Begin to serve."""
        for target in (self._accept, self._look):
            threading.Thread(target=target, name=f"emulated {self._name}", daemon=True).start()

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        for end in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    # -- connections ----------------------------------------------------------------------------------------------

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
                answer = b"" if fault.kind == "silence" else self._answer(data.strip(), fault.kind == "ignore")
                leaves = outgoing.of(answer, fault)
                self._tap("sent", leaves)
                connection.sendall(leaves)
        self._open.discard(connection)

    def _answer(self, data: bytes, ignore: bool) -> bytes:
        """The line that answers a line, nothing to one whose sum is wrong."""
        body, _, told = data.rpartition(b"*")
        if told != b"%02X" % (sum(body) % 256):
            return b""
        number, word, *arguments = [*body.decode("ascii", "replace").split(" "), ""][:-1]
        with self._lock:
            self._heard = monotonic()
            try:
                text = self._carry_out(word, arguments, ignore)
            except (ValueError, KeyError, IndexError):
                text = "E unknown"
        back = f"{number} {text}".encode("ascii", "replace")
        return back + b"*%02X\n" % (sum(back) % 256)

    # -- what the page says ---------------------------------------------------------------------------------------

    def _carry_out(self, word: str, arguments: list[str], ignore: bool) -> str:
        match word, arguments:
            case "ID", []:
                return f"ID {EMULATED}EX-2,{SERIAL},2.0"
            case "P", []:
                found = self._plant.quantities()
                return f"P {found['pressure'] / 1e3:.2f} {found['supply'] / 1e3:.2f}"
            case "S", [value] if not 0 <= float(value) <= HIGHEST:
                return "E range"
            case "S", [value]:
                if not ignore:
                    self.by_hand("outlet", float(value))
                return f"S {float(value):.2f}"
            case "S", []:
                return f"S {self._set_point:.2f}"
            case "V", [valve, on]:
                if not ignore:
                    self._switch(VALVES[valve], on={"0": False, "1": True}[on])
                return f"V {valve} {on}"
            case "V", [valve]:
                return f"V {valve} {int(self._energised[VALVES[valve]])}"
            case "D", []:
                return f"D {int(self._plant.e_stop_high())}"
            case "W", [seconds] if float(seconds) and not WATCH[0] <= float(seconds) <= WATCH[1]:
                return "E range"
            case "W", [seconds]:
                if not ignore:
                    self._watch = int(float(seconds) / WATCH[2] + 1e-6) * WATCH[2]
                return f"W {self._watch:.2f}"
            case "W", []:
                return f"W {self._watch:.2f}"
            case "H", []:
                return f"H {self._watch:.2f} {monotonic() - self._on_since:.2f} {SERIAL}"
        return "E unknown"

    def by_hand(self, output: str, value: float) -> None:
        """A set-point [kPa], or a valve energised (1) or not (0), whoever wants it."""
        with self._lock:
            if output != "outlet":
                self._switch(f"{output}_valve", on=bool(value))
                return
            self._set_point = round(value, 2)
            self._log.note("set", self._name, output="pressure", raw=value, si=1e3 * value)
            self._plant.command(1e3 * value)

    def _switch(self, valve: str, *, on: bool) -> None:
        self._energised[valve] = on
        self._log.note("switch", self._name, valve=valve, on=on)
        if valve == "dump_valve":
            self._plant.switch(on=on)
        else:
            self._plant.fail("supply_lost_at", over=on)

    def _rest(self) -> None:
        """As it is when it was switched on."""
        self._set_point, self._energised = 0.0, dict.fromkeys(VALVES.values(), False)
        self._plant.command(0.0)
        for valve in VALVES.values():
            self._switch(valve, on=False)

    # -- the watch time -------------------------------------------------------------------------------------------

    def _look(self) -> None:
        while not self._ended.wait(LOOK):
            if self._watch and monotonic() - self._heard > self._watch:
                self.expire_watchdog()

    def switch_off_watchdog(self) -> bool:
        """Another program sets the watch time to 0; whether it was on."""
        with self._lock:
            was_on, self._watch = bool(self._watch), 0.0
            return was_on

    def expire_watchdog(self) -> bool:
        """Act as when the watch time is over; whether it was on."""
        with self._lock:
            if not self._watch:
                return False
            self._watch = 0.0
            self._log.note("watchdog", self._name, silent=monotonic() - self._heard)
            self._rest()
            return True
