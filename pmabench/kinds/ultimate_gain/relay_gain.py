"""K_u and T_u of relay tests, by set-point: the fitted loop first, then the describing function.

Neither is reported where friction shows. Knows the trials' samples and what the relay wrote down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, isfinite, sqrt

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain.relay_levels import RUBS, RelayFound, RelayLevel, examine, search_of
from pmabench.kinds.ultimate_gain.ways import DESCRIBED, SYMBOLS, GainCell, repeats
from pmabench.model.loop import Loop, ultimate
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace
from pmabench.store.records import RunData, TrialData

FITTED = "relay-fit"
OF_FRICTION, OF_SHAPE, OF_SIZES = 2.0, 0.5, 1.3
"""What K_u and T_u may be off, over friction as a share of the amplitude, over the distance of the third harmonic, and
over their change between the amplitudes: play, a second lag and a slew of the regulator make less of known loops."""
FORM = {"K_u": 0.012, "T_u": 0.0045}
"""Half width, over the value, of what the form of the fitted loop is worth with damping alike in both directions."""
UNLIKE = {"K_u": 0.08, "T_u": 0.035}
"""The same by damping that is not, per difference of the two lags over their sum.

Both so that 95 % of 200 simulated tests hold, without friction: two muscles at 12 to 50 mm, masses of 2 to 13 kg, dead
times of 20 to 60 ms, lags of 50 to 250 ms, amplitudes of 10 to 60 kPa. The largest errors are 2.5 % and 1.0 %.
"""


@dataclass(frozen=True)
class RelayCell(GainCell[RelayFound]):
    """All relay trials at one operating point."""

    called = "relay trials"

    @property
    def loop(self) -> Loop | None:
        """The loop fitted to the largest oscillation of the first trial that has one."""
        best = [self.found[i].best for i in self.good]
        return next((level.loop for level in best if level is not None and level.loop is not None), None)

    @cached_property
    def estimates(self) -> list[Estimate]:
        """K_u and T_u by the fit, then by the describing function."""
        return [*_estimates(self, FITTED), *_estimates(self, DESCRIBED)]

    def findings(self) -> list[Finding]:
        """What speaks against the trials, and what the fitted loop is."""
        lines, loop = self.said(), self.loop
        if loop is None:
            return lines
        lags = " and ".join(f"{complex(lag).real:.3g} s" for lag in loop.lags)
        truth = ultimate(loop)
        text = (
            f"at {self.where} the loop fitted to the relay oscillation has {loop.gain * 1e6:.4g} mm/kPa, dead time "
            f"{loop.dead_time * 1e3:.3g} ms (half a sample period in it) and lags {lags}: it would oscillate at "
            f"K_u = {show(truth.gain, 'gain', 4)}, T_u = {truth.period:.4g} s"
        )
        lines.append(Finding("note", text))
        best = [level for i in self.good if (level := self.found[i].best) is not None]
        if static := [level.static for level in best if isfinite(level.static)]:
            text = (
                f"at {self.where} the means of the asymmetric oscillation give a static gain of "
                f"{np.mean(static) * 1e6:.4g} mm/kPa; damping that changes with the pressure shifts it"
            )
            lines.append(Finding("note", text))
        return lines

    def traces(self) -> list[Trace]:
        """Displacement and command over the last periods of the largest oscillation."""
        trial, best = self.trials[self.shown], self.found[self.shown].best
        if best is None:
            return []
        begin = max(best.t0, best.t1 - 4 * best.period)
        mask = (trial.t >= begin) & (trial.t <= best.t1)
        names = [name for name in ("displacement", "pressure", "pressure_command") if name in trial.channels]
        columns = {"t": trial.t[mask] - begin, **{name: trial.channels[name][mask] for name in names}}
        marks = {"centre": float((search_of(trial) or {}).get("centre", 0.0)), "hysteresis": best.hysteresis}
        return [self.trace("relay", f"Relay oscillation, {show(best.amplitude, 'pressure')}", columns, marks)]


def cells(members: Sequence[tuple[RunData, TrialData]]) -> list[RelayCell]:
    """The trials by operating point, each examined."""
    return RelayCell.all_of(members, lambda run, trial: examine(run, trial, search_of(trial) or {}))


def _values(level: RelayLevel, symbol: str, method: str) -> tuple[float, float]:
    """Value and half width from the scatter between periods, of one level."""
    names = {
        ("K_u", FITTED): ("K_u", "half_K_u"),
        ("T_u", FITTED): ("T_u", "half_T_u"),
        ("K_u", DESCRIBED): ("K_df", "half_K_df"),
        ("T_u", DESCRIBED): ("period", "half_period"),
    }[symbol, method]
    return getattr(level, names[0]), getattr(level, names[1])


def _estimates(cell: RelayCell, method: str) -> list[Estimate]:
    scales = Scales.of(cell.runs)
    pressure = "pressure_command" if method == DESCRIBED and "pressure_command" in scales.gains else "pressure"
    found = []
    for symbol, unit, quantity in SYMBOLS:
        best = [(i, level) for i in cell.good if (level := cell.found[i].best) is not None]
        best = [(i, level) for i, level in best if isfinite(_values(level, symbol, method)[0])]
        if not best:
            reasons = dict.fromkeys(reason for trial in cell.found for reason in (*trial.refused, *trial.doubts))
            found.append(replace(cell.empty(symbol, unit, quantity, method), note="; ".join(reasons)))
            continue
        values, halves = np.array([_values(level, symbol, method) for _, level in best]).T
        value = float(values.mean())
        scaled = (pressure, "displacement") if symbol == "K_u" else ()
        estimate = replace(
            cell.empty(symbol, unit, quantity, method),
            value=value,
            parts=Parts(
                repeats=repeats(values, halves),
                method=_method_part(cell, best, symbol, method),
                calibration=scales.part(dict.fromkeys(scaled, value)),
            ),
            n=len(best),
            note=sentences(
                *(doubt for i, _ in best for doubt in cell.found[i].doubts),
                "one trial: the repeats part is the scatter between its periods" if len(best) == 1 else "",
                "the relay's harmonics and its hysteresis are left out; the method part is the distance to the fit"
                if method == DESCRIBED
                else "the method part is the difference between the amplitudes, and what the loop's form is worth",
                scales.lack(scaled),
            ),
            trials=tuple(cell.trials[i].name for i, _ in best),
        )
        found.append(
            weighed(estimate, _doubts([cell.found[i] for i, _ in best], value)) if method == FITTED else estimate
        )
    return found


def _doubts(trials: Sequence[RelayFound], value: float) -> list[Doubt]:
    """What friction or play in the balance of pressures, and another form of the loop, are worth of a value.

    Friction is alike at all amplitudes: what a bend makes of it at the largest one alone does not count.
    """
    rubs, shape = 0.0, 0.0
    for trial in trials:
        known = [level for level in trial.levels if isfinite(level.coulomb)]
        least = min((level.coulomb for level in known), default=0.0)
        rubs = max(rubs, least / max((level.amplitude for level in known), default=1.0))
        if trial.best is not None and isfinite(trial.best.shape):
            shape = max(shape, trial.best.shape)
    reason = (
        f"dry friction or play takes {rubs:.1%} of the relay's amplitude, at most {RUBS:.1%} is accepted: the loop is "
        "not linear. Take a larger amplitude"
    )
    return [
        Doubt("friction in the balance", "method", OF_FRICTION * rubs * value, rubs > RUBS, reason),
        Doubt("form of the loop", "method", OF_SHAPE * shape * value, seen=False),
    ]


def _method_part(cell: RelayCell, best: Sequence[tuple[int, RelayLevel]], symbol: str, method: str) -> float | None:
    """Half width by the method: the other amplitudes for the fit, the fit for the describing function; clocks added."""
    apart = []
    for i, level in best:
        value = _values(level, symbol, method)[0]
        if method == DESCRIBED:
            others = [_values(level, symbol, FITTED)[0]]
        else:
            others = [_values(other, symbol, method)[0] for other in cell.found[i].levels if other is not level]
        apart += [abs(value - other) for other in others if isfinite(other)]
    if not apart:
        return None
    form = max(
        hypot(FORM[symbol], UNLIKE[symbol] * min(1.0, level.unlike if isfinite(level.unlike) else 0.0))
        * _values(level, symbol, method)[0]
        for _, level in best
    )
    late, shift = cell.apart, 0.0
    if late > 0 and cell.loop is not None:
        name = "gain" if symbol == "K_u" else "period"
        later = ultimate(replace(cell.loop, dead_time=cell.loop.dead_time + late))
        shift = abs(getattr(later, name) - getattr(ultimate(cell.loop), name))
    return sqrt((OF_SIZES * max(apart)) ** 2 + shift**2 + form**2)
