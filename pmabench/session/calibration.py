"""Guided calibration of a channel, or of the regulator: a run of kind `calibration`, a line through its points, a file.

Reference points are applied up and down in cycles; each is waited for until it is steady, then averaged. The regulator
and a driven free end move there by themselves; loads and all other quantities are applied by the operator, vented. The
line, its uncertainty and its file are in `calibration_line`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path

import numpy as np

from pmabench.base.errors import UsageError, VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord, OutputRecord
from pmabench.bench.safety import EXTRAPOLATED
from pmabench.bench.session import Stack
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome
from pmabench.protocol.plan import Ask, Hold, Ramp, Set
from pmabench.session.calibration_line import DOWN, UP, Fit, Point, fit, step
from pmabench.session.guided import guided_run, load_text, moving_mass, steady

PHASE = "calibration"
REGULATOR = "pressure_command"
"""Name under which the regulator is calibrated: its command against the measured pressure."""
CALIBRATED = ("force", "pressure", "displacement", "angle", REGULATOR)
DRIFT = 5e-4
"""Largest drift while a point is read, as a fraction of the channel's range."""
REACHED = 0.1
"""Largest deviation of an output from its point, as a fraction of the step to the next point [1]."""
TRAVEL = 0.1
"""Speed of a driven free end between points, as a fraction of its highest."""

Read = Callable[[str, float, Callable[[], None]], float]
"""Asks for the reference's reading [SI]; arguments: a question, the nominal value, a function that lets time pass."""


@dataclass(frozen=True)
class Request:
    """What is calibrated, at which points [SI], how many cycles, and the uncertainty of the reference (k = 2, SI)."""

    channel: str
    points: tuple[float, ...]
    reference: str
    reference_uncertainty: float
    cycles: int = 2
    seconds: float = 2.0
    """Averaging time at each point [s]."""
    nominal: bool = False
    """Take the nominal value instead of a reading of the reference; for simulated benches."""
    hold: float = 0.0
    """Pressure that lifts a load off its support [Pa]; 0: loads already pull at the cell without pressure."""


@dataclass(frozen=True)
class Calibrated:
    """Result of a calibration; `fit` is None if the run ended early."""

    outcome: Outcome
    fit: Fit | None
    raw_unit: str
    warnings: tuple[str, ...] = ()
    """A sentence for each point that was not reached, and for what the line contradicts."""


def calibrate(
    mounted: Mounted,
    request: Request,
    operator: Operator,
    read: Read,
    out: Path | None,
    *,
    operator_name: str = "",
    progress: Callable[[Progress], None] = lambda _progress: None,
) -> Calibrated:
    """Calibrate; raises UsageError, before anything is opened, if this bench cannot do it."""
    channel, output = check(mounted, request)
    # for the regulator the unit of its command, as in its scale
    raw_unit = channel.raw_unit if channel else str(mounted.bench_file.set_points["pressure"].scale[0][0][1])
    quantity = channel.quantity if channel else "pressure"
    points: list[Point] = []
    fits: list[Fit] = []
    warnings: list[str] = []

    def warn(executor: Executor, why: str, limit: str, value: float) -> None:
        warnings.append(why)
        executor.event("warning", reason=why, limit=limit, action="warn", value=value)

    def before_proof(executor: Executor) -> None:
        if request.nominal and channel is not None and not executor.bench.simulated:
            raise UsageError("--yes: on a real bench somebody has to read the reference")

    def procedure(executor: Executor) -> None:
        executor.event("calibration", **asdict(request))
        executor.acquisition.record(on=True)
        work = _Work(executor, mounted, request, read, channel, output)
        for number, (target, way, cycle) in enumerate(order(request.points, request.cycles)):
            steps = 2 * request.cycles * len(request.points)
            now = executor.clock.now()
            left = now * (steps - number) / number if number else inf
            executor.progress(Progress(number, steps, None, 0, now, left, f"{way} {number + 1}"))
            point = work.point(target, way, cycle)
            points.append(point)
            executor.event("calibration-point", **asdict(point))
            if channel is not None and output is not None and (why := not_reached(point, request, quantity)):
                warn(executor, why, "calibration point", point.reference)
        executor.acquisition.record(on=False)
        found = fit(points, work.reference_uncertainty)
        if said := not_followed(found, points, quantity, raw_unit):
            raise VerdictFailed(said)
        for why in contradictions(found, channel) if channel is not None else ():
            warn(executor, why, "calibration", found.expanded)
        off, where = farthest(found)
        if abs(off) > NO_LINE * float(np.ptp([value for _, value in found.points])):
            far = f"the point {show(where, quantity, 4)} lies {show(abs(off), quantity, 3)} off the line"
            raise VerdictFailed(f"no calibration: {far}, more than {NO_LINE:.0%} of the span")
        fits.append(found)
        executor.event("calibrated", channel=request.channel, **asdict(found))

    points_of = {"points": list(request.points)}
    more = {"out": out, "operator_name": operator_name, "progress": progress, "before_proof": before_proof}
    name = f"calibration of {request.channel}"
    outcome = guided_run(mounted, operator, "calibration", name, procedure, points_of, **more)
    return Calibrated(outcome, fits[0] if fits else None, raw_unit, tuple(warnings))


