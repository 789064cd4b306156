"""Reduction of validation runs: measured contraction after a pressure step compared with that of a model.

Also the figure, and with `measure` the values of one trial for the display.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import (
    NotUsable,
    between_new,
    count_of,
    fresh,
    lags_of,
    noise_of,
    refuse_incomplete,
    unresolved,
)
from pmabench.analysis.shared.signals import smooth
from pmabench.analysis.shared.simulated import from_commanded_pressure, from_measured_pressure, load_of, model_of
from pmabench.analysis.shared.trials import Reduction, grouped, mean_of_trials, point_of, thinned
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.validation import RESULTS
from pmabench.model.presets import Described
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import Picture
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Trace
from pmabench.store.records import Array, Command, RunData, TrialData

KIND = "validation"
COMMANDED = "commanded pressure"
"""As in paper 0: the input of the simulation is the commanded pressure."""
MEASURED = "measured pressure"
"""The input of the simulation is the measured pressure, so that errors of the regulator are not attributed to the
model.
"""
METHODS = (COMMANDED, MEASURED)
ALONE = "one run: no repeats part"
NO_MODEL = "the plan holds no model to compare with"
ZEROS = "zeros and steps of the channels"
OTHER_LOAD = "force of the cell in place of the load"
NO_INTERVAL = "no interval: noise and errors of the channels are in it like those of the model"
CHANNELS = {"displacement": "length", "pressure": "pressure"}
"""Channel -> its quantity."""
SURE = 5.0
"""Standard errors from which on a reading at rest, or a motion in the window, is significant."""
WHY = {
    "displacement": "its zero is off, or friction, creep or a load hold the muscle. Vent, wait and take the zero",
    "pressure": "its zero is off, or the regulator does not vent. Vent the muscle and take the zero of the gauge",
}
MOVES = 5e-4
"""Motion in the window, as a share of the contraction, from which on it is reported."""
FEWEST = 8
"""Fewest samples of the window."""


@dataclass(frozen=True, eq=False)
class _Step:
    """One usable trial; contraction [m] over t [s from the step]."""

    run: RunData
    trial: TrialData
    t: Array
    x: Array
    simulated: Mapping[str, Array]
    measured: float
    """Mean in the window [m]."""
    window: Mapping[str, float]
    """Mean of each simulation in the window [m]."""
    moved: Mapping[str, float]
    """Possible change of simulated minus measured contraction in the window [m] by the zero of each channel, and by
    gain and offset of the pressure.
    """
    zeros: Mapping[str, float]
    """Channel -> reading before the step [SI]; 0 within calibration and noise."""
    pulls: float
    """Force in the window less the load [N]; 0 within calibration and noise, or without a force."""

    def error(self, method: str) -> float:
        """Simulated minus measured contraction in the window [m]."""
        return self.window[method] - self.measured


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Error of the model's contraction at each pressure (paper 0, validation): mean in the window, for two inputs.

    e_ss = (simulated - measured) / measured; e_fs is the same difference relative to the largest measured contraction
    of the runs; e_sim is the rms difference over the whole hold [m], including the rise. Windows come from the plan.
    Lags of sensors (`sensor_lag`, first order) are corrected.
    """
    models = {run.id: model_of(run) for run in runs}

    def usable(run: RunData, trial: TrialData, _: Mapping[str, Any]) -> tuple[RunData, TrialData]:
        refuse(run, trial)
        if models[run.id] is None:
            raise NotUsable(NO_MODEL)
        return run, trial

    result = Reduction.of(KIND, RESULTS, runs, options, usable)
    found: list[_Step] = []
    for run in runs:
        if (model := models[run.id]) is not None:
            found += _steps(run, [trial for one, trial in result.measured if one is run], model)
    cells = [(dict(at), steps) for at, steps in sorted(grouped(found, lambda step: point_of(step.trial)).items())]
    steps = [step for _, members in cells for step in members]
    full = max((step.measured for step in steps), default=0.0)
    for method in METHODS:
        for at, members in cells:
            result.estimates += _estimates(at, members, method, full)
    result.add((), _findings(runs, steps, full), (_trace(members[0]) for _, members in cells))
    source = next((model.source for model in models.values() if model is not None), None)
    window = list(_window(runs[0])) if runs else []
    return result.analysis(cells=len(cells), full_scale=full, window=window, model=source)


