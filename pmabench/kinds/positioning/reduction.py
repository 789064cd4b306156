"""Reduction of positioning runs: each set-point's response, steady-state error and limit cycle; the same simulated.

Measures of one hold are in `analysis.shared.signals`, the simulated loop in `analysis.shared.simulated`; trials along
a path: how well it was followed, overall and at each place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import HYSTERESIS, Scales, changes, of_one_channel, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import NotUsable, count_of, fresh, lag_of, noise_of, sticks
from pmabench.analysis.shared.signals import SMALLEST, SURE, Response, Smooth, respond, smooth, without_spikes
from pmabench.analysis.shared.simulated import closed_loop, model_of
from pmabench.analysis.shared.skew import late
from pmabench.analysis.shared.trials import Reduction, grouped, mean_of_trials, point_of, thinned
from pmabench.base.quantities import show
from pmabench.kinds.positioning import RESULTS
from pmabench.model.pid import ReferencePath
from pmabench.model.presets import Described
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

KIND = "positioning"
METHOD = "closed-loop"
SIMULATION = "closed-loop, simulated"
LENGTHS = dict.fromkeys(("setpoint", "displacement", "model"), "length")
QUANTITIES = {"t": "time", **LENGTHS, "pressure_command": "pressure"}
"""Column of a trace -> its quantity."""
EARLY = 4.0
"""Up to this time [s] half of a trace's points are placed."""
BAND = 0.02
"""Settling band where the plan gives none."""
MEASURES = {
    "e_ss": (("1", "ratio"), "error"),
    "OS": (("1", "ratio"), "overshoot"),
    "t_r": (("s", "time"), "rise"),
    "t_s": (("s", "time"), "settling"),
    "IAE": (("m.s", ""), "IAE"),
    "x_pp": (("m", "length"), "size"),
    "T_c": (("s", "time"), "period"),
}
"""Symbol -> unit and quantity, and field of `Response`, or of its cycle, and of what is unsure of both."""
NOT_RISEN = "it does not come to 90 % of the set-point"
NONE = {"t_s": "it does not stay in the band"}
"""Why there is no value of a measure."""
NEAR_ULTIMATE = "; the gain is near or above the ultimate one"
CYCLE = ("x_pp", "T_c")
"""Measures that only a limit cycle has."""


