"""Guided calibration of a channel, or of the regulator: a run of kind `calibration`, a line through its points, a file.

Reference points are applied up and down in cycles; each is waited for until it is steady, then averaged. The regulator
and a driven free end move there by themselves; loads and all other quantities are applied by the operator, vented. The
line is fitted with its uncertainty (GUM, k = 2) and written as a calibration file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import RecordError, UsageError, VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES, show
from pmabench.bench.channels import fit_line, read_calibration
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord, OutputRecord, Scale
from pmabench.bench.safety import EXTRAPOLATED
from pmabench.bench.session import Stack
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome
from pmabench.protocol.plan import Ask, Hold, Ramp, Set
from pmabench.session.guided import guided_run, load_text, moving_mass, steady

UP, DOWN = "up", "down"
APART = 0.25
"""Readings at one nominal value that differ by more than this fraction of the step to the next are separate points."""
Array = NDArray[Any]


@dataclass(frozen=True)
class Point:
    """One reading: the reference [SI], the mean raw value [device units], the direction `up` or `down`, the cycle."""

    target: float
    reference: float
    raw: float
    way: str
    cycle: int
    noise: float = 0.0
    """Standard deviation of the samples behind `raw` [device units]."""


@dataclass(frozen=True)
class Fit:
    """Line through the points and its uncertainty; all in SI except `points`: (raw, reference) means."""

    scale: Scale
    points: tuple[tuple[float, float], ...]
    residual: float | None
    """Largest distance of a point from the line; None for two points, through which a line always passes."""
    hysteresis: float
    """Largest difference between up and down at one point."""
    repeatability: float
    """Standard deviation of readings at one point, the same way, between cycles; with one cycle between both ways."""
    drift: float
    """Change of the first point from the first to the last cycle; with one cycle from its beginning to its end."""
    reference: float
    """Expanded uncertainty of the reference (k = 2)."""
    expanded: float
    """Expanded uncertainty of a value from this line (k = 2); for two points without any linearity error."""


def fit(points: Sequence[Point], reference: float) -> Fit:
    """The calibration from readings up and down.

    The standard uncertainties are added in quadrature (GUM 5.1.2): reference U/2; largest residual,
    half the hysteresis and half the drift as half widths of rectangular distributions (/ sqrt 3, GUM 4.3.7);
    repeatability. In a single cycle the only repeats are up and down, so hysteresis also counts as scatter: the two
    cannot be separated. Readings at one nominal value are one point unless they are `APART`.
    Raises VerdictFailed if the points do not define a line.
    """
    target, raw, value = (np.array([getattr(p, name) for p in points]) for name in ("target", "raw", "reference"))
    way, cycle = np.array([p.way for p in points]), np.array([p.cycle for p in points])
    places = list(_places(target, value))
    means = sorted(((float(raw[at].mean()), float(value[at].mean())) for at in places), key=lambda mean: mean[1])
    try:
        scale = fit_line([one for one, _ in means], [one for _, one in means])
    except (ValueError, ZeroDivisionError) as error:
        raise VerdictFailed(f"no calibration: {error}") from error
    residual = max(abs(scale.to_si(one) - reference_value) for one, reference_value in means)
    # deviation from the line at each reading: changes of the reference itself do not count
    off = scale.to_si(raw) - value
    ways = [(off[at & (way == UP)], off[at & (way == DOWN)]) for at in places]
    hysteresis = max((abs(float(up.mean() - down.mean())) for up, down in ways if len(up) and len(down)), default=0.0)
    cells = [off[(target == place) & (way == one)] for place, one in dict.fromkeys((p.target, p.way) for p in points)]
    if len(set(cycle)) == 1:
        cells = [off[target == place] for place in np.unique(target)]
    freedom = len(points) - len(cells)  # pooled over points and directions; 0 without repeats
    repeatability = sqrt(sum(float(np.sum((c - c.mean()) ** 2)) for c in cells) / freedom) if freedom else 0.0
    first = target == target[0]
    ends = [float(off[first & (cycle == number)].mean()) for number in (cycle[0], cycle[first][-1])]
    drift = ends[1] - ends[0] if len(set(cycle)) > 1 else float(off[first][-1] - off[first][0])
    squares = (
        (reference / 2) ** 2,
        (residual / sqrt(3)) ** 2,
        (hysteresis / 2 / sqrt(3)) ** 2,
        (drift / 2 / sqrt(3)) ** 2,
        repeatability**2,
    )
    known = residual if len(places) > 2 else None
    return Fit(scale, tuple(means), known, hysteresis, repeatability, drift, reference, 2 * sqrt(sum(squares)))


def step(target: float, targets: Iterable[float]) -> float:
    """Distance from a nominal value to the nearest other one [SI]; inf for a single one."""
    return min((abs(other - target) for other in targets if other != target), default=inf)


def _places(target: Array, value: Array) -> Iterator[Array]:
    """Masks of the readings that make one point of the line: one nominal value, and references close together."""
    for place in np.unique(target):
        at = target == place
        together = float(np.ptp(value[at])) <= APART * step(place, target)
        yield from [at] if together else np.eye(len(target), dtype=bool)[at]


def write_calibration(
    folder: Path,
    channel: str,
    quantity: str,
    raw_unit: str,
    found: Fit,
    *,
    reference: str,
    run: str,
    today: date,
    valid_until: date | None = None,
    sensor_lag: float = 0.0,
) -> Path:
    """Write `folder`/ID.yaml, ID = CHANNEL-DATE (with -2, -3 ... if it exists); read it back as a bench would.

    Raises RecordError if it cannot be written.
    """
    text = "".join(f"{line}\n" for line in _lines(channel, quantity, raw_unit, found, reference, run))
    made: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in _names(channel, today):
            path = folder / f"{name}.yaml"
            try:
                with path.open("x", encoding="utf-8") as stream:
                    made = path
                    stream.write(f"schema: pmabench.calibration/1\nid: {name}\n{text}date: {today.isoformat()}\n")
                    if valid_until is not None:
                        stream.write(f"valid_until: {valid_until.isoformat()}\n")
                    if sensor_lag:
                        stream.write(f"sensor_lag: {1e3 * sensor_lag:.6g} ms\n")
                    stream.flush()
                    os.fsync(stream.fileno())
            except FileExistsError:
                continue
            if found.residual is not None:  # else it contains ??, which a bench refuses
                read_calibration(path, quantity)
            return path
    except OSError as error:
        if made is not None:
            made.unlink(missing_ok=True)
        raise RecordError(f"{folder}: the calibration cannot be written: {error.strerror or error}") from error
    raise RecordError(f"{folder}: no name is left for a calibration of {channel} of today")


def _names(channel: str, today: date) -> Iterator[str]:
    first = f"{channel.replace('_', '-').upper()}-{today:%Y%m%d}"
    yield first
    for number in range(2, 100):
        yield f"{first}-{number}"


def _lines(channel: str, quantity: str, raw_unit: str, found: Fit, reference: str, run: str) -> Iterator[str]:
    shown = QUANTITIES[quantity]
    yield f"quantity: {quantity}"
    yield f"reference: {json.dumps(reference, ensure_ascii=False)}"
    yield "points:"
    for raw, value in found.points:
        yield f"  - [{raw:.10g} {raw_unit}, {value / shown.scale:.10g} {shown.shown_in}]"
    known = f"{never_less(found.expanded / shown.scale)} {shown.shown_in}"
    if found.residual is None:
        yield f"expanded_uncertainty: ??  # {known}, and what the data sheet says of linearity: two points show no bend"
    else:
        # if both ends of a line are off by U, independently, it is off by sqrt(2) U over its span
        span = max(value for _, value in found.points) - min(value for _, value in found.points)
        yield f"expanded_uncertainty: {known}"
        yield f"gain_uncertainty: {never_less(100 * sqrt(2) * found.expanded / span)} %"
    yield f"# of {channel}, by the run {run}"
    parts = {"reference": found.reference, "hysteresis": found.hysteresis, "repeatability (1 s)": found.repeatability}
    parts |= {"drift": found.drift} | ({} if found.residual is None else {"largest residual": found.residual})
    yield "# from " + ", ".join(f"{name} {show(value, quantity, 3)}" for name, value in parts.items())


def never_less(value: float) -> str:
    """Three significant digits, never rounded down."""
    text = f"{value:.3g}"
    return text if float(text) >= value else f"{value * 1.005:.3g}"


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

    def procedure(executor: Executor) -> None:
        if request.nominal and channel is not None and not executor.bench.simulated:
            raise UsageError("--yes: on a real bench somebody has to read the reference")
        executor.recorder.event("calibration", executor.clock.now(), **asdict(request))
        executor.acquisition.record(on=True)
        work = _Work(executor, mounted, request, read, channel, output)
        for number, (target, way, cycle) in enumerate(order(request.points, request.cycles)):
            steps = 2 * request.cycles * len(request.points)
            executor.progress(Progress(number, steps, None, 0, executor.clock.now(), 0.0, f"{way} {number + 1}"))
            point = work.point(target, way, cycle)
            points.append(point)
            executor.recorder.event("calibration-point", executor.clock.now(), **asdict(point))
            if channel is not None and output is not None and (why := not_reached(point, request, quantity)):
                warnings.append(why)
                about = {"limit": "calibration point", "action": "warn", "value": point.reference}
                executor.recorder.event("warning", executor.clock.now(), reason=why, **about)
        executor.acquisition.record(on=False)
        found = fit(points, work.reference_uncertainty)
        if said := not_followed(found, points, quantity, raw_unit):
            raise VerdictFailed(said)
        fits.append(found)
        for why in contradictions(found, channel) if channel is not None else ():
            warnings.append(why)
            about = {"limit": "calibration", "action": "warn", "value": found.expanded}
            executor.recorder.event("warning", executor.clock.now(), reason=why, **about)
        executor.recorder.event("calibrated", executor.clock.now(), channel=request.channel, **asdict(found))

    points_of = {"points": list(request.points)}
    more = {"out": out, "operator_name": operator_name, "progress": progress}
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
    off, where = max(((found.scale.to_si(raw) - value, value) for raw, value in found.points), key=lambda p: abs(p[0]))
    if abs(off) > BENT * float(np.ptp([value for _, value in found.points])):
        said.append(
            f"the point {show(where, quantity, 4)} lies {show(abs(off), quantity, 3)} off the line: one reference was "
            "not what it should have been, or the sensor bends; repeat this point"
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
    return (
        f"no calibration: the reference changes by {show(value, quantity, 3)} and the reading by {raw:.3g} {raw_unit}, "
        f"with a noise of {noise:.3g} {raw_unit}; by this line a value would be known to +- "
        f"{show(found.expanded, quantity, 3)}. The channel does not follow the reference: do loads pull at the cell or "
        "rest on their support (--hold lifts them)? Is this the channel's plug, and is what it measures connected?"
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


def not_shown(request: Request) -> list[str]:
    """Sentences on what these points and cycles cannot determine."""
    found, count = [], len(set(request.points))
    if count == 2:
        found.append(
            "two points do not show how far the channel bends between them: the file leaves its expanded_uncertainty "
            "open (??), and a bench asks for it; take four or more"
        )
    if count == 3:
        found.append("three points do not show a line that bends one way and then the other; take four or more")
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


def budget(found: Fit, quantity: str, raw_unit: str) -> list[tuple[str, str]]:
    """Components of the uncertainty: pairs of name and value with unit."""
    shown = QUANTITIES[quantity]
    return [
        ("slope", f"{found.scale.slope:.8g} {QUANTITIES[quantity].unit}/{raw_unit}"),
        ("offset", show(found.scale.offset, quantity)),
        ("largest residual", "not known: two points" if found.residual is None else show(found.residual, quantity, 3)),
        ("hysteresis", show(found.hysteresis, quantity, 3)),
        ("repeatability (1 s)", show(found.repeatability, quantity, 3)),
        ("drift", show(found.drift, quantity, 3)),
        ("reference (k = 2)", show(found.reference, quantity, 3)),
        ("expanded (k = 2)", f"{never_less(found.expanded / shown.scale)} {shown.shown_in}"),
    ]


def as_json(found: Fit) -> dict[str, Any]:
    """The fit as plain data [SI]."""
    return asdict(found)
