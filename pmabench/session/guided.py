"""Work at a bench without a protocol: means of channels; outputs that are moved by hand, recorded as a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import LimitRefused, UsageError, VerdictFailed, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import CompiledBench, Identity, OutputRecord
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
from pmabench.protocol.plan import Ask, Plan, Ramp, Set

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


def above(limits: Mapping[str, float]) -> Stop:
    """Stop rule: the first sample at which one of these channels is above its limit [SI]."""

    def reached(block: Samples) -> int | None:
        high = (block.values[name] > limit for name, limit in limits.items() if name in block.values)
        return min((int(one.argmax()) for one in high if one.any()), default=None)

    return reached


PHASE = "jog"
BLOCK = 0.1
"""Interval for reading keys [s]."""
TRAVEL = 0.05
"""Speed of the actuator, as a fraction of its highest."""
STEPS = {"pressure": (1e3, 2e3, 5e3, 10e3, 20e3, 50e3), "displacement": (0.1e-3, 0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3)}
"""Available steps [SI]."""
MOVES = {"+": ("pressure", 1), "-": ("pressure", -1), "]": ("displacement", 1), "[": ("displacement", -1)}
KEYS = {"+ - pressure": "pressure", "] [ actuator": "displacement", "> < step": "", "0 no pressure": "pressure"}
"""What is shown of a key -> the output that a bench must have for it; with `z tare` and `v vent and end`."""


def keys_of(bench: CompiledBench) -> str:
    """The keys that do something on a bench, in one line."""
    outputs = {output.name for output in bench.outputs}
    return "   ".join(
        [*(text for text, needs in KEYS.items() if not needs or needs in outputs), "z tare", "v vent and end"]
    )


def highest(bench: CompiledBench, output: OutputRecord) -> float:
    """Highest value that an output may be set to by hand [SI]."""
    return min(output.high, bench.setup_pressure) if output.name == "pressure" else output.high


@dataclass
class Jog:
    """Commanded values of the outputs [SI], and the step of a key."""

    executor: Executor
    mounted: Mounted
    values: dict[str, float] = field(default_factory=dict)
    size: int = 2
    """Index of the step in `STEPS`."""
    over: bool = False

    def __post_init__(self) -> None:
        self._outputs = {output.name: output for output in self.executor.bench.outputs}
        self.values = {name: output.safe for name, output in self._outputs.items()}

    def press(self, key: str) -> str:
        """Act on a key; returns what was done, in words, empty for an unused key."""
        name, way = MOVES.get(key, ("", 0))
        if name in self._outputs:
            return self._step(name, way)
        if key in "><":
            self.size = min(max(self.size + (1 if key == ">" else -1), 0), len(STEPS["pressure"]) - 1)
            return f"step {self.steps()}"
        if key == "0" and "pressure" in self._outputs:
            return self.go("pressure", self._outputs["pressure"].safe)
        if key.lower() in "vq":
            self.over = True
            return "vent and end"
        return ""

    def steps(self) -> str:
        """Present step of each output, in words."""
        sizes = ((name, STEPS[name][self.size]) for name in self._outputs if name in STEPS)
        return ", ".join(show(size, self._outputs[name].quantity) for name, size in sizes)

    def settings(self) -> str:
        """Commanded values, in words."""
        outputs = ((self._outputs[name], value) for name, value in self.values.items())
        settings = (
            f"{o.name} {show(value, o.quantity, 4)} (up to {show(highest(self.executor.bench, o), o.quantity, 4)})"
            for o, value in outputs
        )
        return "commanded " + "   ".join(settings)

    def _step(self, name: str, way: int) -> str:
        output = self._outputs[name]
        wanted = self.values[name] + way * STEPS[name][self.size]
        value = min(max(wanted, output.low), highest(self.executor.bench, output))
        sent = self.go(name, value)
        return sent if value == wanted else f"{sent}: its limit here"

    def go(self, name: str, value: float) -> str:
        """Command an output to `value` [SI], slowly if it has a rate limit; returns its value in words."""
        output = self._outputs[name]
        before = self.values[name]
        if value != before:
            if output.rate:
                self.executor.do(Ramp(PHASE, name, before, value, TRAVEL * output.rate))
            else:
                self.executor.do(Set(PHASE, name, value))
            self.values[name] = value
        return f"{name} {show(value, output.quantity, 4)}"


def jog(
    mounted: Mounted,
    operator: Operator,
    out: Path | None,
    keys: Callable[[], Sequence[str]],
    shown: Callable[[Mapping[str, Series], Jog, Sequence[str]], None],
    *,
    operator_name: str = "",
) -> Outcome:
    """Move the bench by keys until `v` or `q`. `shown` gets the newest samples and the texts of `Jog.press`.

    Neither `keys` nor `shown` may block. Raises UsageError if the bench has no output.
    """
    if not mounted.bench.outputs:
        raise UsageError(f'"{mounted.bench.name}" has no output to move; look at it without --jog')

    def procedure(executor: Executor) -> None:
        work = Jog(executor, mounted)
        executor.acquisition.record(on=True)
        while not work.over:
            series = listen(executor.acquisition, BLOCK)
            lines = []
            for key in keys():
                lines.append(work.press(key))
                if key == "z":
                    executor.event("tare")
            shown(series, work, [line for line in lines if line])

    name = f"set-up of {mounted.bench.name}"
    return guided_run(mounted, operator, "setup", name, procedure, out=out, operator_name=operator_name)


def hold_at(
    mounted: Mounted,
    name: str,
    value: float,
    operator: Operator,
    out: Path | None,
    shown: Callable[[Mapping[str, Series], Jog], None],
    *,
    seconds: float | None = None,
    operator_name: str = "",
) -> Outcome:
    """Set one output to `value` [SI] after the operator's consent and hold it for `seconds` [s], or until a signal.

    `shown` gets the newest samples and may not block in real time. Raises UsageError if there is no such output, and
    LimitRefused if the value is outside the limits for setting by hand; nothing is opened then.
    """
    bench = mounted.bench
    outputs = {output.name: output for output in bench.outputs}
    if name not in outputs:
        raise UsageError(f'"{bench.name}" has no output "{name}" that takes values{did_you_mean(name, outputs)}')
    output, most = outputs[name], highest(bench, outputs[name])
    low, high, wanted = (show(number, output.quantity) for number in (output.low, most, value))
    if not output.low <= value <= most:
        why = output.high_from if most == output.high else "its set-up pressure; a protocol may go to the limits"
        raise LimitRefused(f"{wanted} for {name} is outside {low} to {high} ({why}): nothing was sent")
    lasts = "until Ctrl-C" if seconds is None else f"for {seconds:g} s"
    text = f"{name} goes to {wanted} and stays there {lasts}; then the safe state follows."

    def procedure(executor: Executor) -> None:
        acquisition, clock = executor.acquisition, executor.clock
        acquisition.record(on=True)
        executor.event("answer", text=text, answer=executor.prompt(text, phase=PHASE))
        work = Jog(executor, mounted)
        work.go(name, value)
        end = clock.now() + (float("inf") if seconds is None else seconds)
        while clock.now() < end - 1e-9:
            shown(listen(acquisition, min(BLOCK, end - clock.now())), work)

    title, by = f"{name} of {bench.name} by hand", operator_name
    return guided_run(mounted, operator, "setup", title, procedure, {name: value}, out=out, operator_name=by)