@dataclass(frozen=True, eq=False)
class Hold:
    """One usable trial."""

    run: RunData
    trial: TrialData
    law: Mapping[str, Any]
    response: Response
    values: Mapping[str, float | None]
    """Each measure; None where there is none."""
    unsure: Mapping[str, float]
    """Half width of each due to sampling, noise, the choice of a band and the timing of the displacement."""
    calibration: Mapping[str, float] | None
    """Half width of each measure due to the scale of the displacement; None where it is unknown."""
    origin: float
    """Position at rest before the step [m]."""
    t: Array
    x: Array
    simulated: Array | None
    """Contraction of the simulated loop [m], shape (n,) as `t` [s from the step]."""

    @property
    def setpoint(self) -> float:
        """Set-point of the hold [m]."""
        return float(self.law["setpoint"])


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Steady-state error e_ss (mean of set-point minus x in the window, over the set-point), overshoot OS, rise time
    t_r (10 to 90 %), settling time t_s, integral of the absolute error IAE, and peak to peak x_pp and period T_c of
    the limit cycle of every set-point (paper 0, control).

    Where the plan carries a model, the same loop is simulated around it, and e_sim is the rms difference of the two
    contractions [m]. Trials along a path are reduced by `along_paths`.
    """
    runs, spikes = without_spikes(runs)
    models = {run.id: model_of(run) for run in runs}
    result = Reduction.of(KIND, RESULTS, runs, options, lambda run, trial, _: measured(run, trial, models[run.id]))
    along = [one for one in result.measured if isinstance(one, Tracked)]
    holds = [one for one in result.measured if isinstance(one, Hold)]
    cells = sorted(grouped(holds, lambda hold: point_of(hold.trial)).items())
    model = next((one for one in models.values() if one is not None), None)
    for at, members in cells:
        result.estimates += _estimates(dict(at), members)
        result.traces.append(_trace(members[0]))
    if ordered := [hold for _, members in cells for hold in members]:
        result.findings += _findings(runs, ordered, model)
    result.add(*along_paths(along))
    result.findings += spikes
    return result.analysis(
        cells=len(cells),
        model=None if model is None else model.source,
        controllers=[_controller(members[0]) for _, members in cells],
    )


def measured(run: RunData, trial: TrialData, model: Described | None = None) -> Hold | Tracked:
    """Evaluation of a trial; a hold is also simulated if there is a model; raises `NotUsable`."""
    law = trial.found.get("position") or {}
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    if law.get("ended") != "time" or CHANNEL not in trial.channels:
        raise NotUsable(str(law.get("reason") or "no closed loop is recorded to its end"))
    return tracked(run, trial, law) if law.get("path") else _held(run, trial, law, model)


def _held(run: RunData, trial: TrialData, law: Mapping[str, Any], model: Described | None) -> Hold:
    settings = run.plan.get("settings") or {}
    begin, setpoint = float(law["t0"]), float(law["setpoint"])
    rest, ok = rows_of(trial, law)
    t, x = trial.t[ok] - begin, trial.channels[CHANNEL][ok]
    low, high = settings.get("window") or (0.5 * (float(law["t1"]) - begin), float(law["t1"]) - begin)
    window, band, lag = (float(low), float(high)), float(settings.get("band", BAND)), lag_of(run, CHANNEL)
    origin = float(trial.channels[CHANNEL][rest].mean()) if rest.any() else 0.0

    resolution = _resolution(run, trial)

    def respond_to(values: Array, lag: float) -> Response:
        return respond(t, values, setpoint, window, band, origin=origin, resolution=resolution, lag=lag)

    def scaled(more: float, gain: float) -> dict[str, float | None]:
        return _values(respond_to(x * (1 + gain) + more, lag), setpoint)

    try:
        response = respond_to(x, lag)
        values = _values(response, setpoint)
        in_time = changes(values, _values(respond_to(x, lag + late(run, CHANNEL)), setpoint))
        calibration = of_one_channel(scaled, values, Scales.of([run]), CHANNEL)
    except ValueError as reason:
        raise NotUsable(str(reason)) from None
    # e_ss: only motion in the window, which is evaluated for all trials together
    seen = {symbol: getattr(response.unsure, field) for symbol, (_, field) in MEASURES.items()} | {"e_ss": 0.0}
    unsure = {symbol: hypot(seen[symbol], in_time[symbol]) for symbol in MEASURES}
    simulated = None if model is None else closed_loop(model, trial, law, 1.0 / run.rate, origin).x[ok]
    return Hold(run, trial, law, response, values, unsure, calibration, origin, t, x, simulated)


def _resolution(run: RunData, trial: TrialData) -> float:
    """One count of the displacement [m], or the hysteresis of its sensor if the reading sticks."""
    most = 2 * HYSTERESIS * Scales.of([run]).offsets.get(CHANNEL, 0.0)
    shown = most if sticks(trial.channels[CHANNEL][trial.usable]) else 0.0
    return max(count_of(run, trial, CHANNEL), shown)


def _values(response: Response, setpoint: float) -> dict[str, float | None]:
    """All measures of a response."""
    of_cycle = {symbol: getattr(response.cycle, MEASURES[symbol][1], None) for symbol in CYCLE}
    found = {symbol: getattr(response, field) for symbol, (_, field) in MEASURES.items() if symbol not in CYCLE}
    return {**found, "e_ss": response.error / setpoint, **of_cycle}


def _steady(e: Estimate, members: Sequence[Hold]) -> Estimate:
    """The steady-state error with motion in the window in its interval.

    Where a significant motion may be larger than the error itself, a bound replaces the value, since not even the sign
    is known. Motion below the smallest cycle that counts is taken as rest.
    """
    worst = max(members, key=lambda hold: hold.response.unsure.error)
    half, seen = worst.response.unsure.error, any(hold.response.unsure.moves for hold in members)
    what = "it swings in the window, whose ends cut a cycle" if worst.response.cycle else "it moves in the window"
    text = f"{what}: the mean may be {show(half, 'length', 2)} off that of a steady state"
    reason = f"{text}. Hold longer, with a later window"
    moves = Doubt("motion in the window", "method", half / worst.setpoint, seen, reason)
    found = weighed(e, [moves], 1.0)
    if found.value is None or not seen or moves.half <= max(SMALLEST, abs(found.value)):
        return found
    most = abs(found.value) + hypot(*(part or 0.0 for part in vars(found.parts).values()))
    note = f"not more than {show(most, 'ratio', 3)} of the set-point either way: {reason}"
    return replace(found, value=None, parts=Parts(), budget=(), note=sentences(note, e.note), bound=most)


def _estimates(at: dict[str, float], members: Sequence[Hold]) -> list[Estimate]:
    names = tuple(hold.trial.name for hold in members)
    lacking = Scales.of([hold.run for hold in members]).lack((CHANNEL,), (CHANNEL,))
    found = []
    for symbol, (kind, _) in MEASURES.items():
        known = [(value, hold.calibration) for hold in members if (value := hold.values[symbol]) is not None]
        method = max(hold.unsure[symbol] for hold in members)
        scale = max((halves[symbol] for _, halves in known if halves is not None), default=None)
        if known:
            values = [value for value, _ in known]
            e = mean_of_trials(symbol, kind, METHOD, at, names, values, method, scale, ALONE, lacking)
            found.append(_steady(e, members) if symbol == "e_ss" else e)
        elif symbol not in CYCLE:
            note, parts = NONE.get(symbol, NOT_RISEN), Parts(None, method)
            found.append(Estimate(symbol, None, *kind, METHOD, at, parts, note=note, trials=names))
    apart = [
        smooth(h.t, h.x, lag_of(h.run, CHANNEL)).y - smooth(h.t, h.simulated).y
        for h in members
        if h.simulated is not None
    ]
    rms = [float(np.sqrt(np.mean(each**2))) for each in apart]
    if rms:
        found.append(Estimate("e_sim", float(np.mean(rms)), "m", "length", SIMULATION, at, n=len(rms), trials=names))
    return found


def _controller(hold: Hold) -> dict[str, Any]:
    """The settings of a set-point's loop, as plain data."""
    names = ("setpoint", "K_p", "T_i", "T_d", "N", "low", "high", "anti_windup", "tracking", "saturated")
    return {name: hold.law.get(name) for name in names}


