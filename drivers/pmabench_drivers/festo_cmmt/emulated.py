"""An emulated CMMT on the plant: telegram 111, states, targets, parameters that are read, time-out, faults on demand.

Written separately from the driver's `telegram`, so that each checks the other. Stricter than a drive may be: it moves
to absolute targets only, and accepts no parameter. If its time-out ends while it is under power it stops, reports a
fault and switches off. Modbus registers and parameter numbers: Festo's client library festo-edcon 1.0 and its list of
parameters, read as a description of the protocol; words and states: PROFIdrive, names as there. The axis's profile has
no acceleration. Places are metres of contraction; positions are user units from the place of its reference.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log10
from time import monotonic

from pmabench.bench.interface import DeviceRecord, Scale
from pmabench_drivers.emulator import modbus_server as frames
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.modbus_server import NamedDevice
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.festo_cmmt.telegram import read_options
from pmabench_drivers.shared.options import options_of

FACTORY = 1000
"""Initial time-out [ms]; 0: none."""
WARMING = 0.02
"""Time from the command until it is under power [s]."""
PROCESS_OUT, PROCESS_IN, TIMEOUT = 0, 100, 400
SIZE = 28
"""Registers of process data in each direction."""
SENT = (
    "STW1", "POS_STW1", "POS_STW2", "STW2", "OVERRIDE", "MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC",
)  # fmt: skip
"""Words sent to the drive, in 11 registers; `GIVEN`: words that it sends."""
GIVEN = ("ZSW1", "POS_ZSW1", "POS_ZSW2", "ZSW2", "MELDW", "XIST_A", "NIST_B", "FAULT_CODE", "WARN_CODE")
WORDS, REGISTERS = struct.Struct("<5H2i2H"), struct.Struct("<11H")
"""Words of either direction, of which the sixth and the seventh have 32 bits, low register first, signed."""
ON, NO_COAST_STOP, NO_QUICK_STOP, ENABLE, KEEP_TASK, GO_ON, TASK, ACKNOWLEDGE = (1 << bit for bit in range(8))
BY_PLC = 1 << 10
"""Bits of STW1; without `KEEP_TASK` or `GO_ON` it stops."""
ABSOLUTE, CONTINUOUS, MDI = 1 << 8, 1 << 12, 1 << 15
"""Bits of POS_STW1."""
ZSW1 = (
    "ready to switch on", "ready to operate", "enabled", "fault", "no coast stop", "no quick stop", "inhibited",
    "warning", "follows", "control", "reached", "homed", "taken", "stopped", "accelerates", "decelerates",
)  # fmt: skip
"""Bits in order of their position."""
NUMBER, SUBINDEX, ELEMENTS, EXECUTE, LENGTH, DATA = 500, 501, 502, 503, 504, 510
"""Mailbox of parameters."""
READ, FAILED, DONE = 1, 3, 0x10
"""Value written to `EXECUTE`, and its values afterwards."""
TELEGRAM, TARGET = 3490, 34
"""Parameters: the selected telegram; MDI_TARPOS, which is a word of the process data."""
FULL = 0x4000
"""100 % of the override."""
STROKE = (-0.01, 0.09)
"""Software limits [m of contraction]."""
BEHIND, SO_LONG = 0.003, 0.1
"""A deviation from the profile that is larger [m] for longer [s] is a following error."""
TIMED_OUT, OUT_OF_STROKE, FOLLOWING = 299, 110, 126
"""Fault codes; the one for a Modbus time-out is the emulator's guess."""
POSITION_PREFIX, VELOCITY_PREFIX = 11724, 11725
"""Parameters: decimal exponents of its units."""
SERIAL_NUMBER = 2076
"""Parameter: serial number of the control unit, a text of 9 characters."""
MILLI = -3
"""Decimal exponent of its velocity unit [m/s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> NamedDevice:
    """Emulated drive for a device of the driver `festo-cmmt`, on this machine."""
    options_of(device, read_options)
    return NamedDevice(EmulatedDrive(device, plant, log), log)


def split(words: Sequence[int]) -> dict[str, int]:
    """Values sent, by name."""
    return dict(zip(SENT, WORDS.unpack(REGISTERS.pack(*words[: len(SENT) + 2])), strict=True))


@dataclass
class Way:
    """Path from `origin` to `target` [m of contraction] at `pace` [m/s] since `begun` [s, monotonic]."""

    origin: float = 0.0
    target: float = 0.0
    pace: float = 0.0
    begun: float = 0.0

    def at(self, now: float) -> float:
        """Place on the path."""
        left, way = self.target - self.origin, self.pace * (now - self.begun)
        return self.target if way >= abs(left) else self.origin + (way if left > 0 else -way)


class EmulatedDrive(frames.NamedRegisters):
    """Registers of one drive, and their effect on the plant."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        super().__init__(device, "CMMT-AS", plant.model("CMMT-AS"))
        self._plant, self._log = plant, log
        scales = [output.scale for output in device.outputs] + [channel.scale for channel in device.channels]
        self._scale = scales[0] if scales else Scale(1e-6)
        prefix = round(log10(abs(self._scale.slope)))
        self.parameters = {
            TELEGRAM: struct.pack("<H", 111),
            POSITION_PREFIX: struct.pack("<b", prefix),
            VELOCITY_PREFIX: struct.pack("<b", MILLI),
            SERIAL_NUMBER: b"EMULATED1",
        }
        """Number -> its bytes, except for `TARGET`."""
        self.control, self.supplied, self.homed, self.fault = True, True, True, 0
        self.zero = 0
        """User units at a contraction of 0."""
        self.timeout = FACTORY
        """Time without communication after which it stops [ms]; 0: never."""
        self._way = Way()
        self._out = [0] * SIZE
        self._mail = dict.fromkeys((NUMBER, SUBINDEX, ELEMENTS, EXECUTE, LENGTH), 0)
        self._data: list[int] = []
        self._powered = float("inf")
        """When it is under power [s, monotonic]; infinite: it is not."""
        self._inhibited = True
        self._taken = False
        self._behind_since = 0.0
        self._expire = False

    # -- requests -------------------------------------------------------------------------------------------------

    def _cells(self) -> Mapping[int, int]:
        cells = {PROCESS_IN + i: word for i, word in enumerate(self._status_words())}
        cells.update({TIMEOUT: self.timeout, TIMEOUT + 1: 0})
        cells.update({EXECUTE: self._mail[EXECUTE], LENGTH: self._mail[LENGTH]})
        cells.update({DATA + i: word for i, word in enumerate(self._data)})
        return cells

    def _write(self, request: frames.Request, connection: int, *, ignore: bool) -> None:
        shape = request.function, request.address, request.count
        if shape in {(16, PROCESS_OUT, len(SENT) + 2), (16, PROCESS_OUT, SIZE)}:
            if not ignore:
                self._obey([*request.values, *self._out[request.count :]])
        elif shape == (16, TIMEOUT, 2):
            if request.values[1] or 0 < request.values[0] < 100:
                raise frames.Refused(frames.VALUE)
            if not ignore:
                self.timeout = request.values[0]
                self._log.note("watchdog-register", self.device.name, raw=self.timeout)
        elif request.function == 6 and request.address in self._mail:
            self._mail[request.address] = request.values[0]
            if request.address == EXECUTE and not ignore:
                self._give_parameter()
        else:
            raise frames.Refused(frames.ADDRESS)

    def _give_parameter(self) -> None:
        """Read the parameter named in the mailbox."""
        number, one = self._mail[NUMBER], self._mail[ELEMENTS] == 1 and self._mail[SUBINDEX] == 0
        data = {**self.parameters, TARGET: struct.pack("<i", split(self._out)["MDI_TARPOS"])}.get(number)
        if data is None or self._mail[EXECUTE] != READ or not one:
            self._mail[EXECUTE], self._mail[LENGTH], self._data = FAILED, 0, []
            return
        padded = data + b"\0" * (len(data) % 2)
        self._data = list(struct.unpack(f"<{len(padded) // 2}H", padded))
        self._mail[EXECUTE], self._mail[LENGTH] = DONE, len(data)

    # -- states ---------------------------------------------------------------------------------------------------

    @property
    def enabled(self) -> bool:
        """Whether it is under power."""
        return monotonic() >= self._powered

    def _obey(self, words: list[int]) -> None:
        """Apply new process data: the changes of the control word, and the target."""
        before, self._out = self._out, words
        now, was = split(words), split(before)
        control, rising = now["STW1"], now["STW1"] & ~was["STW1"]
        if not control & BY_PLC or not self.control:
            self._off("no control")
            return
        if rising & ACKNOWLEDGE and self.fault:
            self.fault = 0
        free = control & NO_COAST_STOP and control & NO_QUICK_STOP
        if not control & ON and free and not self.fault:
            self._inhibited = False
        if not (free and control & ON and control & ENABLE):
            self._off("switched off")
            return
        if rising & ON and self._can and self._powered == float("inf"):
            self._powered = monotonic() + WARMING
            self._log.note("power", self.device.name, on=True)
        if self.enabled:
            self._move(now, was, started=bool(was["STW1"] & ON))

    def _move(self, now: Mapping[str, int], was: Mapping[str, int], *, started: bool) -> None:
        """Stop, or move to a target: at the rising edge of its bit, or at each new set-point if the mode says so."""
        control, mode, keep = now["STW1"], now["POS_STW1"], KEEP_TASK | GO_ON
        if control & keep != keep:
            if self._taken or not started or was["STW1"] & keep == keep:
                self._log.note("halt", self.device.name)
            self._hold()
            return
        rising = control & ~was["STW1"] & TASK
        changed = any(now[name] != was[name] for name in ("OVERRIDE", "MDI_TARPOS", "MDI_VELOCITY"))
        wanted = control & TASK and (rising or (mode & CONTINUOUS and changed))
        if wanted and mode & MDI and mode & ABSOLUTE and self.homed:
            pace = now["MDI_VELOCITY"] * 10.0**MILLI * now["OVERRIDE"] / FULL
            self._go(float(self._scale.to_si(now["MDI_TARPOS"] + self.zero)), pace)

    @property
    def _can(self) -> bool:
        return self.supplied and not self.fault and not self._inhibited

    def _off(self, why: str) -> None:
        if self._powered != float("inf"):
            self._powered = float("inf")
            self._inhibited = True
            self._hold()
            self._log.note("power", self.device.name, on=False, why=why)

    def _hold(self) -> None:
        """Stop, and hold the position."""
        place = self._plant.stop_drive()
        self._way, self._taken = Way(place, place), False

    def _go(self, place: float, pace: float) -> None:
        """Move to a target from the profile's present position."""
        if not STROKE[0] <= place <= STROKE[1]:
            self._fail(OUT_OF_STROKE)
            return
        now = monotonic()
        self._way, self._taken = Way(self._way.at(now), place, pace, now), True
        self._log.note("move", self.device.name, si=place, speed=pace)
        if pace > 0:
            self._plant.drive(place, pace, self._way.origin)

    def _fail(self, code: int) -> None:
        self.fault = code
        self._log.note("fault", self.device.name, code=code)
        self._off(f"fault {code}")

    def _status_words(self) -> list[int]:
        """Registers of the input process data."""
        now, place = monotonic(), self._plant.quantities()["displacement"]
        off = abs(place - self._way.at(now))
        if self._powered > now or off <= BEHIND:
            self._behind_since = now
        elif now - self._behind_since > SO_LONG:
            self._fail(FOLLOWING)
        control, at_rest = split(self._out)["STW1"], self._way.at(now) == self._way.target
        true = {
            "ready to switch on": self._can,
            "ready to operate": self._powered != float("inf"),
            "enabled": self.enabled,
            "fault": bool(self.fault),
            "no coast stop": bool(control & NO_COAST_STOP),
            "no quick stop": bool(control & NO_QUICK_STOP),
            "inhibited": self._inhibited,
            "follows": off <= BEHIND,
            "control": self.control,
            "reached": at_rest,
            "homed": self.homed,
            "taken": self._taken and bool(control & TASK),
            "stopped": at_rest,
        }
        values = {
            "ZSW1": sum(true.get(name, False) << bit for bit, name in enumerate(ZSW1)),
            "XIST_A": min(max(round(float(self._scale.to_raw(place))) - self.zero, -(2**31)), 2**31 - 1),
            "FAULT_CODE": self.fault,
        }
        words = REGISTERS.unpack(WORDS.pack(*(values.get(name, 0) for name in GIVEN)))
        return [*words, *[0] * (SIZE - len(words))]

    # -- what it does by itself -----------------------------------------------------------------------------------

    def expire_watchdog(self) -> bool:
        """Let the time-out end at the next check; returns whether it has one that stops it."""
        self._expire = self.timeout > 0 and self._powered != float("inf")
        return self._expire

    def restart(self) -> None:
        """Reset to power-on: without power, with the factory time-out, and still homed (absolute encoder)."""
        with self._lock:
            self._off("restart")
            self._out, self.timeout, self.fault, self._inhibited = [0] * SIZE, FACTORY, 0, True
            self._mail, self._data = dict.fromkeys(self._mail, 0), []
            self._heard = monotonic()
            self._log.note("restart", self.device.name)

    def change_set_point(self, value: float) -> bool:
        """Write a target [user units] as another program would; returns whether the drive accepts it."""
        with self._lock:
            target = round(value)
            self._obey([*self._out[:5], target & 0xFFFF, target >> 16 & 0xFFFF, *self._out[7:]])
            return self.enabled

    def look_at_watchdog(self) -> None:
        """Stop if nothing was received for the time-out."""
        with self._lock:
            if self._powered == float("inf"):
                return
            now = monotonic()
            if self.timeout and (self._expire or now - self._heard > self.timeout / 1e3):
                self._expire = False
                self._log.note("watchdog", self.device.name, silent=now - self._heard)
                self._fail(TIMED_OUT)
