"""Shared by guided runs: a plan without steps, requests for loads, reading a bench that is not armed, samples.

`looking` opens and samples the devices, commands nothing, and always closes them. `listen` returns series over a
period of bench time, with mean, noise and drift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import CompiledBench, Identity
from pmabench.bench.session import Stack
from pmabench.engine.acquire import Acquisition, Array, Samples, Stop
from pmabench.engine.executor import Executor
from pmabench.engine.operator import Operator
from pmabench.engine.recorder import NoRecord
from pmabench.engine.run import Outcome, run_plan
from pmabench.engine.source import OwnDevices
from pmabench.guard.guard import Guard
from pmabench.guard.remote import RemoteGuard
from pmabench.protocol.common import FORCE_MASS
from pmabench.protocol.plan import Ask, Plan

RATE = 200.0
"""Sampling rate of a guided run [Hz]."""


def guided_run(
    mounted: Mounted,
    operator: Operator,
    kind: str,
    name: str,
    procedure: Callable[[Executor], None],
    settings: Mapping[str, Any] | None = None,
    **more: Any,
) -> Outcome:
    """Run `procedure` with a plan without steps; every channel is recorded. `more` is passed to `run_plan`."""
    channels = tuple(channel.name for channel in mounted.bench.channels)
    plan = Plan(kind, name, "", mounted.bench.free_end, RATE, channels, (), (), settings or {})
    return run_plan(plan, mounted, operator, procedure=procedure, **more)


def load_text(mounted: Mounted, mass: float) -> str:
    """The request to the operator for a load of `mass` [kg]."""
    weights = mounted.bench_file.weights
    if mass == 0 or weights is None:
        return "Take every weight off the free end; nothing may pull at the load cell."
    stack = Stack(weights.hanger, weights.plates)
    made_of = stack.text(mass) if stack.can_make(mass) else ""
    return f"Put {made_of or f'{mass:g} kg'} on the free end, on its support: {mass * weights.g:.2f} N."


def moving_mass(mounted: Mounted, mass: float) -> float:
    """Moving mass with a load of `mass`: load, carriage and muscle [kg]."""
    bench = mounted.bench
    return mass + bench.carriage if bench.hanging and mass + bench.carriage > 0 else FORCE_MASS


def put_on(executor: Executor, mounted: Mounted, phase: str, mass: float, also: str = "") -> None:
    """Ask the operator to put a load of `mass` [kg] on, vented, and to do what `also` says."""
    load = (mass * mounted.bench.gravity, moving_mass(mounted, mass))
    executor.do(Ask(phase, f"{load_text(mounted, mass)} {also}".strip(), "vented", load))


LOOKED_AT = 100.0
"""Sampling rate of `looking` [Hz]."""


@dataclass(frozen=True)
class Look:
    """An open bench: identities of its devices, and its samples."""

    identities: Mapping[str, Identity]
    acquisition: Acquisition


@contextmanager
def looking(bench: CompiledBench, rate: float = LOOKED_AT) -> Iterator[Look]:
    """Open the bench and sample it at `rate` [Hz]. Limits are not watched: nothing is armed that could be vented.

    Raises DeviceError if a device does not answer or the bench is in use, LimitRefused if it is tripped.
    """
    clock: RealClock | VirtualClock = RealClock() if bench.realtime else VirtualClock()
    with ExitStack() as stack:
        guard = RemoteGuard(bench, clock) if isinstance(clock, RealClock) else Guard(bench, clock)
        stack.callback(guard.close)
        guard.open()
        own = OwnDevices(bench, clock)
        stack.callback(own.close)
        own.open()
        names = tuple(channel.name for channel in bench.channels)
        acquisition = Acquisition(bench, {**guard.devices, **own.streams}, clock, rate, names, NoRecord())
        acquisition.begin_safe_state()
        stack.callback(acquisition.stop)
        acquisition.start()
        yield Look({**guard.identities, **own.identities}, acquisition)


OTHER_CLOCK = 0.5
"""A stream whose samples differ from the present time by more than this [s] has another clock."""


@dataclass(frozen=True)
class Series:
    """A channel over time: `t` [s, bench time] and `y` [SI], both of shape (n,)."""

    t: Array
    y: Array

    def mean(self, last: float | None = None) -> float:
        """Mean of all, or of the last `last` seconds."""
        y = self.y if last is None else self.y[self.t > self.t[-1] - last]
        return float(y.mean())

    def reading(self) -> Reading:
        """Mean, noise and drift."""
        t, y = self.t - self.t.mean(), self.y
        mean = float(y.mean())
        spread = float(t @ t)
        slope = float(t @ (y - mean)) / spread if spread > 0 else 0.0
        return Reading(mean, float(np.std(y - mean - slope * t)), slope * float(self.t[-1] - self.t[0]), len(y))


@dataclass(frozen=True)
class Reading:
    """Statistics of a channel at rest [SI]."""

    mean: float
    noise: float
    """Rms deviation from a straight line."""
    drift: float
    """Change of that line over the duration."""
    count: int


def listen(acquisition: Acquisition, seconds: float, until: Stop = lambda _block: None) -> Mapping[str, Series]:
    """Samples of every channel over the next `seconds` [s]; channels without samples are left out."""
    kept: dict[str, list[tuple[Array, Array]]] = {}

    def keep(block: Samples) -> int | None:
        late = acquisition.clock.now() - float(block.t[-1])
        t = block.t + (late if abs(late) > OTHER_CLOCK + 1.5 / acquisition.rate else 0.0)
        for name, values in block.values.items():
            kept.setdefault(name, []).append((t, values))
        return until(block)

    acquisition.pass_time(seconds, keep)
    return {
        name: Series(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))
        for name, parts in kept.items()
    }


def steady(acquisition: Acquisition, name: str, most: float, *, seconds: float = 1.0, within: float = 30.0) -> Reading:
    """Reading over the first `seconds` [s] in which the channel drifts by at most `most` [SI], or within its noise.

    Raises VerdictFailed if it has not come to rest within `within` [s].
    """
    deadline = acquisition.clock.now() + within
    while True:
        series = listen(acquisition, seconds).get(name)
        if series is None:
            raise VerdictFailed(f"{name} gives no samples")
        reading = series.reading()
        if not np.isfinite(reading.mean):
            raise VerdictFailed(f"{name} gives no numbers; look at its plug")
        if abs(reading.drift) <= max(most, 4 * reading.noise / np.sqrt(reading.count)):
            return reading
        if acquisition.clock.now() > deadline:
            quantity = CHANNEL_QUANTITY[name]
            raise VerdictFailed(
                f"{name} does not come to rest: it still drifts by {show(reading.drift, quantity, 3)} in {seconds:g} s "
                f"after {within:g} s, at most {show(most, quantity, 3)} is allowed"
            )