def _window(run: RunData) -> tuple[float, float]:
    low, high = (run.plan.get("settings") or {}).get("window") or (8.0, 10.0)
    return float(low), float(high)


def _begin(trial: TrialData) -> float | None:
    """When the pressure was commanded [s]."""
    command = _step_of_pressure(trial)
    return None if command is None else command.t


def _step_of_pressure(trial: TrialData) -> Command | None:
    return next((c for c in trial.commands if c.output == "pressure" and c.phase == "step"), None)


def inside_window(run: RunData, trial: TrialData) -> NDArray[np.bool_]:
    """The usable samples of the window."""
    low, high = _window(run)
    t = trial.t - (_begin(trial) or 0.0)
    return _usable(trial) & (t >= low) & (t <= high)


def _usable(trial: TrialData) -> NDArray[np.bool_]:
    both = np.isfinite(trial.channels["displacement"]) & np.isfinite(trial.channels["pressure"])
    return np.asarray(trial.usable & both)


def refuse(run: RunData, trial: TrialData) -> None:
    """Raise `NotUsable` for a trial that cannot be compared with any model."""
    refuse_incomplete(trial)
    if not {"pressure", "displacement"} <= set(trial.channels):
        raise NotUsable("pressure or displacement is not recorded")
    if _begin(trial) is None:
        raise NotUsable("no step of pressure is recorded")
    if inside_window(run, trial).sum() < FEWEST:
        low, high = _window(run)
        raise NotUsable(f"fewer than {FEWEST} usable samples from {low:g} s to {high:g} s after the step")
    if not mean_in_window(run, trial) > 0:
        raise NotUsable("it did not contract")


def _rest(trial: TrialData) -> float:
    """Rest position before the step [m], which friction makes depend on earlier motion."""
    before = _usable(trial) & (trial.t < (_begin(trial) or 0.0))
    return float(trial.channels["displacement"][before].mean()) if before.any() else 0.0


def _followed(run: RunData, trial: TrialData) -> TrialData:
    """The trial with the declared filters of its channels undone: for a reading y the input is y + lag y'.

    If they are read less often than recorded, the pressure is interpolated between new values, and the displacement is
    nan where it is not new.
    """
    channels, lags = dict(trial.channels), lags_of(run, trial)
    x = trial.channels["displacement"]
    channels["displacement"] = np.where(fresh(x), x, np.nan)
    channels["pressure"] = between_new(trial.t, trial.channels["pressure"])[0]
    for name in CHANNELS:
        if lags[name] > 0:
            y = channels[name].copy()
            ok = trial.usable & np.isfinite(y)
            y[ok] += smooth(trial.t[ok], y[ok], lags[name]).y - smooth(trial.t[ok], y[ok]).y
            channels[name] = y
    return replace(trial, channels=channels)


def _off_zero(run: RunData, trial: TrialData, channel: str) -> float:
    """Reading of a channel before a step from 0, if it exceeds calibration and noise [SI]; else 0."""
    command = _step_of_pressure(trial)
    if command is None or command.before > 0:
        return 0.0
    values = trial.channels[channel]
    new = trial.usable & np.isfinite(values) & fresh(values)
    y = values[new & (trial.t < command.t)]
    if not len(y):
        return 0.0
    by_noise = SURE * max(noise_of(values[new]), float(y.std())) / sqrt(len(y))
    size = float(y.mean())
    return size if abs(size) > max(Scales.of([run]).offsets.get(channel, 0.0), by_noise) else 0.0


LIGHT, LIGHTLY = 1.0, 0.02
"""Force [N], and share of the load, that friction of a guide and air make of a weight."""


def _pulls(run: RunData, trial: TrialData) -> float:
    """Mean force in the window less the load [N], if it exceeds what friction, calibration and noise make; else 0."""
    force = trial.channels.get("force")
    if force is None or "load" not in trial.point:
        return 0.0
    seen = force[inside_window(run, trial) & np.isfinite(force)]
    if len(seen) < FEWEST:
        return 0.0
    load, scales = load_of(trial)[0], Scales.of([run])
    known = scales.offsets.get("force", 0.0) + scales.gains.get("force", 0.0) * abs(load)
    least = known + LIGHT + LIGHTLY * load + SURE * noise_of(seen) / sqrt(len(seen))
    more = float(seen.mean()) - load
    return more if abs(more) > least else 0.0