def _findings(runs: Sequence[RunData], holds: Sequence[Hold], model: Described | None) -> list[Finding]:
    settings = runs[0].plan.get("settings") or {}
    worst = max(holds, key=_relative_error)
    window = settings.get("window")
    averaged = f"from {window[0]:g} s to {window[1]:g} s after the step" if window else "of the second half"
    text = (
        f"the steady-state error is at most {_relative_error(worst):.3g} % of the set-point at "
        f"{show(worst.setpoint, 'length')} ({show(worst.response.error, 'length', 3)} is the "
        f"mean {averaged}, and what moves in it is added)"
    )
    lines = [Finding("note", text), *_cycles(holds), *_rests(holds)]
    unsettled = [hold for hold in holds if hold.response.settling is None]
    if unsettled:
        band = 100 * float(settings.get("band", BAND))
        lines.append(Finding("doubt", f"not settled within {band:g} % of the step at {_places(unsettled)}"))
    if model is not None:
        friction = model.muscle.friction
        text = f"simulated with: {model.source}, friction {friction.F_s:g} N at rest and {friction.F_c:g} N moving"
        if model.regulator.dead_time == 0 and model.regulator.lag == 0:
            text += "; its regulator is given as exact, so that the simulated loop is quicker than a real one"
        lines.append(Finding("note", text))
    return lines


