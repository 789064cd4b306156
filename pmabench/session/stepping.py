"""The first pressures of a session, in small steps: which channels follow, which way, how well; then a full step.

Each pressure is held, and the next one follows only when the pressure and its read-back are right. The full step is
described in the terms of ISO 10094, with the delay between two channels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.safety import SUPPLY_MARGIN
from pmabench.bench.session import SelfTest
from pmabench.engine.acquire import Array
from pmabench.engine.executor import Executor
from pmabench.protocol.plan import Hold, Ramp, Set
from pmabench.session.checks import NOT_CHECKED, NOT_MEASURED, Check, judged, refuse, table
from pmabench.session.guided import Series, above, listen, put_on
from pmabench.session.wiring import (
    DISPLACEMENT,
    FORCE,
    LIFTED,
    PRESSURE,
    SET,
    SIGNIFICANT,
    Stage,
    Wiring,
)  # fmt: skip

BAND = 0.05
"""Fraction of a step at which it counts as begun, and within which it counts as settled."""
MOST_DELAY = 0.2
"""Longest delay between two channels that can be found [s]."""


@dataclass(frozen=True)
class StepResponse:
    """Times [s] from the command; None if not reached. Overshoot and final value in SI, overshoot not below 0."""

    dead_time: float | None
    """Time to 5 % of the step."""
    rise: float | None
    """Time from 10 to 90 %."""
    settling: float | None
    """Time until it stays within 5 % of the step around its end value."""
    overshoot: float
    final: float


def step_response(series: Series, commanded_at: float, before: float, noise: float) -> StepResponse:
    """The response to a command at `commanded_at` [s] from a rest at `before`; `noise` is the rms of one sample."""
    y = smoothed(series.y, 5)
    final = float(series.y[series.t > series.t[-1] - 0.2 * (series.t[-1] - commanded_at)].mean())
    size = final - before
    if abs(size) < 5 * noise or size == 0:
        return StepResponse(None, None, None, 0.0, final)
    part = (y - before) / size
    started, low, high = (first_crossing(series.t, part, level) for level in (BAND, 0.1, 0.9))
    outside = np.flatnonzero(np.abs(part - 1) > max(BAND, 4 * noise / abs(size)))
    last = int(outside[-1]) + 1 if len(outside) else 0
    settled = float(series.t[last]) - commanded_at if last < len(series.t) else None
    over = float((part.max() - 1) * abs(size))
    return StepResponse(
        None if started is None else started - commanded_at,
        None if low is None or high is None else high - low,
        settled,
        max(0.0, over - 3 * noise / np.sqrt(5)),
        final,
    )


def smoothed(y: Array, width: int) -> Array:
    """Running mean of odd `width`, with repeated ends; shape as `y`."""
    if len(y) < width:
        return y
    padded = np.pad(y, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def first_crossing(t: Array, y: Array, level: float) -> float | None:
    """Time of the first upward crossing of `level` that lasts three samples, interpolated; None without one."""
    above = y >= level
    held = above[:-2] & above[1:-1] & above[2:] if len(y) > 2 else above
    found = np.flatnonzero(held)
    if not len(found):
        return None
    i = int(found[0])
    if i == 0 or y[i] == y[i - 1]:
        return float(t[i])
    return float(t[i - 1] + (level - y[i - 1]) / (y[i] - y[i - 1]) * (t[i] - t[i - 1]))


def delay(pressure: tuple[Series, Series], other: tuple[Series, Series]) -> float | None:
    """Delay of `other` after the pressure [s], from one step up and one down each.

    If `other` is any rising function of the pressure, it crosses half of its range at the same pressure in both
    directions. This holds for one delay only, searched within `MOST_DELAY`. None if there is no such delay.
    """
    up, down = other
    low, high = up.y[: max(3, len(up.y) // 50)].mean(), up.mean(0.2 * (up.t[-1] - up.t[0]))
    if high == low:
        return None
    curves = []
    delays = np.arange(-MOST_DELAY, MOST_DELAY, 1e-3)
    for p, y, sign in ((pressure[0], up, 1.0), (pressure[1], down, -1.0)):
        at = first_crossing(y.t, sign * (smoothed((y.y - low) / (high - low), 5) - 0.5), 0.0)
        if at is None:
            return None
        curves.append(np.interp(at - delays, p.t, smoothed(p.y, 9)))
    apart = curves[0] - curves[1]
    passes = np.flatnonzero(np.diff(np.sign(apart)))
    if not len(passes):
        return None
    i = int(passes[np.abs(delays[passes]).argmin()])
    return float(delays[i] + 1e-3 * apart[i] / (apart[i] - apart[i + 1]))


PHASE = "self-test"
REST = 1.0
"""Duration of a measurement at rest [s]."""
VALVE = 1.0
"""Duration of the test of a valve [s]."""
READ_BACK = 0.1
"""Delay before the set-point is read back [s]."""
WAY, SPEED = 1.5e-3, 5e-3
"""Distance [m] and speed [m/s] of the drive's test motion without pressure."""


