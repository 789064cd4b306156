"""Festo CMMT-AS and CMMT-ST servo drives over Modbus TCP, telegram 111: a driven free end.

`telegram`: words of telegram 111, registers, parameters, the pieces of a sine, and options; `link`: the connection;
here: the device interface; `emulated`: the device for `pmabench emulate`.

One thread exchanges process data from `open` to `close`, as the drive expects it. It writes nothing before the first
command, so that `open` takes control from no other program. It only ever sends the newest command: a command of the
caller replaces that of the thread.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from math import inf
from time import monotonic, sleep
from typing import TYPE_CHECKING

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import Block, DeviceRecord, Identity, Segment
from pmabench_drivers.festo_cmmt import telegram as t
from pmabench_drivers.festo_cmmt.telegram import POSITION, SET_POINT, CmmtOptions, Path, read_options
from pmabench_drivers.modbus import CALL, Watched
from pmabench_drivers.modbus.registers import Register, WatchdogRegisters
from pmabench_drivers.shared.device import refuse_nonsense
from pmabench_drivers.shared.link import JOIN, Unanswered

if TYPE_CHECKING:
    from pmabench_drivers.festo_cmmt.link import DriveLink as DriveLink  # named in a string below

OPEN = 1.9
ANSWER = 0.1
"""Longest wait for one answer [s]."""
LOOK = 0.003
"""Pause between two looks whether the drive has done what was commanded [s]."""
LEAP = 2.0
"""A place that moves so many times as fast as the actuator can [1] is a zero that was lost."""
SLOWER = 0.9
"""A drive that brakes is so much slower in the second half of a call [1]."""


class FestoCmmt(Watched["DriveLink"]):
    """A CMMT that holds the free end: output and channel `position`, channel `set_point`, both in user units.

    A ramp is one positioning task with its velocity; a sine is streamed: a target and a velocity in each cycle.
    """

    emulator = "pmabench_drivers.festo_cmmt.emulated"
    read_options = staticmethod(read_options)
    _options: CmmtOptions
    _doing = "its cycle"

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._inputs = [channel.input for channel in device.channels]
        self._watchdog = WatchdogRegisters(t.TIMEOUT)
        self._turn = threading.Lock()
        """Held for a moment while what is commanded is replaced; never while the drive is waited for."""
        self._top_speed = max((output.rate / abs(output.scale.slope) for output in device.outputs), default=0.0) or inf
        """Speed of the actuator [user units/s]."""
        self._path = Path(clock.now, self._top_speed)
        self._forget()

    def _forget(self) -> None:
        self._command: t.Command | None = None
        """What is sent in each cycle; None before the first command."""
        self._every, self._slot, self._begun = 0, -1, 0.0
        self._release = False
        self._before: tuple[float, int] | None = None
        """When it was asked last [s, bench time], and where it was."""
        self._leapt = ""
        self._per_second = 1.0
        """Velocity units of the drive per position unit a second."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect, identify, and compare telegram and units with the bench file; takes no control."""
        from pmabench_drivers.festo_cmmt.link import DriveLink

        self.close()
        line = self._link = DriveLink(self._device.name, self._device.address)
        until = monotonic() + OPEN
        with self._closed_on_error():
            identity = line.identity(until)
            selected = self._opened().parameter(t.TELEGRAM, "uint16", until)
            if selected != t.TELEGRAM_111:
                message = f"has telegram {selected:g} selected, and this driver speaks 111: select it in the drive"
                raise self._error(message, "P0.3030101")
            self._compare_units(until)
            self._found = line.get(t.TIMEOUT, until)
            status = self._look(until)
        self._path.rest_at(status.position)
        self._cycle.start(self._options.rate)
        return identity

    def close(self) -> None:
        """Stop the cycle; a disarmed drive is switched off, any other is left to its own time-out."""
        self._cycle.stop(JOIN)
        line = self._link
        if line is not None and self._release and self._command is not None:
            with suppress(DeviceError):
                line.send(t.NOTHING, monotonic() + ANSWER / 2)
        self._link = None
        self._armed = 0.0
        self._forget()
        if line is not None:
            line.close()

    def _compare_units(self, until: float) -> None:
        """Compare the drive's decimal exponents of position and velocity, in metres, with the bench's scale."""
        position, velocity = (
            self._opened().parameter(number, "int8", until) for number in (t.POSITION_PREFIX, t.VELOCITY_PREFIX)
        )
        self._per_second = 10.0 ** (position - velocity)
        for scale in [o.scale for o in self._device.outputs] + [c.scale for c in self._device.channels]:
            if not abs(abs(scale.slope) / 10.0**position - 1) < 0.05:
                message = f"counts in 1e{position:.0f} m, and the bench file in {abs(scale.slope):.4g} m"
                raise self._error(message, "P1.7841")

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Sample in each cycle, or in each n-th if `rate` [Hz] is lower; returns the rate used."""
        self._refuse_rate(rate)
        self._opened()
        self._cycle.note(None)
        self._leapt = ""
        self._samples.take()
        every = max(1, round(self._options.rate / rate))
        self._begun, self._slot, self._every = self._clock.now(), -1, every
        return self._options.rate / every

    def collect(self) -> Block:
        """What was sampled since the last call; an error once cycles have failed for 0.25 s, or its place has leapt."""
        if self._leapt:
            raise self._error(self._leapt, POSITION)
        return super().collect()

    def stop(self) -> None:
        """Stop sampling; a motion continues."""
        self._every = 0

    def _tick(self) -> None:
        """One cycle: send the present command, then read the drive's state."""
        if self._hungry() or self._link is None:
            return  # the program has stopped feeding the watchdog: the cycle must not prevent the drive's time-out
        try:
            self._send_due()
            self._sample()
        except DeviceError as error:
            self._cycle.note(error)
        else:
            self._cycle.note(None)

    def _send_due(self) -> None:
        """Send the present command: the next piece of a sine, or the same as before."""
        with self._turn:
            if (command := self._command) is None:
                return
            if (piece := self._path.next(1.0 / self._options.rate)) is not None:
                command = self._command = self._moving(command, *piece)
        self._send(command)

    def _sample(self) -> None:
        asked, set_point = self._clock.now(), self._path.now()
        status = self._opened().look_once(monotonic() + ANSWER)
        answered = self._clock.now()
        with self._turn:
            self._path.seen(status.position, (asked + answered) / 2)
        if self._every:
            slot = math.floor((asked - self._begun) * self._options.rate / self._every)
            if self._every == 1 or slot > self._slot:  # a missed cycle delays a sample, and loses none
                self._slot = slot
                known = {POSITION: float(status.position), SET_POINT: float(round(set_point))}
                self._keep([known[name] for name in self._inputs], asked, answered)
        command, before = self._command, self._before
        on = command is not None and command.on
        self._before = (asked, status.position) if on else None
        if on and not status.has(t.ENABLED):
            raise self._error(self._off(status))
        took, moved = (answered - before[0], status.position - before[1]) if before is not None else (0.0, 0)
        if abs(moved) > LEAP * self._top_speed * took:
            within = f"within {1e3 * took:.0f} ms"
            self._leapt = f"its place leapt by {moved} counts {within}, faster than it can move: was its zero set anew?"

    def _off(self, status: t.Status) -> str:
        """Why the drive is not under power."""
        cause = "is its supply on, and its safe torque off released?"
        return status.refusal() or f"is not under power (status word 0x{status.word:04x}): {cause}"

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Move to a position [user units] at the bench's `speed`."""
        slope = self._scale(output)
        self._task(self._whole(value, output), self._options.speed / abs(slope), output)

    def read_back(self, output: str) -> float:
        """Target that the drive itself holds [user units]."""
        self._scale(output)
        return self._held(monotonic() + CALL)

    def follow(self, output: str, segment: Segment) -> None:
        """Follow a ramp as one task of the drive, or a sine streamed by cycle; at once if its start has passed."""
        self._scale(output)
        refuse_nonsense(self._device.name, output, segment)
        for value in (segment.origin - segment.amplitude, segment.origin + segment.amplitude, segment.target):
            self._whole(value, output)
        if segment.kind == "ramp" and segment.start <= self._clock.now():
            self._task(self._whole(segment.target, output), segment.rate, output)
            return
        self._switch_on(monotonic() + CALL)
        with self._turn:
            self._path.follow(segment)

    def halt(self, output: str) -> None:
        """Give up the motion: the drive brakes as hard as it may and holds the place; returns once it has stopped.

        One that neither stops nor gets slower does not obey: it is switched off.
        """
        self._scale(output)
        until = monotonic() + CALL
        with self._turn:
            self._path.end()
            before = self._command
        on = before.on if before is not None else self._look(until).has(t.ENABLED)
        with suppress(Unanswered):  # the cycle repeats the command; the drive's status decides
            self._replace(t.Command(on=on, stop=True), until)
        way: list[tuple[float, int]] = []
        while not (status := self._look(until)).has(t.STOPPED):
            way.append((monotonic(), status.position))
            if monotonic() > until - LOOK:
                moves = f"was commanded to stop and still moves (status word 0x{status.word:04x})"
                if _gets_slower(way):
                    raise self._error(moves, output)
                self._replace(t.Command(stop=True), monotonic() + ANSWER / 2)
                raise NotSent(self._device.name, f"{moves}: it is switched off", output)
            sleep(LOOK)
        with self._turn:
            self._path.rest_at(status.position)

    def _task(self, target: int, velocity: float, output: str) -> None:
        """Send the drive to `target` at `velocity` [user units, 1/s], and check that it accepts the task."""
        until, lost = monotonic() + CALL, False
        self._switch_on(until)
        with self._turn:
            before = self._command or t.Command()
            self._path.go(target, velocity)
            command = self._command = self._moving(before, target, velocity)
        try:
            self._send(command, until)
        except Unanswered:  # the cycle repeats the command; the target that the drive holds decides
            lost = True
        while True:
            status = self._look(until)
            reason = status.refusal() or ("" if status.has(t.ENABLED) else self._off(status))
            if reason:
                raise self._error(reason, output)
            if (before.task or status.has(t.TAKEN)) and not (lost and self._held(until) != target):
                return
            if monotonic() > until - LOOK:
                what = "did not answer to" if lost else "did not take"
                raise self._error(f"{what} the motion to {target} (status word 0x{status.word:04x})", output)
            sleep(LOOK)

    def _held(self, until: float) -> float:
        return self._opened().parameter(t.TARGET, "int32", until)

    def _moving(self, before: t.Command, target: float, velocity: float) -> t.Command:
        units, override = t.speed(max(velocity * self._per_second, 1e-6))
        return replace(before, task=True, stop=False, target=round(target), velocity=units, override=override)

    # -- states of the drive --------------------------------------------------------------------------------------

    def _switch_on(self, until: float, *, wait: bool = True) -> None:
        """Bring the drive under power where it is; raises the reason if it refuses.

        Without `wait` it is no error if the drive only needs more time.
        """
        status = self._look(until)
        command = self._command
        if not (command is not None and command.on):
            acknowledge = status.has(t.FAULT) and self._options.acknowledge_faults
            reason = "" if acknowledge else status.refusal()
            if reason and status.has(t.FAULT):
                reason += "; acknowledge it there, or let that be done with acknowledge_faults: true"
            if reason:
                raise self._error(reason)
            standing = t.Command(target=status.position)
            if acknowledge:
                self._replace(replace(standing, acknowledge=True), until)
                self._until(lambda status: not status.has(t.FAULT), until, "keeps its fault after it was acknowledged")
            self._replace(standing, until)
            ready = self._until(lambda status: status.has(t.READY), until, "is not ready to be switched on")
            if ready.refusal():
                raise self._error(ready.refusal())
            self._path.rest_at(ready.position)
            self._replace(replace(standing, on=True), until)
        with suppress(*(() if wait else (DeviceError,))):
            self._until(lambda status: status.has(t.ENABLED), until, "is not under power yet")

    def _until(self, true: Callable[[t.Status], bool], until: float, what: str) -> t.Status:
        while not true(status := self._look(until)):
            if monotonic() > until - LOOK:
                why = status.refusal() or f"status word 0x{status.word:04x}; are supply and safe torque off in order?"
                raise self._error(f"{what}: {why}")
            sleep(LOOK)
        return status

    def _replace(self, command: t.Command, until: float) -> None:
        """Replace the command of the cycle, and send it."""
        with self._turn:
            self._command = command
        self._send(command, until)

    def _send(self, command: t.Command, until: float = 0.0) -> None:
        """Write the process data, unless a newer command exists by the time the line is free."""
        self._opened().send(command.words(), until or monotonic() + ANSWER, lambda: self._command is command)

    def _look(self, until: float) -> t.Status:
        return self._opened().look(until)

    # -- the drive's watchdog -------------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set the drive's time-out, read it back, and begin to switch it on; returns the time it holds [s]."""
        until = monotonic() + CALL
        held_time = super().arm_watchdog(seconds)
        self._release = False
        self._switch_on(until, wait=False)
        return held_time

    def disarm_watchdog(self) -> None:
        """Restore the time-out that the drive had when it was opened; `close` then switches it off."""
        self._release = True
        super().disarm_watchdog()

    def held(self) -> dict[str, float | str]:
        """Its time-out [s], telegram, unit and serial number (if it has one), and what prevents a motion."""
        until, line = monotonic() + CALL, self._opened()
        status = line.look(until)
        return {
            "watchdog": line.get(t.TIMEOUT, until) * 1e-3,
            "telegram": line.parameter(t.TELEGRAM, "uint16", until),
            "unit of the position": f"1e{line.parameter(t.POSITION_PREFIX, 'int8', until):g} m",
            "unit of the velocity": f"1e{line.parameter(t.VELOCITY_PREFIX, 'int8', until):g} m/s",
            "serial number": line.text(t.SERIAL, until),
            "fault": float(status.fault),
            "control": "by the network" if status.has(t.CONTROL) else "elsewhere",
            "homed": "yes" if status.has(t.HOMED) else "no",
        }

    # -- small things ---------------------------------------------------------------------------------------------

    def _scale(self, output: str) -> float:
        return self._output(output).scale.slope

    def _whole(self, value: float, output: str) -> int:
        if not math.isfinite(value) or abs(value) >= 2**31:
            raise self._error(f"{value} is no position", output)
        return round(value)

    def _get(self, register: Register, deadline: float) -> float:
        return self._opened().get(register, deadline)

    def _put(self, register: Register, value: float, deadline: float, *, checked: bool = True) -> None:
        self._opened().put(register, value, deadline, checked=checked)


def _gets_slower(way: Sequence[tuple[float, float]]) -> bool:
    """Whether places [s, any unit] come closer to each other: the second half of the time is slower than the first."""
    if len(way) < 3:
        return False
    paces = [abs(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise((way[0], way[len(way) // 2], way[-1]))]
    return paces[1] < SLOWER * paces[0]