def _coarse(run: RunData, trial: TrialData, channel: str, inside: NDArray[np.bool_]) -> float:
    """Error of a mean over the rows `inside` because a channel is read in steps [SI].

    Noise much smaller than a step does not average it out; and a converter that truncates reads half a step too low,
    unless it was calibrated to better than that.
    """
    step = count_of(run, trial, channel)
    if not 0 < step < inf:
        return 0.0
    cut = 0.5 * step if 0.5 * step > Scales.of([run]).offsets.get(channel, 0.0) else 0.0
    return cut + unresolved(trial.channels[channel][inside], step)


def _steps(run: RunData, recorded: Sequence[TrialData], model: Described) -> list[_Step]:
    """Usable trials with their simulations."""
    found = []
    trials = [_followed(run, trial) for trial in recorded]
    origins = [_rest(trial) for trial in trials]
    driven = from_measured_pressure(model, trials, 1.0 / run.rate, origins)
    zeros = [{name: _off_zero(run, trial, name) for name in CHANNELS} for trial in recorded]
    unsure = [_unsure(run, *pair) for pair in zip(recorded, zeros, strict=True)]
    changed = _by_pressure(run, trials, model, origins, [one["pressure"] for one in unsure])
    pulls = [_pulls(run, trial) for trial in recorded]
    if any(pulls):
        loaded = [
            replace(trial, point={**trial.point, "load": load_of(trial)[0] + more})
            for trial, more in zip(trials, pulls, strict=True)
        ]
        changed["load"] = from_measured_pressure(model, loaded, 1.0 / run.rate, origins)
    for place, (trial, by_measured, origin) in enumerate(zip(trials, driven, origins, strict=True)):
        ok, inside = _usable(trial), inside_window(run, trial)
        simulated = {COMMANDED: from_commanded_pressure(model, trial, origin), MEASURED: by_measured}
        means = {method: float(values[inside].mean()) for method, values in simulated.items()}
        x = trial.channels["displacement"]
        t = trial.t - (_begin(trial) or 0.0)
        models = {method: values[ok] for method, values in simulated.items()}
        moved = {name: float(values[place][inside].mean()) - means[MEASURED] for name, values in changed.items()}
        moved["displacement zero"] = unsure[place]["displacement"]
        measured = float(x[inside].mean())
        found.append(_Step(run, trial, t[ok], x[ok], models, measured, means, moved, zeros[place], pulls[place]))
    return found


def _unsure(run: RunData, trial: TrialData, zeros: Mapping[str, float]) -> dict[str, float]:
    """Error of each channel's mean in the window [SI] because of its zero, and because it is read in steps."""
    inside = inside_window(run, trial)
    return {name: max(abs(zeros[name]), _coarse(run, trial, name, inside)) for name in CHANNELS}


def _by_pressure(
    run: RunData, trials: Sequence[TrialData], model: Described, origins: Sequence[float], zeros: Sequence[float]
) -> dict[str, list[Array]]:
    """Simulations with the measured pressure, with its gain, offset or zero changed by its uncertainty.

    Keys as in `_Step.moved`; causes without any uncertainty are left out.
    """
    scales = Scales.of([run])
    gain, offset = scales.gains.get("pressure", 0.0), scales.offsets.get("pressure", 0.0)
    found: dict[str, list[Array]] = {}
    nothing = [0.0] * len(trials)
    causes = (("gain", gain, nothing), ("offset", 0.0, [offset] * len(trials)), ("zero", 0.0, zeros))
    for name, share, offsets in ((f"pressure {name}", share, offsets) for name, share, offsets in causes):
        if share or any(offsets):
            moved = [
                replace(one, channels={**one.channels, "pressure": one.channels["pressure"] * (1 + share) + more})
                for one, more in zip(trials, offsets, strict=True)
            ]
            found[name] = from_measured_pressure(model, moved, 1.0 / run.rate, origins)
    return found


