"""An emulated CMMT in front of the plant: process data, states, profile, parameters, time-out, names, faults on demand.

Stricter than a drive may be: it takes only the requests that Festo's own client makes. Its profile has no acceleration.
When its time-out ends while it is under power it stops, reports a fault and is off.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Mapping
from math import log10
from time import monotonic

from pmabench.bench.interface import EMULATED, DeviceRecord, Scale
from pmabench_drivers.emulator import frames
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.festo_cmmt import telegram as t
from pmabench_drivers.festo_cmmt.options import read_options
from pmabench_drivers.festo_cpx_e.named import NamedDevice
from pmabench_drivers.modbus.registers import Register, decode, encode
from pmabench_drivers.options import Reader

NAMES = ("emulator of pmabench", "CMMT-AS", "1", "", f"{EMULATED}CMMT-AS", "")
"""Objects 0 to 5 of the device identification."""
FACTORY = 1000
"""Time-out until it is set [ms]; 0: none."""
WARMING = 0.02
"""From the command to be under power [s]."""
STROKE = (-0.01, 0.09)
"""Software limits [m of contraction]."""
BEHIND, SO_LONG = 0.003, 0.1
"""A place that is so far from the profile [m] for so long [s] is a following error."""
TIMED_OUT, OUT_OF_STROKE, FOLLOWING = 299, 110, 126
"""Fault codes; which one a drive has for a time-out of Modbus is the emulator's guess."""
SERIAL_NUMBER = 2076
"""Parameter: serial number of the control unit, a text of 9 characters."""
MILLI = -3
"""Decimal exponent of its velocity unit [m/s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> CmmtDevice:
    """The drive that a device of the driver `festo-cmmt` talks to, on this machine."""
    reader = Reader()
    read_options(device, reader)
    reader.refuse(device.name)
    return CmmtDevice(EmulatedDrive(device, plant, log), log, int(device.address.rpartition(":")[2]))


class EmulatedDrive:
    """The registers of one drive, and what they do to the plant."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self.device, self._plant, self._log = device, plant, log
        self._lock = threading.Lock()
        scales = [output.scale for output in device.outputs] + [channel.scale for channel in device.channels]
        self._scale = scales[0] if scales else Scale(1e-6)
        prefix = round(log10(abs(self._scale.slope)))
        self.parameters = {
            t.TELEGRAM: struct.pack("<H", t.TELEGRAM_111),
            t.POSITION_PREFIX: struct.pack("<b", prefix),
            t.VELOCITY_PREFIX: struct.pack("<b", MILLI),
            SERIAL_NUMBER: b"EMULATED1",
        }
        """Number -> its bytes, besides what process data says."""
        self.control, self.homed, self.supplied, self.fault = True, True, True, 0
        self.timeout = FACTORY
        """Without communication for so long it stops [ms]; 0: never."""
        self._out = [0] * t.SENT
        self._mail = dict.fromkeys((t.NUMBER, t.SUBINDEX, t.ELEMENTS, t.EXECUTE, t.LENGTH), 0)
        self._data: list[int] = []
        self._powered = float("inf")
        """When it is under power [s, monotonic]; infinite: it is not."""
        self._inhibited = True
        self._taken = False
        self._from = self._to = 0.0
        self._begun, self._pace = 0.0, 0.0
        self._behind_since = 0.0
        self._heard, self._expire = monotonic(), False

    # -- requests -------------------------------------------------------------------------------------------------

    def hear(self) -> None:
        """Any communication."""
        with self._lock:
            self._heard = monotonic()

    def carry_out(self, request: frames.Request, connection: int, *, ignore: bool = False) -> list[int]:
        """What is read, or nothing; `Refused` where the drive says no."""
        self.hear()
        if request.table != "holding":
            raise frames.Refused(frames.FUNCTION)
        with self._lock:
            if request.values:
                self._write(request, ignore=ignore)
                return []
            cells = self._cells()
            wanted = [request.address + offset for offset in range(request.count)]
            if any(address not in cells for address in wanted):
                raise frames.Refused(frames.ADDRESS)
            return [cells[address] for address in wanted]

    def _cells(self) -> Mapping[int, int]:
        """Everything that can be read now."""
        cells = {t.PROCESS_IN + i: word for i, word in enumerate(self._told())}
        cells.update({t.TIMEOUT.address: self.timeout, t.TIMEOUT.address + 1: 0})
        cells.update({t.EXECUTE: self._mail[t.EXECUTE], t.LENGTH: self._mail[t.LENGTH]})
        cells.update({t.DATA + i: word for i, word in enumerate(self._data)})
        return cells

    def _write(self, request: frames.Request, *, ignore: bool) -> None:
        shape = request.function, request.address, request.count
        if shape in {(16, t.PROCESS_OUT, t.SENT), (16, t.PROCESS_OUT, t.SIZE)}:
            if not ignore:
                self._obey(list(request.values[: t.SENT]))
        elif shape == (16, t.TIMEOUT.address, 2):
            if request.values[1] or 0 < request.values[0] < 100:
                raise frames.Refused(frames.VALUE)
            if not ignore:
                self.timeout = request.values[0]
                self._log.note("watchdog-register", self.device.name, raw=self.timeout)
        elif request.function == 6 and request.address in {t.NUMBER, t.SUBINDEX, t.ELEMENTS, t.EXECUTE}:
            self._mail[request.address] = request.values[0]
            if request.address == t.EXECUTE and not ignore:
                self._tell()
        else:
            raise frames.Refused(frames.ADDRESS)

    def _tell(self) -> None:
        """The parameter that is asked for, into the mailbox."""
        number = self._mail[t.NUMBER]
        target = struct.pack("<HH", *self._out[5:7])
        data = {**self.parameters, t.TARGET: target}.get(number)
        if data is None or self._mail[t.EXECUTE] != t.READ or self._mail[t.ELEMENTS] != 1:
            self._mail[t.EXECUTE], self._mail[t.LENGTH], self._data = t.FAILED, 0, []
            return
        padded = data + b"\0" * (len(data) % 2)
        self._data = list(struct.unpack(f"<{len(padded) // 2}H", padded))
        self._mail[t.EXECUTE], self._mail[t.LENGTH] = t.DONE, len(data)

    # -- states ---------------------------------------------------------------------------------------------------

    @property
    def enabled(self) -> bool:
        """Whether it is under power."""
        return monotonic() >= self._powered

    def _obey(self, words: list[int]) -> None:
        """New process data: what changed in the control word, and where it is sent."""
        before, self._out = self._out, words
        control, mode, rising = words[0], words[1], words[0] & ~before[0]
        if not control & t.BY_PLC or not self.control:
            self._off("no control")
            return
        if rising & t.ACKNOWLEDGE and self.fault:
            self.fault = 0
        free = control & t.NO_COAST_STOP and control & t.NO_QUICK_STOP
        if not control & t.ON and free and not self.fault:
            self._inhibited = False
        if not (free and control & t.ON and control & t.ENABLE):
            self._off("switched off")
            return
        if rising & t.ON and self._can and self._powered == float("inf"):
            self._powered = monotonic() + WARMING
            self._log.note("power", self.device.name, on=True)
        if not self.enabled:
            return
        if not control & t.KEEP_TASK or not control & t.NO_INTERMEDIATE_STOP:
            if self._taken or not before[0] & t.ON or before[0] & t.KEEP_TASK:
                self._log.note("halt", self.device.name)
            self._stand()
            return
        new = rising & t.TASK or (mode & t.CONTINUOUS and words[4:9] != before[4:9])
        if control & t.TASK and new and mode & t.MDI and mode & t.ABSOLUTE:
            self._go(words)

    @property
    def _can(self) -> bool:
        return self.supplied and not self.fault and not self._inhibited

    def _off(self, why: str) -> None:
        if self._powered != float("inf"):
            self._powered = float("inf")
            self._inhibited = True
            self._stand()
            self._log.note("power", self.device.name, on=False, why=why)

    def _stand(self) -> None:
        """Stop, and hold the place."""
        self._from = self._to = self._plant.stop_drive()
        self._taken = False

    def _go(self, words: list[int]) -> None:
        """Move to the target that came with the process data, from where the profile is."""
        if not self.homed:
            return
        target = decode(Register("", "holding", 0, "int32", low_word_first=True), words[5:7])
        velocity = decode(Register("", "holding", 0, "uint32", low_word_first=True), words[7:9])
        si, pace = float(self._scale.to_si(target)), velocity * 10.0**MILLI * words[4] / t.FULL
        if not STROKE[0] <= si <= STROKE[1]:
            self._fail(OUT_OF_STROKE)
            return
        self._log.note("move", self.device.name, si=si, speed=pace)
        now = monotonic()
        self._from, self._to, self._begun, self._pace = self._profile(now), si, now, pace
        if pace > 0:
            self._plant.drive(si, pace, self._from)
        self._taken = True

    def _profile(self, now: float) -> float:
        left, way = self._to - self._from, self._pace * (now - self._begun)
        return self._to if way >= abs(left) else self._from + (way if left > 0 else -way)

    def _fail(self, code: int) -> None:
        self.fault = code
        self._log.note("fault", self.device.name, code=code)
        self._off(f"fault {code}")

    def _told(self) -> list[int]:
        """The input process data."""
        place = self._plant.quantities()["displacement"]
        raw = min(max(round(float(self._scale.to_raw(place))), -(2**31)), 2**31 - 1)
        now = monotonic()
        at_rest = self._profile(now) == self._to
        if self._powered > now or abs(place - self._profile(now)) <= BEHIND:
            self._behind_since = now
        elif now - self._behind_since > SO_LONG:
            self._fail(FOLLOWING)
        bits = {
            t.READY: self._can,
            t.ENABLED: self.enabled,
            t.FAULT: bool(self.fault),
            t.INHIBITED: self._inhibited,
            t.CONTROL: self.control,
            t.HOMED: self.homed,
            t.REACHED: at_rest,
            t.TAKEN: self._taken,
            t.STOPPED: at_rest,
        }
        word = sum(bit for bit, on in bits.items() if on)
        position = encode(Register("", "holding", 0, "int32", low_word_first=True), raw)
        words = [word, 0, 0, 0, 0, *position, 0, 0, self.fault, 0]
        return words + [0] * (t.SIZE - len(words))

    # -- what it does by itself -----------------------------------------------------------------------------------

    def expire_watchdog(self) -> bool:
        """Let the time-out end at the next look; whether there is one that stops it."""
        self._expire = self.timeout > 0 and self._powered != float("inf")
        return self._expire

    def restart(self) -> None:
        """As after power-on: without power, with the time-out from the factory, and still homed (absolute encoder)."""
        with self._lock:
            self._off("restart")
            self._out, self.timeout, self.fault, self._inhibited = [0] * t.SENT, FACTORY, 0, True
            self._mail, self._data = dict.fromkeys(self._mail, 0), []
            self._heard = monotonic()
            self._log.note("restart", self.device.name)

    def switch_off_watchdog(self) -> bool:
        """Another program takes the time-out away; whether there was one."""
        with self._lock:
            before, self.timeout = self.timeout, 0
            return before > 0

    def change_set_point(self, value: float) -> bool:
        """Another program sends one target [user units] in the process data; whether the drive takes it."""
        with self._lock:
            words = encode(Register("", "holding", 0, "int32", low_word_first=True), round(value))
            self._obey([*self._out[:5], *words, *self._out[7:]])
            return self.enabled

    def look_at_watchdog(self) -> None:
        """Stop where nothing was heard for the time-out."""
        with self._lock:
            if self._powered == float("inf"):
                return
            now = monotonic()
            if self.timeout and (self._expire or now - self._heard > self.timeout / 1e3):
                self._expire = False
                self._log.note("watchdog", self.device.name, silent=now - self._heard)
                self._fail(TIMED_OUT)


class CmmtDevice(NamedDevice):
    """A drive at its address."""

    def __init__(self, drive: EmulatedDrive, log: CommandLog, port: int) -> None:
        super().__init__(drive, NAMES, drive.hear, log, port)
        self.drive = drive