def not_reached(point: Point, request: Request, quantity: str) -> str:
    """A sentence if the output did not reach a point; else empty."""
    allowed = REACHED * step(point.target, request.points) + request.reference_uncertainty
    if abs(point.reference - point.target) <= allowed:
        return ""
    reached, wanted = show(point.reference, quantity, 4), show(point.target, quantity, 4)
    return (
        f"{quantity} not reached: {reached} of {wanted} ({point.way}, cycle {point.cycle + 1}): the line takes the "
        "reading for what it is; look at regulator, valves, supply and the reference itself"
    )


BENT = 0.02
"""Distance of a point from the line, as a share of their span, from which on it is a mistake rather than a bend."""


NO_LINE = 0.05
"""The same, from which on there is no line: a cell that is clipped at a third of its loads gave one 20 % too steep."""


def farthest(found: Fit) -> tuple[float, float]:
    """Distance from the line of the point that is farthest from it, and its reference [SI]."""
    return max(((found.scale.to_si(raw) - value, value) for raw, value in found.points), key=lambda p: abs(p[0]))


def contradictions(found: Fit, channel: ChannelRecord) -> list[str]:
    """Sentences where the line is not that of the calibration in use, and where a point is far off the line."""
    quantity, said = channel.quantity, list[str]()
    before = [(float(channel.scale.to_si(raw)) - value, value) for raw, value in found.points]
    apart, at = max(before, key=lambda one: abs(one[0]))
    limit = found.expanded + channel.calibration.uncertainty(at)
    if abs(apart) > limit:
        said.append(
            f"by the calibration in use {channel.name} reads {show(apart, quantity, 3)} off the reference at "
            f"{show(at, quantity, 4)}, and both together allow {show(limit, quantity, 2)}: has the sensor changed, or "
            "is the reference not what was entered (a hanger, marks in another unit)? A point at 0 tells"
        )
    off, where = farthest(found)
    if abs(off) > BENT * float(np.ptp([value for _, value in found.points])):
        said.append(
            f"the point {show(where, quantity, 4)} lies {show(abs(off), quantity, 3)} off the line: one reference was "
            "not what it should have been, or the sensor bends or is at the end of its range; repeat this point"
        )
    return said


def not_followed(found: Fit, points: Sequence[Point], quantity: str, raw_unit: str) -> str:
    """Why the readings do not follow the reference, and what to do; empty if they do.

    They do not if the expanded uncertainty exceeds half the span, or if they change by less than their noise.
    """
    raw, value = (np.ptp(np.array(found.points), axis=0)).tolist()
    noise = max(point.noise for point in points)
    if found.expanded <= value / 2 and raw > noise:
        return ""
    loads = "do loads pull at the cell or rest on their support (--hold lifts them)? " * (quantity == "force")
    return (
        f"no calibration: the reference changes by {show(value, quantity, 3)} and the reading by {raw:.3g} {raw_unit}, "
        f"with a noise of {noise:.3g} {raw_unit}; by this line a value would be known to +- "
        f"{show(found.expanded, quantity, 3)}. The channel does not follow the reference: {loads}is this the channel's "
        "plug, and is what it measures connected? Was the reference typed in its unit?"
    )


