"""A pressure regulator with a dump valve, a muscle and a load behind it; Modbus TCP, standard library only.

Written for the tests from the Modbus specification (Application Protocol 1.1b3, Messaging on TCP 1.0b). It shares no
code, file or constant with the drivers, with the project's emulators or with the bench file under test, so that what it
writes down is proof: each executed and each ignored write, each end of its watchdog, and the pressure in the muscle.

Manual of the device
    Addresses are as on the wire (from 0), 32-bit values high word first. Unit 1. Functions 1 to 6, 15, 16.

    input 0, 1     float32  pressure in the muscle [kPa]
    input 2, 3     float32  contraction of the muscle [mm]
    input 4, 5     float32  force of the load [N]
    input 6, 7     uint32   time since it was switched on [s]
    input 8        uint16   how often it was switched on
    input 9        uint16   how often its watchdog has ended
    discrete 0              emergency stop: 1 released, 0 pressed (reported only; it does nothing by itself)
    coil 0                  dump valve: 1 closed, 0 open; open empties the muscle whatever the set-point is
    holding 10     uint16   set-point, 0 to 10000 = 0 to 1000 kPa; more is refused with exception 3
    holding 20     uint16   watchdog time [10 ms]
    holding 21     uint16   watchdog: 1 starts it; reads 0 when it is off or has ended
    holding 100-111 text    model
    holding 112    uint32   serial number
    holding 114    uint32   0x00112233

    Watchdog: every request to unit 1 that arrives is a sign of life, from whatever connection. When none came for the
    watchdog time the set-point becomes 0, the dump valve opens and holding 21 becomes 0.
    Switched on, the device has set-point 0, the dump valve open, the watchdog off with a time of 0.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import selectors
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress

FULL_SCALE = 1000.0 / 10000
"""Set-point [kPa per count]."""
WATCHDOG_COUNT = 0.010
FILLS, EMPTIES = 0.08, 0.05
"""Time constants of the pressure: through the regulator, through the dump valve [s]."""
LOAD = 58.86
"""Weight of 6 kg [N]."""
SUPPLY = 690.0
"""Pressure in front of the regulator [kPa]."""
FORCE_PER_KPA, STIFFNESS = 0.95, 6.8
"""The muscle: force without contraction [N/kPa], loss of force with contraction [N/mm]."""
PRESSURISED = 20.0
"""The log says when the muscle's pressure passes this [kPa]."""
STARVED = 0.05
"""A turn of the device's own loop that took longer is time in which the device did not live, not silence [s]."""
IGNORED = {"ignore-set-points": {10}, "ignore-valve": {"coil"}, "ignore-all": {10, 20, 21, "coil"}}
"""Fault -> registers whose writes are acknowledged and not executed."""
ONCE = {"reset", "restart", "restart-valve-kept", "serial", "watchdog-off", "watchdog-time", "set-point",
        "set-point-zero", "dump-valve", "watchdog-ends", "half-open"}  # fmt: skip
"""Faults that happen and are over; the others last until they are cleared."""
LASTING = {*IGNORED, "echo", "silence", "slow", "drip", "truncated", "duplicate", "stale", "wrong-transaction",
           "wrong-unit", "exception", "busy", "nan", "ffff", "negative", "frozen", "offset", "stuck", "supply", "runaway",
           "e-stop", "refuse-connections"}  # fmt: skip