LEAK = 10.0
"""Duration of the leak test with the isolation valve shut [s]."""
NORMAL = 1.96
"""Half width of 95 % of a normal distribution, in standard deviations."""
NO_LEAK = Check("leak", "", "", NOT_MEASURED, "cannot be measured on this bench: no isolation valve that is switched")


def isolation(mounted: Mounted) -> str:
    """Name of the isolation valve, if it is switched and the safe state shuts it; else empty."""
    name = mounted.bench_file.air.isolation_valve
    return next((valve.name for valve in mounted.bench.valves if valve.name == name and valve.safe == "closed"), "")


def leaks(
    executor: Executor, mounted: Mounted, test: SelfTest, rows: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[Check, dict[str, float]]]:
    """Fall of each pressure with the isolation valve shut; from the highest point of the test, at the end set to 0.

    `rows`: channel -> name of its check, and where to look if it fails. Yields each check with its numbers for the
    record: set `pressure` [Pa], rate `falls` [Pa/s], and its 95 % `half_width` for a straight line in white noise.
    """
    executor.guard.valves(closed=False, only=isolation(mounted))
    executor.do(Hold(PHASE, 1.0))
    series = listen(executor.acquisition, LEAK)
    for channel in rows:
        executor.do(Set(PHASE, channel, 0.0))
    executor.guard.valves(closed=True, only=isolation(mounted))
    executor.do(Hold(PHASE, test.settle))
    for channel, (row, hint) in rows.items():
        reading = series[channel].reading()
        falls = -reading.drift / LEAK
        check = judged(
            row,
            f"falls by {show(60 * falls, 'pressure', 3)} per min at {show(reading.mean, 'pressure', 4)}",
            f"at most {show(60 * test.leak, 'pressure', 3)} per min",
            good=falls <= test.leak,
            hint=hint,
        )
        half = NORMAL * reading.noise * sqrt(12 / reading.count) / LEAK
        yield check, {"pressure": test.points[-1], "falls": falls, "half_width": half}