def order(points: Sequence[float], cycles: int) -> list[tuple[float, str, int]]:
    """Targets in order, as (target, way, cycle): each cycle up, then down, with the ends in both directions."""
    rising = sorted(points)
    return [
        (target, way, cycle)
        for cycle in range(cycles)
        for way, series in ((UP, rising), (DOWN, rising[::-1]))
        for target in series
    ]


def check(mounted: Mounted, request: Request) -> tuple[ChannelRecord | None, OutputRecord | None]:
    """Channel and output of a calibration; raises UsageError if this bench cannot do it.

    The channel is None for the regulator, the output None if the operator sets the quantity.
    """
    bench = mounted.bench
    channels = {channel.name: channel for channel in bench.channels}
    outputs = {output.name: output for output in bench.outputs}
    name = request.channel
    if name not in CALIBRATED:
        raise UsageError(f'"{name}" cannot be calibrated; what can: {", ".join(CALIBRATED)}')
    wanted = "pressure" if name == REGULATOR else name
    if wanted not in channels or (name == REGULATOR and "pressure" not in outputs):
        raise UsageError(f'"{bench.name}" has no {"regulator and pressure channel" if name == REGULATOR else name}')
    quantity = CHANNEL_QUANTITY[wanted]
    if len(set(request.points)) < 2:
        raise UsageError("at least two reference points are needed; three or more show whether it is a straight line")
    if request.cycles < 1 or request.cycles > 20:
        raise UsageError("one to twenty cycles are expected; two or more show the repeatability")
    output = outputs.get(wanted)
    channel = channels[wanted]
    for value in request.points:
        if output is not None and not output.low <= value <= output.high:
            raise UsageError(
                f"{show(value, quantity)} is outside what may be commanded, {show(output.low, quantity)} to "
                f"{show(output.high, quantity)} ({output.high_from})"
            )
        if output is None and not channel.low <= value <= channel.high:
            raise UsageError(f"{show(value, quantity)} is outside the range of {wanted}")
    if request.hold and ("pressure" not in outputs or request.hold > outputs["pressure"].high or name != "force"):
        raise UsageError("a pressure that holds the loads up belongs to the force, and within the command limit")
    weights = mounted.bench_file.weights
    if name == "force" and weights is not None:
        stack = Stack(weights.hanger, weights.plates)
        for value in request.points:
            mass = value / weights.g
            if not stack.can_make(mass):
                near = " or ".join(f"{load * weights.g:.6g} N ({load:g} kg)" for load in stack.around(mass))
                raise UsageError(f"{value:g} N ({mass:g} kg) cannot be made of {stack}; nearest: {near}")
    return (None if name == REGULATOR else channel), output


GAP = 0.4
"""Share of the range between two neighbouring points from which on they show a bend too late: 1/3 of four even ones."""


def not_shown(request: Request) -> list[str]:
    """Sentences on what these points and cycles cannot determine."""
    found, count = [], len(set(request.points))
    if count == 2:
        different = "different " if len(request.points) > 2 else ""
        found.append(
            f"two {different}points do not show how far the channel bends between them: the file leaves its "
            "expanded_uncertainty open (??), and a bench asks for it; take four or more"
        )
    if count == 3:
        found.append("three points do not show a line that bends one way and then the other; take four or more")
    targets = sorted(set(request.points))
    near, far = max(itertools.pairwise(targets), key=lambda pair: pair[1] - pair[0], default=(0.0, 0.0))
    if count > 3 and far - near > GAP * (targets[-1] - targets[0]):
        quantity = "pressure" if request.channel == REGULATOR else CHANNEL_QUANTITY[request.channel]
        ends = f"{show(near, quantity)} and {show(far, quantity)}"
        found.append(f"between {ends} nothing shows how far the channel bends; take points evenly")
    if request.cycles == 1:
        found.append(
            "one cycle has no repeats: what up and down differ counts as scatter as well as hysteresis, and drift is "
            "that of its first point alone; take two or more"
        )
    return found


