"""An emulated CMMT on the plant: process data, states, tasks, parameters, time-out, names, faults on demand.

Stricter than a drive may be: it only accepts the requests that Festo's own client makes. If its time-out ends while it
is under power it stops, reports a fault and switches off. Modbus registers and parameter numbers: Festo's client
library festo-edcon 1.0 and its list of parameters, read as a description of the protocol; states: PROFIdrive.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from math import log10
from time import monotonic

from pmabench.bench.interface import DeviceRecord, Scale
from pmabench_drivers.emulator import modbus_server as frames
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.modbus_server import NamedDevice
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.festo_cmmt import emulated_motion as p
from pmabench_drivers.festo_cmmt.emulated_motion import RECORDS, STROKE, Motion
from pmabench_drivers.festo_cmmt.telegram import read_options
from pmabench_drivers.shared.options import options_of

FACTORY = 1000
"""Initial time-out [ms]; 0: none."""
WARMING = 0.02
"""Time from the command until it is under power [s]."""
PROCESS_OUT, PROCESS_IN, TIMEOUT = 0, 100, 400
NUMBER, SUBINDEX, ELEMENTS, EXECUTE, LENGTH, DATA = 500, 501, 502, 503, 504, 510
"""Mailbox of parameters."""
READ, WRITE, FAILED, DONE = 1, 2, 3, 0x10
"""Values written to `EXECUTE`, and its values afterwards."""
LONGEST_DATA = 64
ON, NO_COAST_STOP, NO_QUICK_STOP, ENABLE = (1 << bit for bit in range(4))
"""Bits of STW1 that all telegrams have."""
TELEGRAM = 3490
PROCESS_WORDS = {
    1: "STW1", 2: "ZSW1", 3: "STW2", 4: "ZSW2", 34: "MDI_TARPOS", 35: "MDI_VELOCITY", 36: "MDI_ACC", 37: "MDI_DEC",
    102: "MELDW", 205: "OVERRIDE", 220: "POS_STW1", 221: "POS_ZSW1", 222: "POS_STW2", 223: "POS_ZSW2",
    301: "FAULT_CODE", 303: "WARN_CODE",
}  # fmt: skip
"""Parameters that are words of the process data."""
FULL = 0x4000
"""100 % of the override."""
BASE_VELOCITY = 0.1
"""Base value of the velocity [m/s]."""
BEHIND, SO_LONG = 0.003, 0.1
"""A deviation from the profile that is larger [m] for longer [s] is a following error."""
TIMED_OUT, OUT_OF_STROKE, FOLLOWING = 299, 110, 126
"""Fault codes; the one for a Modbus time-out is the emulator's guess."""
POSITION_PREFIX, VELOCITY_PREFIX, BASE_VALUE = 11724, 11725, 12345
"""Parameters: decimal exponents of its units, base value of the velocity."""
SERIAL_NUMBER = 2076
"""Parameter: serial number of the control unit, a text of 9 characters."""
MILLI = -3
"""Decimal exponent of its velocity unit [m/s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> NamedDevice:
    """Emulated drive for a device of the driver `festo-cmmt`, on this machine."""
    options_of(device, read_options)
    return NamedDevice(EmulatedDrive(device, plant, log), log)


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
            BASE_VALUE: struct.pack("<f", BASE_VELOCITY),
            SERIAL_NUMBER: b"EMULATED1",
        }
        """Number -> its bytes, except for parameters in the process data."""
        self.motion = Motion(plant, self._scale, lambda kind, **data: log.note(kind, device.name, **data))
        self.control, self.supplied, self.fault = True, True, 0
        self.timeout = FACTORY
        """Time without communication after which it stops [ms]; 0: never."""
        self._out = [0] * p.SIZE
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
        self.motion.settle(monotonic())
        cells = {PROCESS_IN + i: word for i, word in enumerate(p.join(self.telegram, self._status_words()))}
        cells.update({TIMEOUT: self.timeout, TIMEOUT + 1: 0})
        cells.update({EXECUTE: self._mail[EXECUTE], LENGTH: self._mail[LENGTH]})
        cells.update({DATA + i: word for i, word in enumerate(self._data)})
        return cells

    def _write(self, request: frames.Request, connection: int, *, ignore: bool) -> None:
        self.motion.settle(monotonic())
        shape = request.function, request.address, request.count
        if request.function == 16 and request.address == PROCESS_OUT:
            if request.count not in {p.length(self.telegram), p.SIZE}:
                raise frames.Refused(frames.ADDRESS)
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
                self._carry_parameter()
        elif request.function == 16 and request.address == DATA and request.count <= LONGEST_DATA:
            self._data = list(request.values)
        else:
            raise frames.Refused(frames.ADDRESS)

    # -- parameters -----------------------------------------------------------------------------------------------

    @property
    def telegram(self) -> int:
        """The selected telegram."""
        return int.from_bytes(self.parameters[TELEGRAM], "little")

    def _carry_parameter(self) -> None:
        """Read or write the parameter named in the mailbox."""
        number, what = self._mail[NUMBER], self._mail[EXECUTE]
        one = self._mail[ELEMENTS] == 1 and self._mail[SUBINDEX] == 0
        if what == WRITE:
            size = self._mail[LENGTH]
            given = b"".join(word.to_bytes(2, "little") for word in self._data)[:size]
            self._mail[EXECUTE] = DONE if one and len(given) == size and self._set(number, given) else FAILED
            return
        data = {**self.parameters, **self._process_parameters()}.get(number)
        if data is None or what != READ or not one:
            self._mail[EXECUTE], self._mail[LENGTH], self._data = FAILED, 0, []
            return
        padded = data + b"\0" * (len(data) % 2)
        self._data = list(struct.unpack(f"<{len(padded) // 2}H", padded))
        self._mail[EXECUTE], self._mail[LENGTH] = DONE, len(data)

    def _process_parameters(self) -> dict[int, bytes]:
        """Parameters that are words of the process data."""
        values = p.split(self.telegram, self._out) | self._status_words()
        found = {number: (values.get(name, 0), 4 if name in p.LONG else 2) for number, name in PROCESS_WORDS.items()}
        return {
            number: (value & (1 << 8 * size) - 1).to_bytes(size, "little") for number, (value, size) in found.items()
        }

    def _set(self, number: int, data: bytes) -> bool:
        """Write a parameter; returns whether the drive accepts it: only the telegram, and without power."""
        if number != TELEGRAM or len(data) != 2 or int.from_bytes(data, "little") not in p.SENT or self.enabled:
            return False
        self.parameters[number] = data
        self._out = [0] * p.SIZE
        return True

    # -- states ---------------------------------------------------------------------------------------------------

    @property
    def enabled(self) -> bool:
        """Whether it is under power."""
        return monotonic() >= self._powered

    @property
    def homed(self) -> bool:
        """Whether its positions have a reference."""
        return self.motion.homed

    @homed.setter
    def homed(self, homed: bool) -> None:
        self.motion.homed = homed

    def _obey(self, words: list[int]) -> None:
        """Apply new process data: the changes of the control word, and the target."""
        before, self._out = self._out, words
        now, was = p.split(self.telegram, words), p.split(self.telegram, before)
        control, rising = now["STW1"], now["STW1"] & ~was["STW1"]
        if not control & p.BY_PLC or not self.control:
            self._off("no control")
            return
        if rising & p.ACKNOWLEDGE and self.fault:
            self.fault = 0
        free = control & NO_COAST_STOP and control & NO_QUICK_STOP
        if not control & ON and free and not self.fault:
            self._inhibited = False
        if now.get("POS_STW2", 0) & ~was.get("POS_STW2", 0) & p.SET_REFERENCE:
            self.motion.home_here()
        if not (free and control & ON and control & ENABLE):
            self._off("switched off")
            return
        if rising & ON and self._can and self._powered == float("inf"):
            self._powered = monotonic() + WARMING
            self._log.note("power", self.device.name, on=True)
        if not self.enabled:
            return
        if self.telegram in p.BY_SPEED:
            self._turn(now, was)
        else:
            self._move(now, was, started=bool(before[0] & ON))

    def _turn(self, now: Mapping[str, int], was: Mapping[str, int]) -> None:
        """Apply a commanded velocity: takes effect at once; stops if one of three bits is missing."""
        [name] = [name for name in now if name in p.FULL_SPEED]
        free = p.REJECT | p.GO_ON | p.TASK
        wanted, before = (w[name] if w["STW1"] & free == free else 0 for w in (now, was))
        if wanted == before:
            return
        if wanted:
            self.motion.run(wanted, abs(wanted) / p.FULL_SPEED[name] * BASE_VELOCITY)
        else:
            self._hold()

    def _move(self, now: Mapping[str, int], was: Mapping[str, int], *, started: bool) -> None:
        """Tasks, homing and jogging according to the control word."""
        control, rising, falling = now["STW1"], now["STW1"] & ~was["STW1"], was["STW1"] & ~now["STW1"]
        if not control & p.REJECT:
            if self._taken or not started or falling & p.REJECT:
                self._log.note("halt", self.device.name)
            self._hold()
            return
        if not control & p.GO_ON:
            if falling & p.GO_ON:
                self._log.note("halt", self.device.name)
            self.motion.interrupt()
            return
        if rising & p.GO_ON:
            self.motion.go_on()
        if falling & p.HOME:
            self.motion.give_up_homing()
        if rising & p.HOME:
            self._log.note("homing", self.device.name)
            self.motion.home()
        jogs = p.JOG_1 | p.JOG_2
        if (control ^ was["STW1"]) & jogs:
            forwards = bool(control & p.JOG_1) - bool(control & p.JOG_2)
            self.motion.jog(forwards, by_steps=bool(now.get("POS_STW2", 0) & p.BY_STEPS))
        if control & p.TASK:
            self._task(now, was, rising=bool(rising & p.TASK))

    def _task(self, now: Mapping[str, int], was: Mapping[str, int], *, rising: bool) -> None:
        """Begin a task at the rising edge of its bit, or at each new set-point if the mode says so."""
        if self.telegram == 9:
            by_record, mode = not now["SATZANW"] & p.MDI, p.ABSOLUTE if now["MDI_MOD"] & 1 else 0
            number = now["SATZANW"] & p.RECORD
        else:
            mode = now["POS_STW1"]
            by_record, number = not mode & p.MDI, mode & p.RECORD
        changed = any(now.get(name) != was.get(name) for name in ("OVERRIDE", "MDI_TARPOS", "MDI_VELOCITY"))
        if not rising and not (mode & p.CONTINUOUS and mode & p.ABSOLUTE and changed and not by_record):
            return
        pace = now["MDI_VELOCITY"] * 10.0**MILLI * now.get("OVERRIDE", FULL) / FULL
        if by_record:
            if self.homed and number in RECORDS:
                self._log.note("record", self.device.name, number=number)
                self.motion.go(*RECORDS[number])
                self._taken = True
        elif mode & p.SET_UP:
            self.motion.run(1 if mode & p.FORWARD else -1, pace)
            self._taken = True
        elif self.homed:
            self._go(self.motion.target(now["MDI_TARPOS"], absolute=bool(mode & p.ABSOLUTE)), pace)

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
        self.motion.stop()
        self._taken = False

    def _go(self, place: float, pace: float) -> None:
        """Move to a target from the profile's present position."""
        if not STROKE[0] <= place <= STROKE[1]:
            self._fail(OUT_OF_STROKE)
            return
        self.motion.go(place, pace)
        self._taken = True

    def _fail(self, code: int) -> None:
        self.fault = code
        self._log.note("fault", self.device.name, code=code)
        self._off(f"fault {code}")

    def _status_words(self) -> dict[str, int]:
        """Words of the input process data, of all telegrams."""
        now, motion = monotonic(), self.motion
        if self._powered > now or motion.off(now) <= BEHIND:
            self._behind_since = now
        elif now - self._behind_since > SO_LONG:
            self._fail(FOLLOWING)
        sent = p.split(self.telegram, self._out)
        control, mode = sent["STW1"], sent.get("POS_STW1", 0)
        at_rest, velocity, forwards = motion.rests(now), motion.velocity(now), motion.forwards(now)
        task = self._taken and bool(control & p.TASK)
        status = {
            "ready to switch on": self._can,
            "ready to operate": self._powered != float("inf"),
            "enabled": self.enabled,
            "fault": bool(self.fault),
            "no coast stop": bool(control & NO_COAST_STOP),
            "no quick stop": bool(control & NO_QUICK_STOP),
            "inhibited": self._inhibited,
            "follows": motion.off(now) <= BEHIND,
            "control": self.control,
            "reached": at_rest,
            "homed": self.homed,
            "taken": task,
            "stopped": at_rest,
        }
        position = {
            "jogging": motion.jogging,
            "homing": motion.homing,
            "by record": task and not mode & p.MDI,
            "set up": task and bool(mode & p.SET_UP),
            "mdi": task and bool(mode & p.MDI),
        }
        more = {"forwards": forwards > 0, "backwards": forwards < 0, "task active": task and not at_rest}
        share = abs(velocity) / BASE_VELOCITY * forwards
        return {
            "ZSW1": p.bits(p.ZSW1, status),
            "POS_ZSW1": p.bits(p.POS_ZSW1, position) | (mode & p.RECORD if position["by record"] else 0),
            "POS_ZSW2": p.bits(p.POS_ZSW2, more),
            "XIST_A": motion.position(),
            "G1_XIST1": motion.position(),
            "NIST_A": round(share * p.FULL_SPEED["NIST_A"]),
            "NIST_B": round(share * p.FULL_SPEED["NIST_B"]),
            "FAULT_CODE": self.fault,
        }

    # -- what it does by itself -----------------------------------------------------------------------------------

    def expire_watchdog(self) -> bool:
        """Let the time-out end at the next check; returns whether it has one that stops it."""
        self._expire = self.timeout > 0 and self._powered != float("inf")
        return self._expire

    def restart(self) -> None:
        """Reset to power-on: without power, with the factory time-out, and still homed (absolute encoder)."""
        with self._lock:
            self._off("restart")
            self._out, self.timeout, self.fault, self._inhibited = [0] * p.SIZE, FACTORY, 0, True
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
