"""Runs the laws of searches and closed loops; no law can leave the output ranges of its step.

A sampled law controls one output, a script ramps and waits through its `Moves`, and a law of several quantities sends
aims and pulses to the guard while a watch checks every sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from pmabench.base.errors import LimitRefused
from pmabench.bench.interface import CompiledBench
from pmabench.engine.acquire import Acquisition, Samples
from pmabench.engine.commanded import Commander
from pmabench.engine.laws import LawOfSeveral, Orders, law_of
from pmabench.protocol.plan import Control, Seek

if TYPE_CHECKING:
    from pmabench.engine.platform_watch import PlatformWatch

AT_ONCE = 100
"""Samples per block for a law that rarely changes its command [1]."""


class SampledLaw(Protocol):
    """A law that is called at every sample; a true `rarely` marks one that keeps its command for many samples."""

    done: bool

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [SI] for the measured values [SI] at bench time `t` [s]."""
        ...

    def result(self) -> dict[str, Any]:
        """What was found, as plain data."""
        ...


def run_seek(step: Seek, guard: Commander, acquisition: Acquisition, log: Callable[..., None]) -> dict[str, Any]:
    """Run the step's law to its end; its result has `found` True or False and, when False, `reason`."""
    made = law_of(step.law)
    if not isinstance(made, type):
        found: dict[str, Any] = made(Moves(step, guard, acquisition, log), **step.parameters)
        return found
    law: SampledLaw = made(**step.parameters)
    run = _rarely if getattr(law, "rarely", False) and acquisition.goes_back else _always
    in_time = run(step, law, guard, acquisition, acquisition.clock.now() + step.limit)
    return {"found": in_time, **({} if in_time else {"reason": _late(step)}), **law.result()}


def _always(step: Seek, law: SampledLaw, guard: Commander, acquisition: Acquisition, deadline: float) -> bool:
    """Run the law sample by sample; unchanged commands are not sent again. Whether it ended before the deadline."""
    sent: float | None = None
    t, values = acquisition.sample()
    while not law.done:
        command = min(max(law.update(t, values), step.low), step.high)
        if command == sent:
            guard.wait()
        else:
            guard.set(step.output, command)
            sent = command
        if acquisition.clock.now() >= deadline:
            return False
        t, values = acquisition.sample()
    return True


def _rarely(step: Seek, law: SampledLaw, guard: Commander, acquisition: Acquisition, deadline: float) -> bool:
    """As `_always`, but block by block: needs a clock that can go back to the sample where the command changes."""
    sent: float | None = None
    command = step.low

    def changes(samples: Samples) -> int | None:
        """Index of the first sample after which the command changes or the law is done; None if there is none."""
        nonlocal command
        columns = {name: column.tolist() for name, column in samples.values.items()}
        for i, t in enumerate(samples.t.tolist()):
            wanted = law.update(t, {name: column[i] for name, column in columns.items()})
            command = min(max(wanted, step.low), step.high)
            if command != sent or law.done:
                return i
        return None

    while not law.done:
        if acquisition.until(min(acquisition.clock.now() + AT_ONCE / acquisition.rate, deadline), changes) is None:
            guard.wait()
        else:
            guard.set(step.output, command)
            sent = command
        if acquisition.clock.now() >= deadline:
            return False
    acquisition.sample()
    return True


def _late(step: Seek | Control) -> str:
    return f"not done within {step.limit:g} s"


class Moves:
    """Actions of a scripted law: command its output inside the step's range, switch valves, and wait."""

    def __init__(self, step: Seek, guard: Commander, acquisition: Acquisition, log: Callable[..., None]) -> None:
        self.step = step
        self.acquisition = acquisition
        self.clock = acquisition.clock
        self.deadline = self.clock.now() + step.limit
        self._guard = guard
        self._log = log
        self.commanded: float | None = None

    def inside(self, value: float) -> float:
        """The nearest value in the step's range."""
        return min(max(value, self.step.low), self.step.high)

    def set(self, value: float) -> None:
        """Command a value at once."""
        value = self.inside(value)
        self._guard.wait()  # first: the record states the time of the command
        before = self.commanded
        self._log("set", value, value if before is None else before)
        self._guard.set(self.step.output, value)
        self.commanded = value

    def ramp(self, origin: float, target: float, rate: float) -> float:
        """Start a ramp; returns the bench time [s] of its end."""
        origin, target = self.inside(origin), self.inside(target)
        self._guard.wait()
        self._log("ramp", target, origin, rate=rate)
        self._guard.ramp(self.step.output, origin, target, rate)
        self.commanded = target
        return self.clock.now() + abs(target - origin) / rate

    def valve(self, name: str, *, safe: bool) -> float:
        """Switch a valve to its safe state, or to its state in a run; returns the bench time [s]."""
        self._guard.valve(name, safe=safe)
        self.acquisition.switched(name, safe=safe)
        return self.clock.now()

    def wait(self, until: float) -> None:
        """Let time pass until `until` [s], but not beyond the step's limit."""
        self.acquisition.until(min(until, self.deadline))