def uncovered(mounted: Mounted, request: Request) -> list[str]:
    """Sentences on trip limits outside these points, each with the consequence at a bench."""
    low, high = min(request.points), max(request.points)
    trips = [trip for trip in mounted.bench.trips if trip.channel == request.channel and trip.kind == "range"]
    found = []
    for trip in trips:
        quantity = CHANNEL_QUANTITY[trip.channel]
        for value in (trip.low, trip.high):
            if value is None or low < value < high:
                continue
            beyond = max(low - value, value - high)
            line = f"the trip limit {show(value, quantity)} of {trip.channel} is not between the points"
            if beyond <= EXTRAPOLATED * (high - low):
                found.append(f"{line}: a bench takes it, and counts the line beyond them as less well known")
            else:
                other = low if value > high else high
                nearest = (value + EXTRAPOLATED * other) / (1 + EXTRAPOLATED)
                found.append(
                    f"{line}: a bench refuses a calibration that ends so far from it; take points from "
                    f"{show(other, quantity, 4)} at least to {show(nearest, quantity, 4)}, or move the limit"
                )
    return found


@dataclass
class _Work:
    """Goes to the points and reads them."""

    executor: Executor
    mounted: Mounted
    request: Request
    read: Read
    channel: ChannelRecord | None
    output: OutputRecord | None

    def __post_init__(self) -> None:
        self._measured = next(
            c for c in self.executor.bench.channels if c.name == (self.channel.name if self.channel else "pressure")
        )
        self._commanded = self.output.safe if self.output is not None else 0.0
        self._at: float | None = None

    @property
    def reference_uncertainty(self) -> float:
        """Expanded uncertainty of the reference [SI]: as given; for the regulator at least that of the pressure."""
        if self.channel is not None:
            return self.request.reference_uncertainty
        known = self._measured.calibration
        of_channel = known.offset_uncertainty + known.gain_uncertainty * max(abs(p) for p in self.request.points)
        return max(of_channel, self.request.reference_uncertainty)

    def point(self, target: float, way: str, cycle: int) -> Point:
        """Go to a point, wait until it is steady, average, read the reference."""
        nominal = self._go(target)
        most = DRIFT * (self._measured.high - self._measured.low)
        reading = steady(
            self.executor.acquisition, self._measured.name, most, seconds=self.request.seconds, within=60.0
        )
        if self.channel is None:
            assert self.output is not None  # noqa: S101  (the regulator has one)
            return Point(target, reading.mean, float(self.output.scale.to_raw(nominal)), way, cycle)
        raw = float(self.channel.scale.to_raw(reading.mean))
        noise = abs(float(self.channel.scale.to_raw(reading.mean + reading.noise)) - raw)
        quantity = self.channel.quantity
        text = f"{self.request.reference}: what does it read at {show(nominal, quantity)}?"
        reference = self.read(text, nominal, self._wait)
        return Point(target, reference, raw, way, cycle, noise)

    def _wait(self) -> None:
        self.executor.acquisition.pass_time(0.1)

    def _go(self, target: float) -> float:
        """Bring the quantity to `target` [SI]; returns the nominal value with the resolution of the output."""
        if self._at == target:
            return self._commanded if self.output is not None else target
        self._at = target
        if self.output is not None:
            if self.output.rate:
                self.executor.do(Ramp(PHASE, self.output.name, self._commanded, target, TRAVEL * self.output.rate))
            else:
                self.executor.do(Set(PHASE, self.output.name, target))
            self.executor.do(Hold(PHASE, 1.0))
            self._commanded = self.executor.guard.value_sent(self.output.name, target)
            return self._commanded
        weights = self.mounted.bench_file.weights
        quantity = self._measured.quantity
        text, load = f"Bring {self._measured.name} to {show(target, quantity)} of the reference.", None
        if self._measured.name == "force" and weights is not None:
            mass = target / weights.g
            text, load = load_text(self.mounted, mass), (target, moving_mass(self.mounted, mass))
        has_pressure = any(output.name == "pressure" for output in self.executor.bench.outputs)
        if has_pressure:
            self.executor.do(Set(PHASE, "pressure", 0.0))
        self.executor.do(Ask(PHASE, text, "vented", load))
        if has_pressure and self.request.hold and target > 0:
            self.executor.do(Set(PHASE, "pressure", self.request.hold))
            self.executor.do(Hold(PHASE, 5.0))
        return target