def _relative_error(hold: Hold) -> float:
    """Largest possible error [% of the set-point]: mean plus motion in the window."""
    return 100 * (abs(hold.response.error) + hold.response.unsure.error) / hold.setpoint


def _rests(holds: Sequence[Hold]) -> list[Finding]:
    """A note if it rested far from 0: the record cannot distinguish a muscle that rests there from a wrong zero."""
    zeros = [Scales.of([hold.run]).offsets.get(CHANNEL) for hold in holds]
    off = [abs(hold.origin) for hold, zero in zip(holds, zeros, strict=True) if zero and abs(hold.origin) > zero]
    if not off:
        return []
    known = show(max(zero for zero in zeros if zero), "length", 2)
    text = (
        f"before {len(off)} of {len(holds)} steps it rested up to {show(max(off), 'length', 2)} from 0, which is known"
    )
    text += f" to {known}: by friction, creep or its load, or the zero is off, and then as much is in e_ss, OS, t_s and"
    return [Finding("note", f"{text} IAE. Vent it, wait, and take the zero again to tell")]


def _cycles(holds: Sequence[Hold]) -> list[Finding]:
    """Limit cycles, their absence, and windows that are too short to decide."""
    lines = []
    hunting = [hold for hold in holds if hold.response.cycle is not None]
    for stuck, what in ((True, "stick-slip limit cycle"), (False, "sustained oscillation that does not stick")):
        mine = [hold for hold in hunting if hold.response.cycle is not None and hold.response.cycle.sticks == stuck]
        if mine:
            cycles = [cycle for hold in mine if (cycle := hold.response.cycle) is not None]
            size, period = max(one.size for one in cycles), max(one.period for one in cycles)
            most = f"{show(size, 'length', 3)} peak to peak, period {show(period, 'time', 3)} at most"
            lines.append(Finding("doubt", f"{what} at {_places(mine)}: {most}{'' if stuck else NEAR_ULTIMATE}"))
    still = [hold for hold in holds if hold.response.cycle is None]
    slow = [hold for hold in still if hold.response.wander > hold.response.smallest]
    quiet = [hold for hold in still if hold not in slow]
    if slow:
        most = show(max(hold.response.wander for hold in slow), "length", 3)
        text = f"at {_places(slow)} it moves by up to {most} in the window without two whole cycles: a slow limit"
        lines.append(Finding("doubt", f"{text} cycle, a creep or a drift; a longer hold tells"))
    if quiet:
        least = show(max(hold.response.smallest for hold in quiet), "length", 2)
        lines.append(Finding("note", f"no limit cycle at {_places(quiet)}: one of {least} peak to peak would be seen"))
    return lines


def _places(holds: Sequence[Hold]) -> str:
    """Set-points in words, without duplicates."""
    points = sorted({hold.setpoint for hold in holds})
    if len(points) <= 4:
        return ", ".join(show(x, "length") for x in points)
    return f"{len(points)} set-points from {show(points[0], 'length')} to {show(points[-1], 'length')}"