def _watch_of(bench: CompiledBench) -> PlatformWatch | None:
    """The watch on all muscles of a bench together; None where the bench needs none.

    Raises LimitRefused for an unknown name. Only valves controlled by pulses need such a watch: with set-points the
    regulators' channels have limits of their own.
    """
    if not bench.together:
        return None
    if bench.together != "platform":
        raise LimitRefused(f'a loop over several muscles needs a watch on them, and "{bench.together}" is none')
    from pmabench.engine.platform_watch import PlatformWatch

    return PlatformWatch(bench.platform)


LOGGED_EVERY = 1.0
"""Interval of the events that log aims and pulses [s]: an event for each pulse would be sixty lines a second."""


class _Steered:
    """Collects aims and pulses, and logs them at intervals."""

    def __init__(self, log: Callable[..., None], begun: float) -> None:
        self._log, self._next = log, begun + LOGGED_EVERY
        self._aims: list[list[float]] = []
        self._names: list[str] = []
        self._pulses: list[list[Any]] = []

    def note(self, t: float, orders: Orders) -> None:
        """Note what was sent at `t` [s], and log when the interval has passed."""
        self._names = list(orders.aims)
        self._aims.append([round(t, 6), *(float(f"{value:.6g}") for value in orders.aims.values())])
        self._pulses += [[round(t, 6), pulse.valve, round(pulse.seconds, 6)] for pulse in orders.pulses]
        if t >= self._next:
            self.flush()
            self._next = t + LOGGED_EVERY

    def flush(self) -> None:
        """Log what was not logged yet."""
        if self._aims:
            self._log(columns=["t", *self._names], aims=self._aims, pulses=self._pulses)
        self._aims, self._pulses = [], []


def run_control(
    step: Control, bench: CompiledBench, guard: Commander, acquisition: Acquisition, log: Callable[..., None]
) -> dict[str, Any]:
    """Run the step's law to its end; its result has `found` True or False and, when False, `reason`.

    `log` receives aims and pulses about once a second, also when a fault ends the loop. Raises LimitTripped where the
    bench's watch finds a fault, LimitRefused for a command outside its range.
    """
    law: LawOfSeveral = law_of(step.law)(**step.parameters)
    watch, clock = _watch_of(bench), acquisition.clock
    deadline, period = clock.now() + step.limit, float(getattr(law, "called_every", 0.0))
    steered = _Steered(log, clock.now())
    try:
        while not law.done:
            if period:
                acquisition.pass_time(period)
            t, values = (clock.now(), acquisition.latest) if period else acquisition.sample()
            orders = law.update(t, values)
            wrong = "" if watch is None else watch.look(t, values, orders)
            if wrong:
                acquisition.trip(wrong)
            _refuse_outside(step, orders)
            _carry_out(orders, guard)
            if orders.aims:
                steered.note(t, orders)
            if clock.now() >= deadline and not law.done:
                return {"found": False, "reason": _late(step), **law.result()}
    finally:
        steered.flush()
    return {"found": True, **law.result()}


def _carry_out(orders: Orders, guard: Commander) -> None:
    if orders.aims:
        guard.steer(orders.aims, {pulse.valve: pulse.seconds for pulse in orders.pulses})
    for name, value in orders.sets.items():
        guard.set(name, value)
    if not orders.aims and not orders.sets:
        guard.wait()


def _refuse_outside(step: Control, orders: Orders) -> None:
    for name, value in {**orders.aims, **orders.sets}.items():
        low, high = step.aims.get(name, (1.0, 0.0))
        slack = 1e-9 * max(abs(low), abs(high))
        if not low - slack <= value <= high + slack:
            raise LimitRefused(f'the law "{step.law}" wants {value:g} for {name}, outside the range of its step')