def _estimates(at: dict[str, float], members: Sequence[_Step], method: str, full: float) -> list[Estimate]:
    scales = Scales.of([step.run for step in members])
    names = tuple(step.trial.name for step in members)
    channels = ("displacement",) if method == COMMANDED else ("displacement", "pressure")
    loads = [abs(step.moved.get("load", 0.0)) for step in members]
    causes = [n for n in members[0].moved if n.startswith(channels) and all(n in step.moved for step in members)]
    lacking = scales.lack(channels, channels)

    def share(symbol: str, values: list[float], by: float) -> Estimate:
        """Estimate of an error that is a ratio; an offset of the displacement changes it by `by` [1/m]."""
        part = scales.part({"displacement": 1.0}, {"displacement": by})
        scaled = [name for name in ("pressure gain", "pressure offset") if name in causes]
        others = [by * max(abs(step.moved[name]) for step in members) for name in scaled]
        part = part if part is None else hypot(part, *others)
        each = [max(abs(step.moved[name]) for step in members) for name in causes if name.endswith("zero")]
        e = mean_of_trials(symbol, ("1", "ratio"), method, at, names, values, None, part, ALONE, lacking)
        doubts = {ZEROS: hypot(*each)} | ({OTHER_LOAD: max(loads)} if any(loads) else {})
        return weighed(e, [Doubt(cause, "method", by * size, seen=False) for cause, size in doubts.items()])

    x = float(np.mean([step.measured for step in members]))
    e_sim = float(np.mean([_rms(step, method) for step in members]))
    return [
        share("e_ss", [step.error(method) / step.measured for step in members], 1 / x),
        share("e_fs", [step.error(method) / full for step in members], 1 / full),
        Estimate("e_sim", e_sim, "m", "length", method, at, n=len(members), note=NO_INTERVAL, trials=names),
    ]


def _rms(step: _Step, method: str) -> float:
    """Rms difference after the step, corrected for noise [m]."""
    after = step.t >= 0
    off = (step.simulated[method] - step.x)[after]
    return sqrt(max(0.0, float(np.mean(off**2)) - noise_of(step.x[after]) ** 2))


def _findings(runs: Sequence[RunData], steps: Sequence[_Step], full: float) -> list[Finding]:
    if not steps:
        return []
    window = _window(runs[0])
    lines = []
    for method in steps[0].window:
        worst = max(steps, key=lambda step: abs(step.error(method) / step.measured))
        off = 100 * abs(worst.error(method)) / worst.measured
        text = (
            f"{method}: the simulated contraction is off by at most {off:.2g} % of the measured one "
            f"({show(worst.error(method), 'length', 3)} at {show(worst.trial.point['pressure'], 'pressure')}; mean "
            f"from {window[0]:g} s to {window[1]:g} s after the step, over the measured contraction; full scale is "
            f"{show(full, 'length', 4)})"
        )
        lines.append(Finding("note", text))
    model = next(model for run in runs if (model := model_of(run)) is not None)
    low, high = model.domain
    outside = sorted({p for step in steps if not low <= (p := step.trial.point.get("pressure", low)) <= high})
    lines.append(Finding("note", f"simulated with: {model.source}"))
    if model.surface is not None:
        lines += _beyond(steps, *model.surface.reach)
    lines += [*_off_zero_findings(steps), *_of_loads(steps), *_moving(steps)]
    if outside:
        places = ", ".join(show(p, "pressure") for p in outside)
        lines.append(Finding("doubt", f"the coefficients are continued beyond what is known of them at {places}"))
    if any(step.trial.point.get("load", 0.0) == 0 for step in steps) and model.source.startswith("analysis"):
        lines.append(Finding("note", "without load: the model was identified under loads and is continued to 0 N"))
    return lines


def _moving(steps: Sequence[_Step]) -> list[Finding]:
    """A doubt where the measured contraction still moves in the window, and that by the commanded pressure does not."""
    found = []
    for step in steps:
        low, high = _window(step.run)
        inside = (step.t >= low) & (step.t <= high)
        t, off = step.t[inside], step.x[inside] - step.simulated[COMMANDED][inside]
        place = t - t.mean()
        moved = float(place @ off) / float(place @ place) * (high - low)
        error = noise_of(off) / sqrt(float(place @ place)) * (high - low)
        if abs(moved) > max(SURE * error, MOVES * step.measured):
            found.append(moved)
    if not found:
        return []
    text = f"in the window of {len(found)} of {len(steps)} steps the muscle moves by up to"
    text += (
        f" {show(max(found, key=abs), 'length', 2)} more than the model, by creep, a pressure that is not steady yet"
    )
    text += " or a drift of the sensor: e_ss is what it is there. Compare zeros, and hold longer"
    return [Finding("doubt", text)]


