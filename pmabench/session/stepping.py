"""The first pressure of a session, in small steps: who follows, which way, how well; then one whole step.

Each pressure is held, and the next one follows only when the pressure channel has risen as it should.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord
from pmabench.bench.session import SelfTest
from pmabench.bench.trips import SUPPLY_MARGIN
from pmabench.engine.executor import Executor
from pmabench.protocol.plan import Set
from pmabench.session.checks import NOT_MEASURED, Check, judged, refuse
from pmabench.session.listening import Series, listen
from pmabench.session.response import delay, step_response

FOLLOWS = 0.3
"""Share of a step by which a channel must change to count as following it."""
SIGNIFICANT = 5.0
"""A change counts when it is so many times the rms noise."""
MOVED = 0.5e-3
"""Displacement that counts as a motion [m]."""
PHASE = "self-test"


@dataclass
class Levels:
    """What every channel read at each commanded pressure [Pa], up and down, in the order in which it was commanded."""

    commanded: list[float] = field(default_factory=list)
    means: list[dict[str, float]] = field(default_factory=list)
    supply: float = np.inf
    """Lowest supply seen [Pa]."""

    def add(self, commanded: float, series: Mapping[str, Series]) -> None:
        """The end of a hold."""
        self.commanded.append(commanded)
        self.means.append({name: one.mean(0.2 * (one.t[-1] - one.t[0])) for name, one in series.items()})
        if "supply" in series:
            self.supply = min(self.supply, float(series["supply"].y.min()))

    def rise(self, name: str) -> float:
        """From the first to the highest pressure."""
        top = int(np.argmax(self.commanded))
        return self.means[top][name] - self.means[0][name]


class Stepping:
    """Takes the pressure up and down, and judges what comes back."""

    def __init__(self, executor: Executor, mounted: Mounted, test: SelfTest, rest: Mapping[str, Series]) -> None:
        self._executor, self._mounted, self._test = executor, mounted, test
        self._channels = {channel.name: channel for channel in executor.bench.channels}
        self._noise = {name: series.reading().noise for name, series in rest.items()}
        self._levels = Levels()
        self._levels.add(0.0, rest)

    def run(self, checks: list[Check], load: float) -> None:
        """Add the checks of a bench that carries a load F_L = `load` [N]; ends before its time where one has failed."""
        points = self._test.points
        for number, pressure in enumerate(points):
            self._go(pressure)
            found = list(self._follows(pressure, number))
            checks += found if number == 0 or any(check.verdict != "ok" for check in found) else []
            refuse(checks)
        for pressure in (*reversed(points[:-1]), 0.0):
            self._go(pressure)
        checks += self._motion()
        checks.append(self._linearity())
        checks += self._response(load)

    def _go(self, pressure: float) -> Mapping[str, Series]:
        self._executor.do(Set(PHASE, "pressure", pressure))
        series = listen(self._executor.acquisition, self._test.settle)
        self._levels.add(pressure, series)
        return series

    def _where(self, *names: str) -> str:
        return " and ".join(f"{self._channels[name].device}.{self._channels[name].input}" for name in names)

    def _follows(self, commanded: float, number: int) -> Iterator[Check]:
        """Whether the pressure channel has risen with the command; if not, who has."""
        means, first = self._levels.means[-1], self._levels.means[0]
        rise = means["pressure"] - first["pressure"]
        name = f"pressure at {show(commanded, 'pressure', 4)}{'' if number else ', the first step'}"
        least = max(FOLLOWS * commanded, SIGNIFICANT * self._noise["pressure"])
        limit = f"rises by more than {show(least, 'pressure', 3)}"
        value = f"rises by {show(rise, 'pressure', 4)}"
        if rise < -least:
            value = f"falls by {show(-rise, 'pressure', 4)}"
            hint = f"the sign of the pressure is wrong: look at the wires of {self._where('pressure')}"
        else:
            other = self._carries_pressure(commanded)
            if other is not None:
                hint = (
                    f"{other} follows the pressure instead: the plugs of pressure and {other} are swapped "
                    f"({self._where('pressure', other)})"
                )
            else:
                hint = (
                    "the regulator does not follow its command, or its pressure is not seen: look at its supply and "
                    f"power, at the wire of its command ({self._output()}), at the wire {self._where('pressure')}"
                )
        yield judged(name, value, limit, good=rise > least, hint=hint)

    def _output(self) -> str:
        return next(
            f"{output.device}.{output.output}" for output in self._mounted.bench.outputs if output.name == "pressure"
        )

    def _carries_pressure(self, commanded: float) -> str | None:
        """A channel whose raw value, read with the scale of the pressure, has risen as was commanded."""
        scale = self._channels["pressure"].scale
        for name in ("force", "displacement"):
            if name in self._channels and name in self._levels.means[-1]:
                own = self._channels[name].scale
                ends = [
                    scale.to_si(own.to_raw(means[name])) for means in (self._levels.means[0], self._levels.means[-1])
                ]
                if abs(ends[1] - ends[0] - commanded) < FOLLOWS * commanded:
                    return name
        return None

    def _change(self, name: str) -> float | None:
        """By how much a channel rises up to the highest pressure [SI]; None where that is lost in the noise."""
        if name not in self._noise:
            return None
        rise = self._levels.rise(name)
        least = {"displacement": MOVED}.get(name, self._least_force())
        return rise if abs(rise) > max(least, SIGNIFICANT * self._noise[name]) else 0.0

    def _least_force(self) -> float:
        known = self._channels["force"].calibration if "force" in self._channels else None
        return known.offset_uncertainty if known is not None else 0.0

    def _motion(self) -> Iterator[Check]:
        """Force and displacement answer the pressure, upwards."""
        top = show(max(self._test.points), "pressure", 4)
        answers = {name: self._change(name) for name in ("force", "displacement")}
        seen = {name: change for name, change in answers.items() if change is not None}
        for name, change in seen.items():
            quantity = self._channels[name].quantity
            what = "force" if name == "force" else "contraction"
            value = f"{'rises' if change >= 0 else 'falls'} by {show(abs(change), quantity, 3)}" if change else "stays"
            hint = (
                f"the sign of the {what} is wrong: swap the wires of {self._where(name)}, "
                "or the ends of its calibration"
            )
            yield judged(f"{what} at {top}", value, "does not fall", good=change >= 0, hint=hint)
        force, moved = seen.get("force", 0.0), seen.get("displacement", 0.0)
        if seen and not force and not moved:
            yield judged(
                "answer of the muscle",
                f"neither {' nor '.join(seen)} changes at {top}",
                "one of them rises",
                good=False,
                hint=f"look at the hose to the muscle and at the wires {self._where(*seen)}; or test higher",
            )
        free = self._mounted.bench.free_end == "weights" and self._executor.unloaded
        if free and force > 0 and not moved and len(seen) == 2:
            yield judged(
                "free end without a load",
                f"force rises by {show(force, 'force', 3)}, and nothing moves",
                "the free end moves",
                good=False,
                hint="the free end is held, or the plugs of force and displacement are swapped "
                f"({self._where('force', 'displacement')})",
            )

    def _linearity(self) -> Check:
        """Largest distance of the measured pressure from what was commanded, and from a straight line."""
        commanded = np.array(self._levels.commanded)
        measured = np.array([means["pressure"] for means in self._levels.means])
        measured = measured - measured[0]
        top = float(commanded.max())
        off = measured - commanded
        worst = int(np.abs(off).argmax())
        most, at = show(float(off[worst]), "pressure", 3), show(float(commanded[worst]), "pressure", 4)
        slope = float(commanded @ measured / (commanded @ commanded))
        bend = 100 * float(np.abs(measured - slope * commanded).max()) / top
        count = len(self._test.points)
        ways = 100 * float(np.abs(measured[1:count] - measured[count + 1 : -1][::-1]).max(initial=0.0)) / top
        limit = self._test.linearity * top + self._channels["pressure"].calibration.offset_uncertainty
        return judged(
            "regulator, steady",
            f"{most} off at {at}; slope {slope:.4f}, linearity {bend:.2g} %, hysteresis {ways:.2g} %",
            f"at most {show(limit, 'pressure', 3)} off",
            good=abs(float(off[worst])) <= limit,
            hint="a leak, too little supply, or a wrong calibration of the pressure channel or of the regulator "
            f"({self._where('pressure')}, {self._output()})",
        )

    def _response(self, load: float) -> Iterator[Check]:
        """One whole step up and down."""
        top = self._test.points[-1]
        noise = self._noise["pressure"]
        before = self._levels.means[-1]["pressure"]
        at = self._executor.clock.now()
        up = self._go(top)
        down = self._go(0.0)
        response = step_response(up["pressure"], at, before, noise)
        never = f"not within {self._test.settle:g} s"

        def time(value: float | None) -> str:
            return never if value is None else f"{value:.3f} s"

        overshoot = self._mounted.bench_file.air.overshoot
        most = overshoot + SIGNIFICANT * noise if overshoot else self._test.linearity * top + SIGNIFICANT * noise
        step = f"step to {show(top, 'pressure', 4)}"
        look = "look at the regulator's supply, at its settings and at the length of its hose"
        yield judged(
            f"{step}: dead time, rise",
            f"{time(response.dead_time)} (to 5 %), {time(response.rise)} (10 to 90 %)",
            "both within the hold",
            good=response.dead_time is not None and response.rise is not None,
            hint=look,
        )
        yield judged(
            f"{step}: settling",
            f"{time(response.settling)} (within 5 %)",
            f"within {self._test.settle:g} s",
            good=response.settling is not None,
            hint=look,
        )
        yield judged(
            f"{step}: overshoot",
            show(response.overshoot, "pressure", 3),
            f"at most {show(most, 'pressure', 3)}",
            good=response.overshoot <= most,
            hint="the regulator overshoots more than the bench file says: the trip limit may be too near",
        )
        yield from self._supply_in_fill()
        yield self._alignment(up, down)
        yield from self._load_cell(load)

    def _supply_in_fill(self) -> Iterator[Check]:
        if not np.isfinite(self._levels.supply):
            return
        least = max(self._test.points) + SUPPLY_MARGIN
        yield judged(
            "supply while filling",
            f"lowest {show(self._levels.supply, 'pressure', 4)}",
            f"at least {show(least, 'pressure', 4)}",
            good=self._levels.supply >= least,
            hint="the supply breaks down when the muscle fills: look at its hose, filter and reservoir",
        )

    def _alignment(self, up: Mapping[str, Series], down: Mapping[str, Series]) -> Check:
        name = "time of force against pressure"
        still = abs(self._change("displacement") or 0.0) == 0.0
        if not self._change("force") or not still:
            return Check(name, "", "", NOT_MEASURED, "needs a force that rises without a motion: a load on its support")
        found = delay((up["pressure"], down["pressure"]), (up["force"], down["force"]))
        if found is None:
            return Check(name, "", "", NOT_MEASURED, "the force did not go up and down with the pressure")
        return judged(
            name,
            f"{1e3 * found:+.1f} ms",
            f"within {1e3 * self._test.alignment:g} ms",
            good=abs(found) <= self._test.alignment,
            hint=f"the streams are not in time with each other: look at filters and rates of {self._where('force')} "
            f"and {self._where('pressure')}",
        )

    def _load_cell(self, load: float) -> Iterator[Check]:
        """The force of a load that hangs at the highest pressure."""
        if not load or "force" not in self._noise:
            return
        if (self._change("displacement") or 0.0) <= 2 * MOVED:
            told = "the load does not leave its support at this pressure"
            yield Check("load cell", "", "", NOT_MEASURED, told)
            return
        cell: ChannelRecord = self._channels["force"]
        measured = self._levels.rise("force")
        known = cell.calibration
        share = self._mounted.bench.load_tolerance
        limit = share * load + known.offset_uncertainty + known.gain_uncertainty * load
        yield judged(
            "load cell",
            f"{show(measured, 'force', 4)} for {show(load, 'force', 4)}",
            f"within {show(limit, 'force', 3)}",
            good=abs(measured - load) <= limit,
            hint=f"look at the plates that are on, and at the load cell ({self._where('force')})",
        )