class Stepping:
    """Applies small steps of pressure and drive, and keeps what every channel read in `stages`."""

    def __init__(self, executor: Executor, mounted: Mounted, test: SelfTest) -> None:
        self._executor, self._mounted, self._test = executor, mounted, test
        self.wiring = Wiring(mounted)
        self.stages: list[Stage] = []
        self._now = Stage({})
        self._supply = np.inf

    def ended(self, means: Mapping[str, float], tripped: str = "") -> None:
        """Note a hold that ended early, with its means so far [SI]; `tripped`: the channel whose limit ended it."""
        self.stages.append(replace(self._now, means=means, settled=False, tripped=tripped))

    def table(self) -> list[Check]:
        """All checks so far, with an explanation for the failed ones."""
        return table(self.wiring, self.stages)

    def rest(self, load: float | None) -> Mapping[str, Series]:
        """Read the vented bench with a load [N] on; None: with an unknown load."""
        series = listen(self._executor.acquisition, REST)
        self._now = Stage({}, 0.0, load)
        self._keep(series)
        self.wiring.noise = {name: one.reading().noise for name, one in series.items()}
        return series

    def _keep(self, series: Mapping[str, Series]) -> None:
        before = self.stages[-1] if self.stages else Stage({})
        means = {name: one.mean(0.2 * (one.t[-1] - one.t[0])) for name, one in series.items()}
        halves: dict[str, float] = {}
        for name in (PRESSURE, SET) if before.pressure != self._now.pressure else ():
            if name in series and name in before.means and means[name] != before.means[name]:
                part = (smoothed(series[name].y, 5) - before.means[name]) / (means[name] - before.means[name])
                at = first_crossing(series[name].t, part, 0.5)
                halves |= {} if at is None else {name: at}
        drift = 0.0
        if PRESSURE in series:
            one = series[PRESSURE]
            last = one.t > one.t[-1] - 0.2 * (one.t[-1] - one.t[0])
            drift = Series(one.t[last], one.y[last]).reading().drift
        if "supply" in series:
            self._supply = min(self._supply, float(series["supply"].y.min()))
        self.stages.append(replace(self._now, means=means, halves=halves, drift=drift))

    def _go(self, pressure: float) -> Mapping[str, Series]:
        self._now = Stage({}, pressure, self._now.load, self._now.place)
        self._executor.do(Set(PHASE, PRESSURE, pressure))
        series = listen(self._executor.acquisition, self._test.settle)
        self._keep(series)
        return series

    # -- before the vent path is proven ---------------------------------------------------------------------------

    def first(self) -> None:
        """Apply the first small pressure, with any load, and test the effect of the dump valve."""
        pressure, rest = self._test.points[0], self.stages[-1].means[PRESSURE]
        most = rest + 2 * pressure + self.wiring.follows_within()
        self._now = Stage({}, pressure)
        self._executor.do(Set(PHASE, PRESSURE, pressure))
        series = listen(self._executor.acquisition, self._test.settle, above({PRESSURE: most}))
        if (series[PRESSURE].y > most).any():
            self._executor.acquisition.pass_time(READ_BACK)
            self.ended(dict(self._executor.acquisition.latest))
            refuse(self.table())
        self._keep(series)
        self._open_dump(pressure)
        self._refuse_lost()
        self._go(0.0)

    def _open_dump(self, pressure: float) -> None:
        """Open the dump valve with an unchanged set-point; not if a burst limit would trip."""
        dump = self.wiring.dump
        bursts = [trip.high or 0.0 for trip in self._mounted.bench.trips if trip.kind == "burst"]
        if dump is None or min(bursts, default=np.inf) <= pressure:
            return
        self._now = replace(self._now, opened=dump.name)
        self._executor.guard.valves(closed=False, only=dump.name)
        self._keep(listen(self._executor.acquisition, VALVE))
        self._executor.guard.valves(closed=True, only=dump.name)

    # -- after the vent path is proven --------------------------------------------------------------------------------

    def drive(self) -> None:
        """Move the drive a little without pressure, and back."""
        output = self.wiring.outputs.get("displacement")
        if output is None or not output.low <= 0.0 <= output.high:
            return
        way = next((way for way in (WAY, -WAY) if output.low <= way <= output.high), 0.0)
        speed = min(SPEED, output.rate or SPEED)
        for origin, place in ((0.0, way), (way, 0.0)) if way else ():
            self._executor.do(Ramp(PHASE, "displacement", origin, place, speed))
            self._executor.do(Hold(PHASE, REST))
            self._now = Stage({}, 0.0, self._now.load, place)
            self._keep(listen(self._executor.acquisition, REST))
        refuse(self.table())

    def run(self, checks: list[Check]) -> None:
        """Raise the pressure in steps, lower it, then make one full step. Appends checks that are no claims."""
        begin, points = len(self.stages) - 1, self._test.points
        for pressure in points:
            self._go(pressure)
            self._refuse_lost()
        for pressure in (*reversed(points[:-1]), 0.0):
            self._go(pressure)
        checks.append(self._linearity(self.stages[begin:]))
        checks += self._response()

    def _refuse_lost(self) -> None:
        """Stop if the pressure is wrong; other faults are judged at the highest step, where they show best."""
        broken = [claim for claim in self.wiring.claims(self.stages) if not claim.good]
        if any(name in claim.wires for claim in broken for name in (PRESSURE, SET)):
            refuse(self.table())

    def hanging(self) -> Check | None:
        """Lift the smallest load at the highest pressure, if the load before stayed down, to check the load cell.

        None if there is nothing to do or it was lifted; else a check that is not done.
        """
        weights, acquisition = self._mounted.bench_file.weights, self._executor.acquisition
        tried = {claim.row: claim.good for claim in self.wiring.claims(self.stages)}
        if weights is None or not weights.hanger or FORCE not in acquisition.latest or tried.get("load cell"):
            return None
        top = max(self.stages, key=lambda stage: stage.pressure)
        load = weights.hanger * weights.g
        put_on(self._executor, self._mounted, PHASE, weights.hanger)
        start = self.rest(load)[DISPLACEMENT].mean() if DISPLACEMENT in acquisition.latest else 0.0
        series = self._go(top.pressure)
        self._go(0.0)
        if DISPLACEMENT in series and series[DISPLACEMENT].mean(0.2 * self._test.settle) - start > LIFTED:
            return None
        why = f"at {show(top.pressure, 'pressure')} the hanger alone, {show(load, 'force', 3)}, stays on its support"
        return Check("load cell", "", "", NOT_CHECKED, f"no independent reference: {why}")

    def _linearity(self, stages: list[Stage]) -> Check:
        """Largest deviation of the measured pressure from its command, and from a straight line."""
        commanded = np.array([stage.pressure for stage in stages])
        measured = np.array([stage.means[PRESSURE] for stage in stages])
        measured = measured - measured[0]
        top = float(commanded.max())
        off = measured - commanded
        worst = int(np.abs(off).argmax())
        most, at = show(float(off[worst]), "pressure", 3), show(float(commanded[worst]), "pressure", 4)
        slope = float(commanded @ measured / (commanded @ commanded))
        bend = 100 * float(np.abs(measured - slope * commanded).max()) / top
        count = len(self._test.points)
        ways = 100 * float(np.abs(measured[1:count] - measured[count + 1 : -1][::-1]).max(initial=0.0)) / top
        limit = self.wiring.follows_within()
        return judged(
            "regulator, steady",
            f"{most} off at {at}; slope {slope:.4f}, linearity {bend:.2g} %, hysteresis {ways:.2g} %",
            f"at most {show(limit, 'pressure', 3)} off",
            good=abs(float(off[worst])) <= limit,
            hint="a leak, too little supply, or a regulator that does not follow downwards",
        )

    def _response(self) -> Iterator[Check]:
        """One full step up and down."""
        top = self._test.points[-1]
        noise = self.wiring.noise[PRESSURE]
        before = self.stages[-1].means[PRESSURE]
        at = self._executor.clock.now()
        up = self._go(top)
        down = self._go(0.0)
        response = step_response(up["pressure"], at, before, noise)
        never = f"not within {self._test.settle:g} s"

        def time(value: float | None) -> str:
            return never if value is None else f"{value:.3f} s"

        most = (self._mounted.bench_file.air.overshoot or self._test.linearity * top) + SIGNIFICANT * noise
        look = "look at the regulator's supply, at its settings and at the length of its hose"
        too_far = "the regulator overshoots more than the bench file says: the trip limit may be too near"
        begun, rise, settling, over = response.dead_time, response.rise, response.settling, response.overshoot
        reached, within = f"{time(begun)} (to 5 %), {time(rise)} (10 to 90 %)", f"within {self._test.settle:g} s"
        at_most = f"at most {show(most, 'pressure', 3)}"
        for name, value, limit, good, hint in (
            ("dead time, rise", reached, "both within the hold", None not in (begun, rise), look),
            ("settling", f"{time(settling)} (within 5 %)", within, settling is not None, look),
            ("overshoot", show(over, "pressure", 3), at_most, over <= most, too_far),
        ):
            yield judged(f"step to {show(top, 'pressure', 4)}: {name}", value, limit, good=good, hint=hint)
        yield from self._supply_in_fill()
        yield self._alignment(up, down)

    def _supply_in_fill(self) -> Iterator[Check]:
        if not np.isfinite(self._supply):
            return
        least = max(self._test.points) + SUPPLY_MARGIN
        yield judged(
            "supply while filling",
            f"lowest {show(self._supply, 'pressure', 4)}",
            f"at least {show(least, 'pressure', 4)}",
            good=self._supply >= least,
            hint="the supply breaks down when the muscle fills: look at its hose, filter and reservoir",
        )

    def _alignment(self, up: Mapping[str, Series], down: Mapping[str, Series]) -> Check:
        name = "time of force against pressure"
        top, rest = self.stages[-2].means, self.stages[-3].means
        rises = {one: self.wiring.change(one, top[one] - rest[one]) for one in (FORCE, DISPLACEMENT) if one in top}
        if not rises.get(FORCE) or rises.get(DISPLACEMENT):
            return Check(name, "", "", NOT_MEASURED, "needs a force that rises without a motion: a load on its support")
        found = delay((up[PRESSURE], down[PRESSURE]), (up[FORCE], down[FORCE]))
        if found is None:
            return Check(name, "", "", NOT_MEASURED, "the force did not go up and down with the pressure")
        return judged(
            name,
            f"{1e3 * found:+.1f} ms",
            f"within {1e3 * self._test.alignment:g} ms",
            good=abs(found) <= self._test.alignment,
            hint="the streams are not in time with each other: look at filters and rates of "
            f"{self.wiring.input(FORCE, PRESSURE)}",
        )