def _beyond(steps: Sequence[_Step], low: float, high: float) -> list[Finding]:
    """A doubt where the model is beyond the contractions [m] of its tests."""
    beyond = sorted({step.trial.point.get("pressure", 0.0) for step in steps if step.simulated[MEASURED].max() > high})
    if not beyond:
        return []
    places = ", ".join(show(P, "pressure") for P in beyond)
    reach = f"from {show(low, 'length')} to {show(high, 'length')}"
    return [Finding("doubt", f"the model was tested {reach}; it goes on beyond at {places}")]


def _off_zero_findings(steps: Sequence[_Step]) -> list[Finding]:
    """Doubts for channels that do not read 0 before the steps."""
    found = []
    for channel, quantity in CHANNELS.items():
        sizes = [size for step in steps if (size := step.zeros[channel])]
        if sizes:
            most = show(max(sizes, key=abs), quantity, 2)
            text = f"before {len(sizes)} of {len(steps)} steps the {channel} reads up to {most}, more than its"
            text += f" calibration and its noise allow: {WHY[channel]}. The intervals hold it"
            found.append(Finding("doubt", text))
    return found


def _of_loads(steps: Sequence[_Step]) -> list[Finding]:
    """A doubt where the force cell contradicts the load of the protocol."""
    pulled = [step for step in steps if step.pulls]
    if not pulled:
        return []
    worst = max(pulled, key=lambda step: abs(step.pulls))
    load = load_of(worst.trial)[0]
    text = (
        f"in the window of {len(pulled)} of {len(steps)} steps the force cell reads up to "
        f"{show(load + worst.pulls, 'force', 3)} where the protocol has a load of {show(load, 'force', 3)}: another "
        "load hangs, or the cell's zero is off. The model is simulated with the load of the protocol; the intervals "
        "hold what the cell reads"
    )
    return [Finding("doubt", text)]


def _trace(step: _Step) -> Trace:
    """Measured and simulated contraction of one step."""
    pressure = step.trial.point.get("pressure", 0.0)
    load = step.trial.point.get("load", 0.0)
    where = show(pressure, "pressure") + (f", {show(load, 'force')}" if load else "")
    columns = {"t": step.t, "displacement": step.x, "model": step.simulated[MEASURED]}
    columns["model, commanded pressure"] = step.simulated[COMMANDED]
    return Trace(
        f"validation-{pressure * 1e-3:g}-{load:g}",
        "validation",
        f"{where}: measured and simulated step",
        thinned(columns),
        {"t": "time", **dict.fromkeys(list(columns)[1:], "length")},
        {"pressure": pressure},
    )


def mean_in_window(run: RunData, trial: TrialData) -> float:
    """Mean contraction in the window [m]."""
    return float(trial.channels["displacement"][inside_window(run, trial)].mean())


def contraction_of(run: RunData, trial: TrialData) -> float:
    """The same of a trial that can be compared; else it raises `NotUsable`."""
    refuse(run, trial)
    return mean_in_window(run, trial)


MOST = 12
"""Most steps in a figure."""


def validations(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Measured and simulated contraction after each step of pressure."""
    model, title = "the model that the protocol names, driven by the measured pressure", "Measured and simulated steps"
    nothing = " It was fitted to nothing in this run."
    return overlays(traces, analysis, model, title, most=MOST, also=nothing, columns=())


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Contraction in the window, and the expected one from the specimen file."""
    try:
        x = contraction_of(run, trial)
    except NotUsable as reason:
        return [Measured("x", "length", None)], [str(reason)]
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    predicted = (F_e - slip - load) / K_e if F_e is not None and K_e else None
    return [Measured("x", "length", x, predicted, tolerance=slip / K_e if K_e else 0.0, noise=20e-6)], []
