"""Closed loops over several quantities: a law's aims and pulses go to the guard, and a watch looks at every sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, Protocol

from pmabench.base.clock import Clock
from pmabench.base.errors import LimitRefused
from pmabench.bench.interface import CompiledBench
from pmabench.engine.acquire import Acquisition
from pmabench.engine.commanded import Commander
from pmabench.engine.laws import law_of
from pmabench.engine.laws.orders import LawOfSeveral, Orders
from pmabench.protocol.plan import Control

WATCHES = {"platform": "platform_watch:PlatformWatch"}
"""Name of a watch in a compiled bench -> its module in this room, and its class."""


class WatchTogether(Protocol):
    """Looks at what several channels say about one thing."""

    def look(self, t: float, values: Mapping[str, float], orders: Orders) -> str:
        """A sentence about a fault that the sample `values` [SI] at `t` [s] shows, or an empty text."""
        ...


def watch_of(name: str, numbers: Mapping[str, float]) -> WatchTogether:
    """A new watch of this name; LimitRefused where there is none, for a bench that needs one is not safe without."""
    if name not in WATCHES:
        raise LimitRefused(f'a loop over several muscles needs a watch on them, and "{name}" is none')
    module, _, attribute = WATCHES[name].partition(":")
    made = getattr(import_module(f"pmabench.engine.{module}"), attribute)
    watch: WatchTogether = made(numbers)
    return watch


LOGGED_EVERY = 1.0
"""What was steered becomes an event so often [s]: an event for each pulse would be sixty lines a second."""


class _Steered:
    """Set-points and pulses since the last event."""

    def __init__(self, log: Callable[..., None], begun: float) -> None:
        self._log, self._next = log, begun + LOGGED_EVERY
        self._aims: list[list[float]] = []
        self._names: list[str] = []
        self._pulses: list[list[Any]] = []

    def note(self, t: float, orders: Orders) -> None:
        """Keep what was sent at `t` [s]; an event where it is time."""
        self._names = list(orders.aims)
        self._aims.append([round(t, 6), *(float(f"{value:.6g}") for value in orders.aims.values())])
        self._pulses += [[round(t, 6), pulse.valve, round(pulse.seconds, 6)] for pulse in orders.pulses]
        if t >= self._next:
            self.flush()
            self._next = t + LOGGED_EVERY

    def flush(self) -> None:
        """What is left becomes an event."""
        if self._aims:
            self._log(columns=["t", *self._names], aims=self._aims, pulses=self._pulses)
        self._aims, self._pulses = [], []


def run_control(
    step: Control, bench: CompiledBench, guard: Commander, acquisition: Acquisition, clock: Clock,
    log: Callable[..., None],
) -> dict[str, Any]:  # fmt: skip
    """Run the step's law to its end; its result has `found` True or False and, when False, `reason`.

    `log` gets what was steered, a second at a time, also where a fault ends it. Raises LimitTripped where the bench's
    watch finds a fault, LimitRefused for a command outside its range.
    """
    law: LawOfSeveral = law_of(step.law)(**step.parameters)
    # set-points go to regulators, whose channels have limits; only valves that are steered need a watch on all together
    watch = watch_of(bench.together, bench.platform) if bench.together else None
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
                return {"found": False, "reason": f"not done within {step.limit:g} s", **law.result()}
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
