"""Figures of driven sines: loops next to the fitted muscle, Bode table, the pressure that they make.

`measure`: what one trial says by itself, for the display.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import pi

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.sine_loop import Sine, along
from pmabench.analysis.shared.sine_loop import measure as harmonic
from pmabench.analysis.shared.trials import thinned
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement.fit import Muscle
from pmabench.plotting import pictures, time_plots
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData


def traces_of(at: Mapping[str, float], sines: Mapping[float, Sequence[Sine]], muscle: Muscle | None) -> list[Trace]:
    """One loop per frequency (the last cycle of its first trial), and the Bode table.

    `sines` by frequency [Hz]; `muscle` is None where K, B and F_c are not all known: no model is drawn with the loops.
    """
    where = ", ".join(
        show(at[name], quantity) for name, quantity in (("pressure", "pressure"), ("mean", "length")) if name in at
    )
    where += f" ± {show(at['amplitude'], 'length')}" if "amplitude" in at else ""
    name = "-".join(f"{at[key]:g}" for key in at)
    held = {key: at[key] for key in ("pressure",) if key in at}
    traces = []
    groups = sorted(sines.items())
    for frequency, members in groups:
        sine = members[0]
        last = sine.t >= sine.t[-1] - 1 / frequency
        columns = {"displacement": sine.x, "force": sine.F}
        if muscle is not None:
            columns["model"] = along(sine, muscle.K, muscle.B, muscle.F_c)[1]
        traces.append(
            Trace(
                f"loop-{name}-{frequency:g}",
                "loop",
                f"Loop at {frequency:g} Hz, {where}",
                thinned({name: values[last] for name, values in columns.items()}),
                {"displacement": "length", "force": "force", "model": "force"},
                {"frequency": frequency, "width": sine.width, "area": sine.area} | held,
            )
        )

    marks = {} if muscle is None else {"K": muscle.K, "B": muscle.B, "F_c": muscle.F_c}
    columns = {
        name: np.array([float(np.mean([of(sine) for sine in members])) for _, members in groups])
        for name, (_, of) in BODE.items()
    }
    quantities = {name: quantity for name, (quantity, _) in BODE.items()}
    return [*traces, Trace(f"bode-{name}", "bode", f"Force over displacement, {where}", columns, quantities, marks)]


BODE: Mapping[str, tuple[str, Callable[[Sine], float]]] = {
    "frequency": ("frequency", lambda sine: sine.frequency),
    "gain": ("stiffness", lambda sine: abs(sine.ratio)),
    "phase": ("angle", lambda sine: sine.phase),
    "stiffness": ("stiffness", lambda sine: sine.stiffness),
    "loss": ("force", lambda sine: sine.loss),
    "speed": ("speed", lambda sine: sine.speed),
    "width": ("force", lambda sine: sine.width),
}
"""Column of the Bode table, a mean over the sines of each frequency -> its quantity, and its value of one sine."""


SINES = 4
"""Most panels."""


def sine_pressure(traces: Sequence[Trace], analysis: Analysis) -> list[pictures.Picture]:
    """Force along sines, measured and modelled with set and measured pressure, above the error of the pressure."""
    able = [t for t in traces if pictures.has(t, "displacement", "force", "set", "measured", "error")]
    able = [t for t in able if "frequency" in t.marks]
    chosen = pictures.spread(sorted(able, key=lambda t: (t.marks.get("pressure", 0.0), t.marks["frequency"])), SINES)
    if not chosen:
        return []
    names = {"x": "displacement", "y": "force", "set": "set", "model": "measured", "error": "error"}
    panels = [pictures.panel(t, names, pictures.head(t)) for t in chosen]
    error = shown("pressure").label("P − set P")
    labels = {"x": pictures.label(chosen[0], "displacement"), "y": pictures.label(chosen[0], "force"), "error": error}
    worst = [float(np.nanmax(np.abs(p.columns["error"]))) for p in panels]
    caption = (
        "Above: the last cycle, and the static model of the slowest sines with the set pressure as input and with the "
        "measured one, damping and friction of the harmonics added. Below: error of the pressure, at most "
        f"{pictures.reach(worst)} {shown('pressure').unit}.{pictures.how_many(chosen, able)}"
    )
    alt = f"Force and pressure error over contraction along sines at {'; '.join(p.title for p in panels)}."
    draw = pictures.bound(time_plots.sine_pressure, panels, labels)
    table = pictures.numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)])
    title = "Force with set and with measured pressure"
    return [pictures.picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]


DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K, and B at this frequency, with what Coulomb friction adds to it: -Im(F/x)/omega = B + 4 F_c/(pi omega A)."""
    settings = run.plan.get("settings") or {}
    P = trial.point.get("pressure")
    try:
        sine = harmonic(run, trial, float(settings.get("discard", 1)))
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("B", "damping", None)], [str(reason)]
    K_e = B_e = None
    if expected is not None and P is not None:
        K_e = expected.at("K", P)
        B_c, B_r = expected.at("B_c", P), expected.at("B_r", P)
        if B_c is not None and B_r is not None:
            B_e = 0.5 * (B_c + B_r) + 4 * expected.F_c / (pi * sine.speed)
    doubts = []
    if sine.distortion > DISTORTED:
        doubts.append(f"the displacement is no sine: {sine.distortion:.0%} of it is something else")
    asked = trial.point.get("amplitude", settings.get("amplitude"))
    if isinstance(asked, int | float) and asked > 0 and abs(sine.amplitude / asked - 1) > 0.05:
        doubts.append(f"amplitude {show(sine.amplitude, 'length', 3)}, asked for {show(float(asked), 'length', 3)}")
    pressure = None if np.isnan(sine.pressure) else sine.pressure
    return [
        Measured("K", "stiffness", sine.stiffness, K_e),
        Measured("B", "damping", sine.loss / sine.speed, B_e, tolerance=0.25 * B_e if B_e else 0.0),
        Measured("P", "pressure", pressure, P),
        Measured("A", "length", sine.amplitude),
    ], doubts