def _trace(hold: Hold) -> Trace:
    """Set-point, measured and simulated contraction, and the command, of one hold."""
    setpoint, begin, trial = hold.setpoint, float(hold.law["t0"]), hold.trial
    rest, _ = rows_of(trial, hold.law)
    before = trial.t[rest] - begin
    t = np.concatenate((before, hold.t))
    columns = {
        "t": t,
        "setpoint": np.where(t < -1e-6, hold.origin, setpoint),
        "displacement": np.concatenate((trial.channels[CHANNEL][rest], hold.x)),
    }
    if hold.simulated is not None:
        columns["model"] = np.concatenate((np.full(len(before), hold.origin), hold.simulated))
    if "pressure_command" in trial.channels:
        columns["pressure_command"] = np.interp(t + begin, trial.t, trial.channels["pressure_command"])
    early = t < EARLY
    rows = np.concatenate(
        [part[:: max(1, -(-2 * len(part) // LONGEST_TRACE))] for part in map(np.flatnonzero, (early, ~early))]
    )
    marks = {"setpoint": setpoint, "window": float((hold.run.plan.get("settings") or {}).get("window", (0.0,))[0])}
    load = trial.point.get("load", 0.0)
    where = show(setpoint, "length") + (f", {show(load, 'force')}" if load else "")
    thinned = {name: column[rows] for name, column in columns.items()}
    name, title = f"position-{setpoint * 1e3:g}-{load:g}", f"{where}: position in closed loop"
    return Trace(name, "position", title, thinned, QUANTITIES, marks)


CHANNEL = "displacement"
ALONE = "one run: no repeats part"
LONGEST_TRACE = 4000
ALONE_METHOD, AHEAD = "along a path", "along a path, with feed-forward"
FEWEST_ON_PATH = 50
"""Fewest samples of a path."""
OF_PATHS = {"e_rms": ("m", "length"), "e_max": ("m", "length"), "OS": ("1", "ratio")}
"""Symbol -> unit and quantity."""


def rows_of(trial: TrialData, law: Mapping[str, Any]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The usable samples before the loop began, and those of the loop; of a polled displacement those that are new."""
    x = trial.channels[CHANNEL]
    known = np.asarray(trial.usable & np.isfinite(x) & fresh(x))
    before, over = trial.t < float(law["t0"]) - 1e-6, trial.t > float(law["t1"]) + 1e-6
    return known & before, known & ~before & ~over


@dataclass(frozen=True, eq=False)
class Tracked:
    """One trial along a path; arrays of shape (n,) over `t` [s from the first sample of the loop]."""

    run: RunData
    trial: TrialData
    path: ReferencePath
    method: str
    """`AHEAD` with feed-forward, else `ALONE_METHOD`."""
    t: Array
    wanted: Array
    x: Array
    """As read [m]."""

    def values(self, more: float = 0.0, gain: float = 0.0, later: float = 0.0) -> dict[str, float]:
        """Each measure, for a displacement `more` [m] and a share `gain` larger, from a sensor `later` [s]."""
        x = smooth(self.t, self.x * (1 + gain) + more, lag_of(self.run, CHANNEL) + later)
        noise, errors = noise_of(self.x), (x.against(self.wanted, sign) for sign in (1.0, -1.0))
        return {
            "e_rms": sqrt(max(0.0, float(np.mean((x.y - self.wanted) ** 2)) - (x.gain * noise) ** 2)),
            "e_max": max(error.peak(noise) for error in errors),
            "OS": max(self._overshoots(x, noise), default=0.0),
        }

    def _overshoots(self, x: Smooth, noise: float) -> list[float]:
        """Overshoot of each move beyond its place until the next one starts, relative to the move; 0 if it does not
        overshoot.
        """
        found = []
        ends = [*self.path.starts[1:], np.inf]
        moves = zip(self.path.places, self.path.places[1:], self.path.starts, ends, strict=False)
        for before, place, start, end in moves:
            inside = (self.t >= start) & (self.t < end)
            way = place - before
            if inside.any() and way:
                beyond = x.part(inside).against(place, np.sign(way)).peak(noise)
                found.append(max(0.0, beyond / abs(way)))
        return found

    def unsure(self) -> dict[str, float]:
        """Half width of each measure due to noise, counts and the timing of the displacement."""
        in_time = changes(self.values(), self.values(later=late(self.run, CHANNEL)))
        ways = np.abs(np.diff(self.path.places))
        rest = SURE * noise_of(self.x) * smooth(self.t, self.x, lag_of(self.run, CHANNEL)).gain
        rest += 0.5 * count_of(self.run, self.trial, CHANNEL)
        peaks = {"e_rms": 0.0, "e_max": rest, "OS": rest / float(ways[ways > 0].min(initial=np.inf))}
        return {name: hypot(peaks[name], in_time[name]) for name in peaks}


def tracked(run: RunData, trial: TrialData, law: Mapping[str, Any]) -> Tracked:
    """A trial along a path; raises `NotUsable`."""
    _, ok = rows_of(trial, law)
    if ok.sum() < FEWEST_ON_PATH:
        raise NotUsable(f"fewer than {FEWEST_ON_PATH} samples of the path can be used")
    path, t = ReferencePath(**law["path"]), trial.t[ok] - float(law["t0"])
    wanted = np.array([path.place(float(now)) for now in t])
    method = AHEAD if law.get("feedforward") else ALONE_METHOD
    return Tracked(run, trial, path, method, t, wanted, trial.channels[CHANNEL][ok])


def _of_paths(members: Sequence[Tracked]) -> list[Estimate]:
    """Root mean square and largest error [m], and the largest overshoot over its move [1], of one operating point."""
    scales = Scales.of([one.run for one in members])
    each, unsure = [one.values() for one in members], [one.unsure() for one in members]
    # an overshoot cannot be negative, so half the difference between both ends would be too small
    by_scale = of_one_channel(members[0].values, each[0], scales, CHANNEL)
    method, at, names = members[0].method, dict(members[0].trial.point), tuple(one.trial.name for one in members)
    lacking = scales.lack((CHANNEL,), (CHANNEL,))
    found = []
    for symbol, kind in OF_PATHS.items():
        values, open_ = ([one[symbol] for one in several] for several in (each, unsure))
        scale = None if by_scale is None else by_scale[symbol]
        found.append(mean_of_trials(symbol, kind, method, at, names, values, max(open_), scale, ALONE, lacking))
    return found


def _off_paths(cells: Sequence[Sequence[Tracked]]) -> list[Finding]:
    """The errors, one sentence for each way of controlling."""
    lines = []
    for method in dict.fromkeys(members[0].method for members in cells):
        mine = [one.values() for members in cells if members[0].method == method for one in members]
        rms, most, over = (max(one[name] for one in mine) for name in ("e_rms", "e_max", "OS"))
        text = f"{method}: off by at most {show(most, 'length', 3)}, {show(rms, 'length', 3)} rms"
        lines.append(Finding("note", f"{text}; overshoot {100 * over:.2g} % of the move"))
    return lines


def _path_trace(one: Tracked) -> Trace:
    """The path and where the muscle was."""
    setpoint, load = one.trial.point.get("setpoint", 0.0), one.trial.point.get("load", 0.0)
    columns = {"t": one.t, "displacement": one.x, "model": one.wanted}
    if "pressure_command" in one.trial.channels:
        begin = float(one.trial.found["position"]["t0"])
        columns["pressure_command"] = np.interp(one.t + begin, one.trial.t, one.trial.channels["pressure_command"])
    return Trace(
        f"path-{setpoint * 1e3:g}-{load:g}{'-ahead' if one.method == AHEAD else ''}",
        "path",
        f"{show(setpoint, 'length')}, {show(load, 'force')}: {one.method}",
        thinned(columns, LONGEST_TRACE),
        {"t": "time", "displacement": "length", "model": "length", "pressure_command": "pressure"},
        {"setpoint": setpoint},
    )


def along_paths(trials: Sequence[Tracked]) -> tuple[list[Estimate], list[Finding], list[Trace]]:
    """All trials along paths."""
    cells = grouped(trials, lambda one: (one.method, one.path.places, tuple(one.path.times), point_of(one.trial)))
    every = list(cells.values())
    found = [estimate for members in every for estimate in _of_paths(members)]
    return found, _off_paths(every), [_path_trace(members[0]) for members in every]
