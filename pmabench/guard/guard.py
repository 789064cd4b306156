"""The guard: owns the devices that can move anything, checks each command on the value the device will get, vents.

Small enough to be read in one sitting. It does not trust the engine: values outside the active limits, NaN and
infinity are refused here again, whatever was checked before. Knows devices through `pmabench.bench.interface` only.
In virtual time it lives in the engine's process, at a real bench in the guard process (`pmabench.guard.process`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import partial
from itertools import takewhile
from math import inf, isfinite
from typing import Any

from pmabench.base.clock import Clock, DeviceClock
from pmabench.base.errors import DeviceError, LimitRefused, LimitTripped, NotSent
from pmabench.bench.interface import (
    Block,
    CompiledBench,
    DeviceRecord,
    Load,
    OutputRecord,
    SafeAction,
    Segment,
    Stream,
    ValveRecord,
)
from pmabench.guard import course
from pmabench.guard.limits import (
    refuse_aims,
    refuse_jump,
    refuse_outside,
    refuse_pulse,
    refuse_together,
    refuse_unsafe_bench,
    to_device,
)
from pmabench.guard.links import Act, Links
from pmabench.guard.owner import Call
from pmabench.guard.safe import AT_ONCE, EMPTIER, LINGERS, UNANSWERED, SafeState, Vent
from pmabench.guard.supervision import FED, SAFE, Kind, Supervision

__all__ = ["Guard", "Measure", "State", "Vent"]

FRESH = 0.5
"""Age [s], above the smallest delay seen from this device, at which a sample is too old to confirm anything."""
SILENT = 0.3
"""Sampling of a device without samples for this time [s] is restarted: another venting process may have stopped it."""
MOTIONS = ("length", "angle")
"""Quantities of outputs that move something."""
AT_REST = 5e-3
"""A motion is at rest when it stays within this fraction of its command range [1]; slower motions are not noticed."""
Measure = Callable[[], Mapping[str, float]]
"""Lets a little bench time pass; returns the latest measured values [SI]."""


class State(Enum):
    """What the guard allows now."""

    DISARMED = "disarmed"
    SETUP = "set up"
    """Armed, but its pressure path has not been proven yet: low pressure only."""
    RUNNING = "running"
    STOPPING = "stopping"
    SAFE = "safe"
    TRIPPED = "tripped"


class Guard:
    """Commands the outputs of one compiled bench.

    `threads`: each device is called from its own thread, and the devices that only measure are left to the engine.
    `forgiving`: a device that cannot be opened is left out; each one that opens is vented at once; devices that only
    measure are opened too if the safe state confirms one of their channels.
    """

    def __init__(self, bench: CompiledBench, clock: Clock, *, threads: bool = False, forgiving: bool = False) -> None:
        self.bench, self.clock = bench, clock
        self.state = State.DISARMED
        self.latest: dict[str, float] = {}
        """Newest measured values [SI] of the devices that the guard itself reads."""
        self.links = Links(bench, clock, threads=threads)
        self.devices, self.identities = self.links.devices, self.links.identities
        self._threads, self._forgiving = threads, forgiving
        self._outputs = {output.name: output for output in bench.outputs}
        self._valves = {valve.name: valve for valve in bench.valves}
        ends = [(c.name, c.low) for device in bench.devices for c in device.channels]
        ends += [(trip.channel, trip.low) for trip in bench.trips if trip.kind == "range" and trip.low is not None]
        self._floors = {name: end for name, end in sorted(ends) if end < 0}
        """Lower end of a channel's range or low trip limit, if negative [SI]; a reading below it confirms nothing."""
        self._safe: SafeState | None = None
        self._tripped = False
        self.run = self.why = ""
        """`run`: name of the run folder for which the bench is armed; `why`: what caused the safe state."""
        self._courses: dict[str, course.Course] = {}
        """Last commanded course of each output [SI over bench time in s]."""
        self._closed: dict[str, bool] = {}
        """Last commanded position of each valve: True if closed."""
        self.unanswered = -inf
        """Bench time of the last command whose outcome is not known [s]."""
        self._measured: dict[str, float] = {}
        """Newest measured values when the safe state began [SI]."""
        self._given_up: set[str] = set()
        self._heard: dict[str, float] = {}
        """When each device last gave samples, or its sampling was started [s]."""
        self._starting: dict[str, Call] = {}
        self._clocks: dict[str, DeviceClock] = {}
        self._shuts: dict[str, float] = {}
        """When the last pulse of each valve ends [s]."""
        self.supervision = Supervision(bench, self.links, clock, self._course, self._closed)

    def open(self) -> None:
        """Open every device; nothing is commanded. On failure those already open are closed."""
        records = [
            record for record in self.bench.devices if record.guarded or not self._threads or self._confirms(record)
        ]
        self.links.open(records, self._first_of, forgiving=self._forgiving)

    def _confirms(self, record: DeviceRecord) -> bool:
        """Whether to open a device that only measures: when venting without an engine, the guard needs its values."""
        wanted = {action.target for action in self.bench.safe_state}  # pressures, and motions that must end
        return self._forgiving and any(channel.name in wanted for channel in record.channels)

    def _first_of(self, name: str) -> list[Act]:
        """Commands that start the safe state, for a device that was just opened; empty unless the guard only vents."""
        begins = list(takewhile(lambda action: action.do in AT_ONCE, self.bench.safe_state if self._forgiving else ()))
        begins = begins if self._safe is None else self._safe.commands
        targets = [(action, self._target(action)) for action in begins]
        return [self._action(action, target) for action, target in targets if target and target.device == name]

    def close(self) -> None:
        """Close all devices; disarm their watchdogs only if the vent is confirmed. May be called again."""
        vent = self._safe.vent if self._safe is not None else None
        self.links.close(disarm=vent is not None and vent.confirmed and UNANSWERED not in self.faults())

    def faults(self) -> list[str]:
        """Faults during the safe state, apart from its result."""
        assert self._safe is not None  # noqa: S101
        return self._safe.faults

    # -- arming -------------------------------------------------------------------------------------------------

    def arm(self, run: str = "") -> None:
        """Arm the bench for `run`: watchdogs on, outputs at safe values, valves closed; then `SETUP` or `RUNNING`.

        Raises LimitRefused for a bench that cannot be made safe, and if an interlock is open.
        """
        if self.state is not State.DISARMED:
            raise LimitRefused(f"the bench is {self.state.value}: it cannot be armed")
        self.run = run
        refuse_unsafe_bench(self.bench)
        for output in self._outputs.values():
            self.links.writing(output, output.safe)  # raises where a device takes no set-points; nothing is sent yet
        self.links.arm_watchdogs()
        for record in self.bench.devices:
            act = partial(self.supervision.open_interlock, record)
            if record.interlocks and (wrong := self.links.call(record.name, act)):
                raise LimitRefused(wrong)
        for output in self._outputs.values():
            self._write(output, output.safe)
            self.links.refuse_other_read_back(output)
        for valve in self._valves.values():
            self._switch(valve, closed=valve.safe == "open" or valve.longest > 0)
        self.supervision.begin()
        self.state = State.SETUP if self.bench.proof is not None else State.RUNNING

    def release(self) -> None:
        """Allow commands up to the full limits, once the bench is proven."""
        if self.state is not State.SETUP:
            raise LimitRefused(f"the bench is {self.state.value}: it cannot be released")
        self.state = State.RUNNING

    # -- commands -----------------------------------------------------------------------------------------------

    def set(self, name: str, value: float) -> float:
        """Command `value` [SI]; returns the value [SI] that the device received, rounded towards the safe value."""
        return self._write(self._allowed(name, value), value)

    def ramp(self, name: str, origin: float, target: float, rate: float) -> None:
        """Let the device go from `origin` to `target` [SI] at `rate` [SI/s]."""
        output = self._allowed(name, origin, target)
        if not (isfinite(rate) and rate > 0) or (output.rate and rate > output.rate * (1 + 1e-9)):
            raise LimitRefused(f'"{name}" cannot be ramped at {rate} per second; at most {output.rate}')
        refuse_jump(output, self._now_at(output), origin)
        self._command(output.device, self._ramping(output, origin, target, rate))
        self._courses[name] = course.ramp(self.clock.now(), origin, target, rate)

    def sine(self, name: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Let the device follow mean + amplitude sin(2 pi f t) [SI, Hz] for whole cycles."""
        output = self._allowed(name, mean - abs(amplitude), mean + abs(amplitude))
        if not all(isfinite(number) for number in (frequency, cycles)) or frequency <= 0 or cycles <= 0:
            raise LimitRefused(f'"{name}": a sine needs a frequency and cycles above zero')
        fastest = 6.283185307179586 * frequency * abs(amplitude)
        if output.rate and fastest > output.rate:
            raise LimitRefused(f'"{name}": the sine moves at {fastest:.4g} per second; at most {output.rate:.4g}')
        refuse_jump(output, self._now_at(output), mean)
        segment = Segment(
            "sine",
            self.clock.now(),
            float(output.scale.to_raw(mean)),  # not rounded: that would shift a crest beyond its limit
            amplitude=amplitude / output.scale.slope,
            frequency=frequency,
            cycles=cycles,
        )
        self._command(output.device, self.links.following(output, segment))
        self._courses[name] = course.sine(segment.start, mean, amplitude, frequency, cycles)

    def place(self, load: Load) -> None:
        """Report to simulated devices, which contain an operator, what was attached by hand."""
        self.links.place(load)

    def valves(self, *, closed: bool, only: str = "") -> None:
        """Put all valves, or the valve `only`, into their position for a run (`closed`) or for the safe state.

        The latter opens dump valves for work by hand.
        """
        self._refuse_unless_active("valves")
        for valve in [valve for valve in self._valves.values() if only in {"", valve.name}]:
            in_run = valve.safe == "open" or valve.longest > 0
            self._switch(valve, closed=in_run if closed else valve.safe == "closed")

    def steer(self, aims: Mapping[str, float], pulses: Mapping[str, float]) -> None:
        """Open each valve of `pulses` now for that time [s], to bring muscles to `aims` [SI]: all of them, or none.

        Raises LimitRefused for an aim or a time outside its limits, and for a valve whose counterpart is open.
        """
        self._refuse_unless_active("valves")
        now = self.clock.now()
        refuse_aims(self.bench, aims, self.bench.setup_pressure if self.state is State.SETUP else inf)
        opens = [(refuse_pulse(self._valves, name, seconds), seconds) for name, seconds in pulses.items()]
        refuse_together(pulses, self._valves, {name for name, end in self._shuts.items() if end > now + 1e-9})
        for valve, seconds in opens:
            self._command(valve.device, self.links.pulsing(valve, seconds))
            self._shuts[valve.name] = max(self._shuts.get(valve.name, now), self.clock.now() + seconds)

    def value_sent(self, name: str, value: float) -> float:
        """Value [SI] that the device would receive for `value`, after scaling and rounding."""
        output = self._outputs[name]
        return float(output.scale.to_si(to_device(output, value)))

    def collect(self, name: str) -> Block:
        """New samples of one device; fresh ones update `latest`."""
        block = self.links.collect(name)
        if len(block.time):
            self._heard[name] = self.clock.now()
        if len(block.time) and self._age(name, int(block.time[-1])) <= FRESH:
            for record in self.bench.devices:
                for channel in record.channels if record.name == name else ():
                    self.latest[channel.name] = float(channel.scale.to_si(block.columns[channel.name][-1]))
        return block

    def _age(self, name: str, newest: int) -> float:
        """Age of a device's newest sample [s] above its smallest delay so far; 0 in virtual time."""
        now = self.clock.now()
        ahead = self._clocks.setdefault(name, DeviceClock()).ahead(newest, now)
        return now - newest * 1e-9 - ahead if self._threads else 0.0

    def _refuse_unless_active(self, name: str) -> None:
        if self.state not in {State.SETUP, State.RUNNING}:
            raise LimitRefused(f'"{name}" is not commanded: the bench is {self.state.value}')

    def _allowed(self, name: str, *values: float) -> OutputRecord:
        output = self._outputs.get(name)
        if output is None:
            raise LimitRefused(f'the bench has no output "{name}"')
        self._refuse_unless_active(name)
        unproven = self.state is State.SETUP and output.quantity == "pressure"
        refuse_outside(output, values, self.bench.setup_pressure if unproven else inf)
        return output

    def _command(self, device: str, act: Act) -> None:
        try:
            self.links.call(device, act)
        except DeviceError as error:
            if not isinstance(error, NotSent):
                self.unanswered = self.clock.now()  # it may be carried out yet
            raise

    def _write(self, output: OutputRecord, value: float) -> float:
        self._command(output.device, self.links.writing(output, value))
        sent = self.value_sent(output.name, value)
        self._courses[output.name] = course.step(sent)
        return sent

    def _switch(self, valve: ValveRecord, *, closed: bool) -> None:
        self._command(valve.device, self.links.switching(valve, closed=closed))
        self._closed[valve.name] = closed

    def _course(self, output: OutputRecord) -> course.Course:
        return self._courses.get(output.name, course.step(output.safe))

    def _now_at(self, output: OutputRecord) -> float:
        return self._course(output)(self.clock.now())

    def _ramping(self, output: OutputRecord, origin: float, target: float, rate: float) -> Act:
        ends = (to_device(output, origin), to_device(output, target))
        segment = Segment("ramp", self.clock.now(), *ends, rate / abs(output.scale.slope))
        return self.links.following(output, segment)

    # -- the safe state -----------------------------------------------------------------------------------------

    def begin_safe(self, *, tripped: bool = False, hurry: int = 0, why: str = "", doubted: Sequence[str] = ()) -> None:
        """Begin the declared safe state; once it is over, only send its commands again.

        `hurry` 1 skips ramps and holds, 2 also ends the wait for confirmations. The first `why` is kept. `doubted` are
        channels that read low and may not move: they confirm nothing until they have read high.
        """
        self.why = self.why or why
        self._tripped = self._tripped or tripped or self.state is State.TRIPPED
        if self._safe is None:
            sent_late = self.state in {State.SETUP, State.RUNNING} and self.clock.now() - self.unanswered < LINGERS
            self.state, self._measured = State.STOPPING, dict(self.latest)
            motions = {output.name: output for output in self._outputs.values() if output.quantity in MOTIONS}
            targets = {action.target for action in self.bench.safe_state}
            confirms = [channel for channel in self.bench.channels if channel.name in targets]
            longest = max((action.within for action in self.bench.safe_state if action.do == "confirm"), default=0.0)
            rests = tuple(
                SafeAction("rest", name, AT_REST * (motions[name].high - motions[name].low), longest)
                for name in (channel.name for channel in confirms)
                if name in motions
            )
            self._safe = SafeState(
                (*self.bench.safe_state, *rests), self._begin, self._rescue, self._look, self.clock.now(),
                self._floors, self._last_unanswered, motions.keys(), self._expected,
                partial(self.supervision.compare_readings, {channel.device for channel in confirms}),
                doubted,
            )  # fmt: skip
            self._safe.faults += [UNANSWERED] if sent_late else []
        elif self._safe.vent is not None:
            for action in self._safe.commands:
                self._begin(action)
        if hurry:
            self._safe.hurry(hurry)

    def _expected(self, name: str) -> tuple[float, float]:
        """Value that an output is commanded to now, inf if unknown, and the allowed deviation from it [SI]."""
        output = self._outputs.get(name)
        if output is None or name not in self._courses:
            return inf, 0.0
        pressure = output.quantity == "pressure"
        slack = max(EMPTIER, 0.1 * self._measured.get(name, 0.0)) if pressure else 0.05 * (output.high - output.low)
        return self._now_at(output), slack

    def _last_unanswered(self) -> float:
        """Bench time of the last command with unknown outcome [s], including a driver's steps of ramps and sines."""
        steps = [getattr(device, "unanswered", -inf) for device in list(self.devices.values())]
        self.unanswered = max([self.unanswered, *steps])
        return self.unanswered

    def step_safe(self, latest: Mapping[str, float]) -> Vent | None:
        """Advance the safe state with the latest measured values [SI]; returns its result when over, else None."""
        if self._safe is None:
            return None
        over = self._safe.step(self.clock.now(), latest)
        self._give_up()
        if not over:
            return None
        self.state = State.TRIPPED if self._tripped or self._safe.faults else State.SAFE
        return self._safe.vent

    def safe_state(self, measure: Measure, *, tripped: bool = False, why: str = "") -> Vent:
        """Run the safe state to its end. If `measure` fails, the vent is `commanded`, not `confirmed`."""
        self.begin_safe(tripped=tripped, why=why)
        latest: Mapping[str, float] = {}
        while (vent := self.step_safe(latest)) is None:
            before, latest = self.clock.now(), {}
            with suppress(Exception):  # the vent's outcome is recorded whatever goes wrong while measuring
                latest = measure()
            if self.clock.now() <= before:
                self.clock.wait_until(before + 0.1)
        return vent

    def feeds(self, record: DeviceRecord) -> bool:
        """Whether to feed the watchdog of a device (S13).

        Not if safe commands are unanswered or not held, or have no effect: then its watchdog is to run out.
        """
        if self._safe is None:
            return True
        return not (_ends(record) & self._safe.unsettled or self._without_effect(record))

    def _without_effect(self, record: DeviceRecord) -> bool:
        """Whether safe commands to a device show no effect: its outputs do not fall or come to rest.

        A device with valves only is blamed for any such channel, as channels are not assigned to valves.
        """
        assert self._safe is not None  # noqa: S101
        looked_at = {action.target for action in self.bench.safe_state if action.do == "confirm"}
        own = {output.name for output in record.outputs} & {*looked_at, *self._safe.unmoved}
        return bool(own & self._safe.unmoved or (record.valves and not own and looked_at & self._safe.unmoved))

    def _give_up(self) -> None:
        """Close the lines of devices on which the safe state has no effect, so that their watchdogs run out.

        Any request feeds the watchdog of some devices. A device that does not answer is opened again and commanded
        once it is open: either it receives nothing and its watchdog runs out, or it receives the safe value.
        """
        assert self._safe is not None  # noqa: S101
        for record in self.bench.devices:
            ends = _ends(record)
            if (
                record.watchdog
                and record.name in self.devices
                and record.name not in self._given_up
                and (ends & self._safe.refusing or self._without_effect(record))
            ):
                self._given_up.add(record.name)
                self.links.hang_up(record.name, 1.5 * record.watchdog + 0.2)
                self._safe.outcome.append(f"{record.name}: its line is closed, so that its watchdog takes over")
            elif ends & self._safe.away:
                self.links.hang_up(record.name, 0.0)
        self._safe.away.clear()
        self.links.open_again(self._first_of)

    def attend(self, moment: float, rate: float) -> None:
        """During the safe state, at bench time `moment` [s]: feed watchdogs, keep sampling, check interlocks."""
        waits = self._safe is not None and self._safe.waits
        stopped = {action.target for action in self._safe.commands if action.do == "stop"} if self._safe else set()
        for record in self.bench.devices:
            kinds: list[Kind] = [FED] if self.feeds(record) else []  # a watchdog must not cut a ramp or a hold short
            if waits and not _ends(record) & stopped:  # a drive that was stopped is not ready
                kinds.append(SAFE)
            try:
                self.supervision.attend(record, moment, kinds)
            except LimitTripped as error:  # whoever opened an interlock must not wait for a ramp
                self.begin_safe(tripped=True, hurry=True)
                self._safe.fault(str(error))  # type: ignore[union-attr]
                waits = False
        if self._safe is None or self._safe.vent is None:
            self.keep_measuring(rate)

    def keep_measuring(self, rate: float) -> None:
        """Keep the devices that confirm the vent sampling at `rate` [Hz]; restart those that give no samples."""
        now = self.clock.now()
        slow = {record.name: 3 / record.fastest for record in self.bench.devices if record.fastest}
        for name, device in list(self.devices.items()):
            call, silent = self._starting.get(name), now - self._heard.get(name, -inf)
            failed = call is not None and call.done.is_set() and call.error is not None
            if isinstance(device, Stream) and (failed or silent > max(SILENT, slow.get(name, 0.0))):
                self._heard[name], used = now, self.links.sampling.setdefault(name, rate)
                self._starting[name] = self.links.submit(name, partial(device.start, used))

    def _begin(self, action: SafeAction) -> Call:
        """Start an action; an error becomes part of the outcome of the safe state, which continues."""
        target = self._target(action)
        if target is None:
            return _failed(DeviceError(action.target, "is not open"))
        return self._submit(target.device, lambda: self._action(action, target))

    def _submit(self, device: str, act: Callable[[], Act]) -> Call:
        try:
            if device not in self.devices:
                raise getattr(self.links.opening.get(device), "error", None) or DeviceError(device, "is not open")
            return self.links.submit(device, act())
        except Exception as error:
            return _failed(error)

    def _target(self, action: SafeAction) -> OutputRecord | ValveRecord | None:
        return self._outputs.get(action.target) or self._valves.get(action.target)

    def _action(self, action: SafeAction, target: OutputRecord | ValveRecord) -> Act:
        """Call that carries out a safe action; for a ramp it returns the duration [s]."""
        if isinstance(target, ValveRecord):
            return self.links.switching(target, closed=action.do == "close")
        if action.do == "stop":
            return self.links.halting(target)
        if action.do == "ramp":
            return partial(self._ramp_down, target, action)
        self._courses[target.name] = course.step(action.value)
        return self.links.writing(target, action.value)

    def _ramp_down(self, output: OutputRecord, action: SafeAction) -> float:
        """Begin a safe ramp, in the thread of the device; returns its duration [s].

        A pressure starts at the lower of its commanded and measured value, and is set to its end at once if the device
        holds another set-point: the muscle may already be empty, and a ramp would fill it again.
        """
        known = output.name in self._courses
        origin = self._now_at(output) if known else float(output.scale.to_si(self.links.read_back(output)))
        if output.quantity == "pressure":
            origin = min(origin, self._measured.get(output.name, origin))
            if origin <= action.value or (known and self._differs(output)):
                self.links.writing(output, action.value)()
                self._courses[output.name] = course.step(action.value)
                return 0.0
        self._ramping(output, origin, action.value, action.rate)()
        self._courses[output.name] = course.ramp(self.clock.now(), origin, action.value, action.rate)
        return abs(action.value - origin) / action.rate

    def _differs(self, output: OutputRecord) -> bool:
        """Whether a device holds a set-point other than the commanded one, or does not answer."""
        try:
            return bool(self.supervision.output_differs(output)())
        except DeviceError:
            return True

    def _rescue(self, action: SafeAction) -> Call | None:
        """Send an action over the device's second connection; None for a stop, or without such a connection."""
        target = self._target(action)
        if target is None or action.do == "stop":
            return None
        if isinstance(target, OutputRecord):
            return self.links.rescue(target, to_device(target, action.value))
        return self.links.rescue(target, float((action.do == "close") == (target.energised == "closed")))

    def _look(self, action: SafeAction) -> Call | None:
        """Ask whether the device holds what a safe action commanded; None for a stop, whose position is not known."""
        target = self._target(action)
        if action.do == "stop":
            return None
        assert target is not None  # noqa: S101 - it was commanded
        if isinstance(target, OutputRecord):
            return self._submit(target.device, lambda: self.supervision.output_differs(target))
        closed = action.do == "close"
        return self._submit(target.device, lambda: self.supervision.valve_differs(target, closed=closed))

    def describe(self) -> dict[str, Any]:
        """Identities of the open devices, for the manifest."""
        return {name: vars(identity) for name, identity in self.identities.items()}


def _failed(error: Exception) -> Call:
    """A call that has already failed with `error`."""
    call = Call(lambda: None)
    call.error = error
    call.done.set()
    return call


def _ends(record: DeviceRecord) -> set[str]:
    """Names of the outputs and valves of a device."""
    return {output.name for output in record.outputs} | {valve.name for valve in record.valves}
