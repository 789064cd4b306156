"""The guard: opens the devices, checks each command on the value that the device will really get, owns the safe state.

Small enough to be read in one sitting. It does not trust the engine: values outside the active limits, NaN and
infinity are refused here again, whatever was checked before. Knows devices through `pmabench.bench.interface` only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from math import ceil, floor, isfinite
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, LimitRefused
from pmabench.base.quantities import show
from pmabench.bench.interface import (
    CompiledBench,
    Device,
    DeviceRecord,
    Follower,
    Hands,
    Identity,
    Load,
    OutputRecord,
    Segment,
    SetPoint,
)

Measure = Callable[[], Mapping[str, float]]
"""Lets a little bench time pass and returns the latest measured values [SI]."""


class State(Enum):
    """What the guard allows now."""

    DISARMED = "disarmed"
    ARMED = "armed"
    SAFE = "safe"
    TRIPPED = "tripped"


@dataclass(frozen=True)
class Vent:
    """What came of the safe state: `confirmed`, `commanded` (not confirmed) or `failed`, and each action's outcome."""

    result: str
    actions: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether a measured value says that the bench is safe."""
        return self.result == "confirmed"


def load_driver(record: DeviceRecord, clock: Clock) -> Device:
    """The driver of a device, made from `module:Class`; nothing is opened."""
    module, _, name = record.driver.partition(":")
    try:
        made = getattr(import_module(module), name)(record, clock)
    except (ImportError, AttributeError) as error:
        raise DeviceError(record.name, f"its driver {record.driver} cannot be loaded: {error}") from error
    if not isinstance(made, Device):
        raise DeviceError(record.name, f"{record.driver} does not implement the device interface")
    return made


class Guard:
    """Commands the outputs of one compiled bench."""

    def __init__(self, bench: CompiledBench, clock: Clock) -> None:
        self.bench = bench
        self.state = State.DISARMED
        self.devices: dict[str, Device] = {}
        self.identities: dict[str, Identity] = {}
        self._clock = clock
        self._outputs = {output.name: output for output in bench.outputs}
        self._vent: Vent | None = None
        self._stands: dict[str, float] = {}
        """Where each output was sent last [SI]."""

    def open(self) -> None:
        """Open every device; nothing is commanded. On failure those already open are closed."""
        try:
            for record in self.bench.devices:
                device = load_driver(record, self._clock)
                self.identities[record.name] = device.open()
                self.devices[record.name] = device
        except BaseException:
            self.close()
            raise

    def arm(self) -> None:
        """Refuse a bench that cannot be made safe, drive every output to its safe value, then allow commands."""
        for output in self._outputs.values():
            self._refuse_bad_limits(output)
            if not isinstance(self.devices.get(output.device), SetPoint):
                raise DeviceError(output.device, "takes no set-points", output.output)
        for action in self.bench.safe_state:
            target = self._outputs.get(action.target)
            if action.do == "set" and target is not None and not target.low <= action.value <= target.high:
                raise LimitRefused(f'the safe state sends "{action.target}" beyond its limits: it is not armed')
        if "pressure" in self._outputs and not any(trip.channel == "pressure" for trip in self.bench.trips):
            raise LimitRefused("the bench has no trip limit on pressure: it is not armed")
        for output in self._outputs.values():
            self._write(output, output.safe)
        self.state = State.ARMED

    @staticmethod
    def _refuse_bad_limits(output: OutputRecord) -> None:
        numbers = (output.low, output.high, output.safe, output.scale.slope, output.scale.offset)
        if not all(isfinite(number) for number in numbers) or output.low >= output.high or output.scale.slope == 0:
            raise LimitRefused(f'the limits of "{output.name}" make no sense: it is not armed')

    def set(self, name: str, value: float) -> float:
        """Command `value` [SI]; returns the value [SI] that the device got, rounded to the safe side."""
        return self._write(self._allowed(name, value), value)

    def ramp(self, name: str, origin: float, target: float, rate: float) -> None:
        """Let the device go from `origin` to `target` [SI] at `rate` [SI/s]."""
        output = self._allowed(name, origin, target)
        if not (isfinite(rate) and rate > 0) or (output.rate and rate > output.rate * (1 + 1e-9)):
            raise LimitRefused(f'"{name}" cannot be ramped at {rate} per second; at most {output.rate}')
        self._refuse_jump(output, origin)
        self._stands[name] = target
        scale = abs(output.scale.slope)
        self._follow(
            output,
            Segment("ramp", self._clock.now(), self._raw(output, origin), self._raw(output, target), rate / scale),
        )

    def sine(self, name: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Let the device follow mean + amplitude sin(2 pi f t) [SI, Hz] for whole cycles."""
        output = self._allowed(name, mean - abs(amplitude), mean + abs(amplitude))
        if not all(isfinite(number) for number in (frequency, cycles)) or frequency <= 0 or cycles <= 0:
            raise LimitRefused(f'"{name}": a sine needs a frequency and cycles above zero')
        fastest = 6.283185307179586 * frequency * abs(amplitude)
        if output.rate and fastest > output.rate:
            raise LimitRefused(f'"{name}": the sine moves at {fastest:.4g} per second; at most {output.rate:.4g}')
        self._refuse_jump(output, mean)
        self._stands[name] = mean
        segment = Segment(
            "sine",
            self._clock.now(),
            float(output.scale.to_raw(mean)),  # not rounded: that would shift a crest beyond its limit
            amplitude=amplitude / output.scale.slope,
            frequency=frequency,
            cycles=cycles,
        )
        self._follow(output, segment)

    def place(self, load: Load) -> None:
        """Tell the devices that have an operator inside what hands did."""
        for device in self.devices.values():
            if isinstance(device, Hands):
                device.place(load)

    def value_sent(self, name: str, value: float) -> float:
        """The value [SI] that the device would get for `value`, after scaling and rounding."""
        output = self._outputs[name]
        return float(output.scale.to_si(self._raw(output, value)))

    def _allowed(self, name: str, *values: float) -> OutputRecord:
        output = self._outputs.get(name)
        if output is None:
            raise LimitRefused(f'the bench has no output "{name}"')
        if self.state is not State.ARMED:
            raise LimitRefused(f'"{name}" is not commanded: the bench is {self.state.value}')
        for value in values:
            if not isfinite(value):
                raise LimitRefused(f'"{name}" is never commanded to {value}')
            slack = 1e-9 * max(abs(output.low), abs(output.high))
            step = abs(output.resolution * output.scale.slope)
            sent = output.scale.to_si(self._raw(output, value))
            asked_inside = output.low - slack <= value <= output.high + slack
            if not asked_inside or not output.low - step - slack <= sent <= output.high + slack:
                low, high = show(output.low, output.quantity), show(output.high, output.quantity)
                shown = show(value, output.quantity)
                raise LimitRefused(
                    f"{shown} for {name} is outside {low} ({output.low_from}) to {high} ({output.high_from})"
                )
        return output

    @staticmethod
    def _raw(output: OutputRecord, value: float) -> float:
        """Device units, rounded to the resolution towards the safe value, and at the safe value downwards [SI]."""
        raw = float(output.scale.to_raw(value))
        if output.resolution == 0:
            return raw
        steps = raw / output.resolution
        near = round(steps)
        if abs(steps - near) < 1e-6:
            return near * output.resolution
        lower_si = value >= output.safe
        upwards = lower_si == (output.scale.slope < 0)
        return (ceil(steps) if upwards else floor(steps)) * output.resolution

    def _refuse_jump(self, output: OutputRecord, origin: float) -> None:
        """An output with a highest rate starts a motion where it stands."""
        stands = self._stands.get(output.name, output.safe)
        room = 1e-3 * (output.high - output.low) + abs(output.resolution * output.scale.slope)
        if output.rate and abs(origin - stands) > room:
            where, shown = show(stands, output.quantity), show(origin, output.quantity)
            raise LimitRefused(f'"{output.name}" stands at {where} and cannot jump to {shown}')

    def _write(self, output: OutputRecord, value: float) -> float:
        raw = self._raw(output, value)
        device = self.devices[output.device]
        assert isinstance(device, SetPoint)  # noqa: S101  (checked at arming)
        device.write(output.output, raw)
        self._stands[output.name] = float(output.scale.to_si(raw))
        return self._stands[output.name]

    def _follow(self, output: OutputRecord, segment: Segment) -> None:
        device = self.devices[output.device]
        if not isinstance(device, Follower):
            raise DeviceError(output.device, "cannot follow a ramp or a sine by itself", output.output)
        device.follow(output.output, segment)

    # -- the safe state -----------------------------------------------------------------------------------------

    def safe_state(self, measure: Measure, *, tripped: bool = False) -> Vent:
        """Run the declared safe state once: every command at once and in order, then the confirmations.

        Nothing cancels it; one failed action does not stop the others; a second call only repeats the commands (they
        are absolute) and returns the first result. `measure` may fail: then the vent is `commanded`, not `confirmed`.
        """
        self.state = State.TRIPPED if tripped or self.state is State.TRIPPED else State.SAFE
        outcome: list[str] = []
        failed = self._command_safe(outcome)
        if self._vent is not None:
            return self._vent
        confirmed = 0
        wanted = [action for action in self.bench.safe_state if action.do == "confirm"]
        for action in wanted:
            try:
                confirmed += self._confirm(action.target, action.value, action.within, measure, outcome)
            except Exception as error:  # the vent's outcome is recorded whatever went wrong while confirming
                outcome.append(f"confirm {action.target}: not possible ({error})")
        result = "failed" if failed else "commanded"
        if wanted and confirmed == len(wanted):
            result = "confirmed"
        self._vent = Vent(result, tuple(outcome))
        return self._vent

    def _command_safe(self, outcome: list[str]) -> int:
        failed = 0
        for action in self.bench.safe_state:
            if action.do != "set" or action.target not in self._outputs:
                continue
            output = self._outputs[action.target]
            if output.device not in self.devices:
                continue
            try:
                self._write(output, action.value)
                outcome.append(f"set {action.target} to {show(action.value, output.quantity)}: sent")
            except Exception as error:  # a failed action never stops the next one
                failed += 1
                outcome.append(f"set {action.target}: failed ({error})")
        return failed

    def _confirm(self, channel: str, below: float, within: float, measure: Measure, outcome: list[str]) -> int:
        deadline = self._clock.now() + within
        value: float | None = None
        while True:
            value = measure().get(channel)
            if value is not None and value < below:
                outcome.append(f"confirm {channel}: {value:.6g} below {below:.6g}")
                return 1
            if self._clock.now() >= deadline:
                outcome.append(f"confirm {channel}: {value} not below {below:.6g} within {within:g} s")
                return 0

    def close(self) -> None:
        """Let go of every device; harmless when repeated."""
        for device in self.devices.values():
            try:
                device.close()
            except DeviceError:
                continue
        self.devices = {}

    def describe(self) -> dict[str, Any]:
        """Who answered, for the manifest."""
        return {name: vars(identity) for name, identity in self.identities.items()}