class Log:
    """JSON lines, each written at once, with the time of CLOCK_MONOTONIC."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def line(self, what: str, at: float | None = None, **data: object) -> None:
        text = json.dumps({"t": time.monotonic() if at is None else at, "do": what, **data})
        os.write(self._file, text.encode() + b"\n")


class Device:
    """Registers, watchdog and air; `faults` are those that last."""

    def __init__(self, log: Log, serial: int) -> None:
        self.log, self.serial = log, serial
        self.faults: dict[str, float] = {}
        self.restarts = self.ended = 0
        self.asked = time.monotonic()
        self.longest = 0.0
        """When the input registers were read last, and the longest time between two readings [s]."""
        self.pressure = 0.0
        self.time = self.fed = time.monotonic()
        self._seen: dict[str, float] = {}
        self.switch_on()

    def switch_on(self) -> None:
        """As after power on; the pressure is what it was."""
        self.since = self.fed = time.monotonic()
        self.restarts += 1
        self.holding = {10: 0, 20: 0, 21: 0}
        self.coil = False
        self.demand, self.closed = 0.0, False
        """What regulator and valve really do."""

    # -- air ------------------------------------------------------------------------------------------------------

    def pass_time(self, now: float) -> None:
        """Let the watchdog end where it must, and the pressure follow, until `now`."""
        ends = self.fed + self.holding[20] * WATCHDOG_COUNT
        if self.holding[21] and now >= ends:
            self._flow(max(ends, self.time))
            self.end_watchdog(ends)
        self._flow(now)

    def end_watchdog(self, at: float) -> None:
        """What the watchdog does: past all registers, at the outputs themselves."""
        self.holding |= {10: 0, 21: 0}
        self.coil = self.closed = False
        self.demand = 0.0
        self.ended += 1
        self.log.line("watchdog", at, fed=self.fed, pressure=self.pressure)

    def _flow(self, now: float) -> None:
        """First order, solved in closed form; the instant at which PRESSURISED is passed goes into the log."""
        before, lasts = self.pressure, now - self.time
        goal, lag = (self.demand, FILLS) if self.closed else (0.0, EMPTIES)
        if self.closed and "stuck" in self.faults:
            goal = before
        if "supply" in self.faults:
            goal = 0.0
        if "runaway" in self.faults and self.closed:
            goal = SUPPLY
        self.pressure = goal + (before - goal) * math.exp(-max(lasts, 0.0) / lag)
        if (before > PRESSURISED) != (self.pressure > PRESSURISED):
            at = self.time + lag * math.log((before - goal) / (PRESSURISED - goal))
            self.log.line("pressurised" if self.pressure > PRESSURISED else "vented", at)
        self.time = now

    # -- registers ------------------------------------------------------------------------------------------------

    def input_words(self) -> list[int]:
        """Input registers 0 to 9."""
        pressure = self.pressure + random.uniform(-0.05, 0.05)
        contraction = max(0.0, (FORCE_PER_KPA * self.pressure - LOAD) / STIFFNESS) + random.uniform(-0.002, 0.002)
        measured = {"p": pressure, "x": contraction, "f": LOAD + random.uniform(-0.2, 0.2)}
        self._seen = self._seen if "frozen" in self.faults and self._seen else measured
        p = self._seen["p"] + self.faults.get("offset", 0.0)
        p = math.nan if "nan" in self.faults else -1e6 if "negative" in self.faults else p
        data = struct.pack(">fffIHH", p, self._seen["x"], self._seen["f"],
                           int(time.monotonic() - self.since), self.restarts, self.ended)  # fmt: skip
        words = list(struct.unpack(">10H", data))
        return [0xFFFF, 0xFFFF, *words[2:]] if "ffff" in self.faults else words

    def holding_words(self) -> dict[int, int]:
        """Every holding register."""
        model = struct.unpack(">12H", b"PR-10".ljust(24, b"\0")[:24])
        fixed = struct.unpack(">HHHH", struct.pack(">II", self.serial, 0x00112233))
        return {**self.holding, **dict(zip(range(100, 116), (*model, *fixed), strict=True))}

    def write(self, register: int | str, value: int, who: str) -> int:
        """Execute a write, unless a fault has it ignored; an exception code, or 0."""
        known = register == "coil" or register in self.holding
        if not known or (register == 10 and value > 10000) or (register == 21 and value > 1):
            self.log.line("refused", register=register, value=value, who=who)
            return 3 if known else 2
        ignored = [fault for fault, some in IGNORED.items() if fault in self.faults and register in some]
        echoed = "echo" in self.faults and register in {10, "coil"}
        self.log.line("write", register=register, value=value, done=not (ignored or echoed), who=who)
        if ignored:
            return 0
        if register == "coil":
            self.coil = bool(value)
            self.closed = self.closed if echoed else self.coil
        else:
            self.holding[int(register)] = value
            self.demand = self.demand if echoed else self.holding[10] * FULL_SCALE
        return 0

    def change(self, fault: str, value: float) -> None:
        """A fault that happens at once, in the registers or at the outputs."""
        if fault.startswith("restart"):
            valve = self.coil, self.closed
            self.switch_on()
            if fault == "restart-valve-kept":  # behind a gateway, and the valve on a block with a supply of its own
                self.coil, self.closed = valve
        elif fault == "serial":
            self.serial += 1
        elif fault == "watchdog-off":
            self.holding[21] = 0
        elif fault == "watchdog-time":
            self.holding[20] = int(value or 6000)
        elif fault in {"set-point", "set-point-zero"}:
            self.holding[10] = int(value) if fault == "set-point" else 0
            self.demand = self.holding[10] * FULL_SCALE
        elif fault == "dump-valve":
            self.coil = self.closed = False
        elif fault == "watchdog-ends":
            self.end_watchdog(time.monotonic())

    def state(self) -> dict[str, object]:
        """The truth, for the judge."""
        return {
            "pressure": self.pressure,
            "set_point": self.holding[10],
            "demand": self.demand,
            "closed": self.closed,
            "watchdog": self.holding[20] * WATCHDOG_COUNT if self.holding[21] else 0.0,
            "fed": self.fed,
            "serial": self.serial,
            "restarts": self.restarts,
            "ended": self.ended,
            "longest": max(self.longest, time.monotonic() - self.asked),
        }


class Connection:
    """One client."""

    def __init__(self, link: socket.socket, who: str) -> None:
        self.link, self.who = link, who
        self.bytes = bytearray()
        self.dead = False
        """Half open: what comes is lost, and nothing is answered."""


class Server:
    """The two sockets: Modbus, and the one that faults come from."""

    def __init__(self, device: Device, ports: list[int], control: int) -> None:
        self._device, self._ports = device, ports
        self._selector = selectors.DefaultSelector()
        self._listeners: list[socket.socket] = []
        self._last: dict[bytes, bytes] = {}
        """The newest answer to each request, for answers that are out of date."""
        self._connections: list[Connection] = []
        self._later: list[tuple[float, Connection, bytes]] = []
        self._listen()
        self._selector.register(socket.create_server(("127.0.0.1", control)), selectors.EVENT_READ, self._controlled)

    def _listen(self) -> None:
        for port in self._ports:
            self._listeners.append(socket.create_server(("127.0.0.1", port)))
            self._selector.register(self._listeners[-1], selectors.EVENT_READ, self._accept)

    def serve(self) -> None:
        """For ever."""
        device, before = self._device, time.monotonic()
        while True:
            ready = self._selector.select(self._until_next())
            now = time.monotonic()
            if now - before > STARVED:
                device.fed += now - before
                device.log.line("starved", lasted=now - before)
            before = now
            device.pass_time(now)
            for key, _ in ready:
                key.data(key.fileobj)
            for item in [item for item in self._later if item[0] <= time.monotonic()]:
                self._later.remove(item)
                self._send(item[1], item[2])
            before = time.monotonic()

    def _until_next(self) -> float:
        device = self._device
        ends = device.fed + device.holding[20] * WATCHDOG_COUNT if device.holding[21] else math.inf
        due = min([ends, *(item[0] for item in self._later)])
        return min(max(due - time.monotonic(), 0.0), 0.02)

    # -- faults ---------------------------------------------------------------------------------------------------

    def _controlled(self, listener: socket.socket) -> None:
        link, lines = listener.accept()[0], bytearray()

        def hear(_: socket.socket) -> None:
            piece = link.recv(4096)
            if not piece:
                self._selector.unregister(link)
                link.close()
                return
            lines.extend(piece)
            while b"\n" in lines:
                line = bytes(lines[: lines.index(b"\n")])
                del lines[: len(line) + 1]
                link.sendall(json.dumps(self._control(json.loads(line))).encode() + b"\n")

        self._selector.register(link, selectors.EVENT_READ, hear)

    def _control(self, asked: dict[str, object]) -> dict[str, object]:
        device = self._device
        if "clear" in asked:
            device.faults.clear()
            if not self._listeners:
                self._listen()
            device.log.line("clear")
        if "mark" in asked:
            device.longest, device.asked = 0.0, time.monotonic()
        if "fault" in asked:
            fault, value = str(asked["fault"]), float(asked.get("value") or 0.0)
            if fault not in ONCE | LASTING:
                return {"error": f"no fault {fault}"}
            device.log.line("fault", fault=fault, value=value, pressure=device.pressure, set_point=device.holding[10])
            self._inject(fault, value)
        return {**device.state(), "t": time.monotonic()}

    def _inject(self, fault: str, value: float) -> None:
        if fault in LASTING:
            self._device.faults[fault] = value
        self._device.change(fault, value)
        if fault in {"reset", "restart", "serial", "refuse-connections"}:
            for connection in list(self._connections):
                connection.link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                self._close(connection)
        while fault == "refuse-connections" and self._listeners:
            listener = self._listeners.pop()
            self._selector.unregister(listener)
            listener.close()
        if fault == "half-open":
            for connection in self._connections:
                connection.dead = True

    # -- Modbus ---------------------------------------------------------------------------------------------------

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            link, (_, port) = listener.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection = Connection(link, str(port))
            self._connections.append(connection)
            self._selector.register(link, selectors.EVENT_READ, lambda _: self._hear(connection))
            self._device.log.line("connected", who=connection.who)

    def _close(self, connection: Connection) -> None:
        self._selector.unregister(connection.link)
        self._connections.remove(connection)
        connection.link.close()
        self._device.log.line("closed", who=connection.who)

    def _hear(self, connection: Connection) -> None:
        if connection not in self._connections:
            return  # closed by a fault in this turn
        try:
            piece = connection.link.recv(4096)
        except OSError:
            piece = b""
        if not piece:
            self._close(connection)
            return
        if connection.dead or "silence" in self._device.faults:
            return  # lost on its way: no sign of life either
        connection.bytes += piece
        while len(connection.bytes) >= 8:
            transaction, protocol, length = struct.unpack_from(">HHH", connection.bytes)
            if protocol or not 2 <= length <= 254:
                self._close(connection)
                return
            if len(connection.bytes) < 6 + length:
                return
            unit, request = connection.bytes[6], bytes(connection.bytes[7 : 6 + length])
            del connection.bytes[: 6 + length]
            if unit == 1:
                self._device.fed = time.monotonic()
                self._reply(connection, transaction, request)

    def _reply(self, connection: Connection, transaction: int, request: bytes) -> None:
        faults, function = self._device.faults, request[0]
        refused = 4 if "exception" in faults else 6 if "busy" in faults else 0
        if refused and function in {5, 6} and len(request) >= 5:
            address, value = struct.unpack_from(">HH", request, 1)
            register = "coil" if function == 5 else address
            self._device.log.line("write", register=register, value=value, done=False, who=connection.who)
        answer = bytes([function | 0x80, refused]) if refused else self._execute(request, connection.who)
        if "stale" in faults:
            answer = self._last.get(request[:5], answer)
        self._last[request[:5]] = answer
        transaction = (transaction + 1) % 65536 if "wrong-transaction" in faults else transaction
        unit = 2 if "wrong-unit" in faults else 1
        frame = struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit) + answer
        now = time.monotonic()
        if "truncated" in faults:
            frame = frame[: len(frame) - 2]
        if "slow" in faults:
            self._later.append((now + (faults["slow"] or 0.3), connection, frame))
        elif "drip" in faults:
            self._later += [(now + 0.04 * n, connection, bytes([byte])) for n, byte in enumerate(frame)]
        else:
            self._send(connection, frame * (2 if "duplicate" in faults else 1))

    def _send(self, connection: Connection, data: bytes) -> None:
        with suppress(OSError):
            if connection in self._connections:
                connection.link.sendall(data)

    def _execute(self, request: bytes, who: str) -> bytes:
        """The answer to a request, after it was done."""
        function, device = request[0], self._device
        if function not in {1, 2, 3, 4, 5, 6, 15, 16}:
            return bytes([function | 0x80, 1])
        try:
            address, count = struct.unpack_from(">HH", request, 1)
            if function in {1, 2}:
                if (address, count) != (0, 1):
                    return bytes([function | 0x80, 2])
                bit = device.coil if function == 1 else "e-stop" not in device.faults
                return bytes([function, 1, int(bit)])
            if function in {3, 4}:
                words = device.holding_words() if function == 3 else dict(enumerate(device.input_words()))
                if function == 4:
                    now = time.monotonic()
                    device.longest, device.asked = max(device.longest, now - device.asked), now
                found = [words[n] for n in range(address, address + count)]
                return bytes([function, 2 * count]) + struct.pack(f">{count}H", *found)
            write: Callable[[int | str, int, str], int] = device.write
            if function == 5:
                code = write("coil", int(count == 0xFF00), who) if address == 0 else 2
            elif function == 6:
                code = write(address, count, who)
            elif function == 15:
                code = write("coil", request[6] & 1, who) if (address, count) == (0, 1) else 2
            else:
                values = struct.unpack_from(f">{count}H", request, 6)
                code = max(write(address + n, value, who) for n, value in enumerate(values))
        except (KeyError, struct.error, IndexError, ValueError):
            code = 2
        return bytes([function | 0x80, code]) if code else request[:5]


def main() -> None:
    """Serve until killed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, required=True, action="append", help="may be given again")
    parser.add_argument("--serial", type=int, default=4711)
    parser.add_argument("--control", type=int, required=True)
    parser.add_argument("--log", required=True)
    given = parser.parse_args()
    log = Log(given.log)
    with suppress(OSError, AttributeError):  # a device has a processor of its own
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(10))
    server = Server(Device(log, given.serial), given.port, given.control)
    log.line("serve", pid=os.getpid())
    server.serve()


if __name__ == "__main__":
    main()
