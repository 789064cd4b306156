"""An analysis as a model for simulators, python-control and MuJoCo: its coefficients, a law, and how far it is off.

The deviation is found by running the exported law along the pressures of the analysis' own free runs. In MuJoCo the
muscle is one slide joint under an affine actuator: its force is gain x control + bias with gain and bias affine in
length and speed, which is the muscle's law where F_ce, K and B are straight lines over the pressure,
f_0 + f_1 P - (k_0 + k_1 P) x - (b_0 + b_1 P) v. It has one damping for both directions.
"""

from __future__ import annotations

import inspect
import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmabench import __version__
from pmabench.base.errors import UsageError
from pmabench.plotting.pictures import has
from pmabench.plotting.wording import clean
from pmabench.report.certificate.force_chart import bend_of, slopes_of
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import Array, RunData


def rates(t: float, state: Any, inputs: Any, params: dict[str, Any]) -> Any:
    """Rates of [contraction m, speed m/s] under [pressure Pa gauge, load N]: M x'' = F_ce - K x - B x' - F_c - F_L.

    Coefficients are joined by straight lines over the pressure, which go on beyond its ends; stiffness and damping stay
    above 0. A muscle that is bent pulls more by `bend` at contractions `x`. Friction grows with the speed up to F_c
    within a few `v_0`; a stop of 1e8 N/m holds the muscle at 0.
    """
    x, v = float(state[0]), float(state[1])
    pressure, load = float(inputs[0]), float(inputs[1])
    knots = params["P"]
    left = min(max(bisect_left(knots, pressure) - 1, 0), max(len(knots) - 2, 0))
    share = (pressure - knots[left]) / (knots[left + 1] - knots[left]) if len(knots) > 1 else 0.0

    def at(name: str) -> float:
        values = params[name]
        return float(values[left] + share * (values[left + 1] - values[left])) if len(knots) > 1 else float(values[0])

    damping = max(at("B_c" if v >= 0 else "B_r"), 1.0)
    friction = params["F_c"] * np.tanh(v / params["v_0"])
    stop = max(0.0, -1e8 * x - 4e4 * v) if x < 0 else 0.0
    more = 0.0
    if "bend" in params:
        rows = params["bend"][left : left + 2]
        more = float(np.interp(x, params["x"], rows[0] + share * (rows[-1] - rows[0])))
    a = (at("F_ce") - max(at("K"), 1.0) * x + more - damping * v - friction - load + stop) / params["M"]
    return np.array([v, a])


GRAVITY = 9.80665
SLOW = 1e-6
"""Speed within which the friction of the exported model turns [m/s]."""


@dataclass(frozen=True)
class Deviation:
    """Differences of the exported model from the fitted muscle of the analysis and from the measurement [m]."""

    runs: int
    rms: float
    largest: float
    measured_rms: float


@dataclass(frozen=True)
class ControlModel:
    """Parameters of `rates`, and how well they do."""

    params: dict[str, Any]
    method: str
    notes: list[str]
    deviation: Deviation | None


def suits(analysis: Analysis) -> bool:
    """Whether `control_model` can make a model of an analysis."""
    values = _primary_values(analysis)
    return bool(set(values.get("F_ce", {})) & set(values.get("K", {}))) and "B_c" in values


def _primary_values(analysis: Analysis) -> dict[str, dict[float, float]]:
    """Values of the primary method over pressure, by symbol."""
    values: dict[str, dict[float, float]] = {}
    for e in analysis.estimates:
        mine = e.method == analysis.estimates[0].method and set(e.at) == {"pressure"} and not e.coordinate
        if mine and e.value is not None:
            values.setdefault(e.symbol, {})[e.at["pressure"]] = e.value
    return values


def control_model(analysis: Analysis, runs: Sequence[RunData] = ()) -> ControlModel:
    """The model of an analysis that has F_ce, K and damping over pressure; UsageError for one that has not.

    `runs` give the moving mass; without them it is the load over gravity.
    """
    model = _curves(analysis, runs)
    return replace(model, deviation=deviation_of(analysis, runs, model.params))


def _curves(analysis: Analysis, runs: Sequence[RunData]) -> ControlModel:
    """The model without its deviation."""
    primary = analysis.estimates[0].method if analysis.estimates else ""
    values = _primary_values(analysis)
    shared = sorted(set(values.get("F_ce", {})) & set(values.get("K", {})))
    if not suits(analysis):
        raise UsageError(
            f"an analysis of {clean(analysis.kind, 60)} has no F_ce, K and B_c over pressure by one method; "
            "give one of contraction-relaxation, or another --format"
        )
    P = np.array(shared)
    notes = []
    params: dict[str, Any] = {"P": P}
    for symbol in ("F_ce", "K", "B_c", "B_r"):
        known = values.get(symbol) or values["B_c"]
        if symbol not in values:
            notes.append("B_r is not known; B_c is taken in its place")
        lacking = [f"{at / 1e3:g} kPa" for at in shared if at not in known]
        if lacking and symbol in values:
            notes.append(f"{symbol} is not known at {', '.join(lacking)}: taken from the pressures next to it")
        places = sorted(known)
        params[symbol] = _joined(P, places, [known[at] for at in places])
    if (bend := bend_of([analysis], (primary,))) is not None:
        params |= {"x": bend.x, "bend": np.array([bend.at(at) for at in shared])}
    friction = [e.value for e in analysis.estimates if (e.symbol, e.method) == ("F_c", primary)]
    params["F_c"] = next((value for value in friction if value is not None), None)
    if params["F_c"] is None:
        params["F_c"] = 0.0
        notes.append("Coulomb friction is not known and left out")
    elif params["F_c"] < 0:  # within its interval of 0; a negative one would drive the muscle
        params["F_c"] = 0.0
        notes.append("Coulomb friction came out below 0 and is left out")
    traces, masses = _free_runs(analysis), _masses(runs)
    params["M"] = next(iter(masses.values()), None) or (traces[0].marks["load"] / GRAVITY if traces else 1.0)
    params["v_0"] = SLOW
    return ControlModel(params, clean(primary, 80), notes, None)


def _free_runs(analysis: Analysis) -> list[Trace]:
    traces = [t for t in analysis.traces if t.figure == "overlay" and "load" in t.marks]
    return [t for t in traces if has(t, "t", "pressure", "displacement", "model")]


def _joined(P: Array, places: Sequence[float], values: Sequence[float]) -> Array:
    """Values at P, interpolated linearly between places and extrapolated beyond them."""
    if len(places) == 1:
        return np.full(len(P), values[0])
    left = np.clip(np.searchsorted(places, P) - 1, 0, len(places) - 2)
    x, y = np.asarray(places), np.asarray(values)
    return np.asarray(y[left] + (P - x[left]) * (y[left + 1] - y[left]) / (x[left + 1] - x[left]))


def _masses(runs: Sequence[RunData]) -> dict[float, float]:
    """Moving mass [kg] by load [N]."""
    points = [trial.point for run in runs for trial in run.trials]
    return {round(p["load"], 3): p["mass"] for p in points if p.get("mass", 0.0) > 0 and "load" in p}


def deviation_of(analysis: Analysis, runs: Sequence[RunData], params: dict[str, Any]) -> Deviation | None:
    """The deviation of a model with these parameters along the free runs of an analysis; None without any."""
    fitted, measured = [], []
    masses = _masses(runs)
    for trace in _free_runs(analysis):
        load = trace.marks["load"]
        mass = masses.get(round(load, 3)) or load / GRAVITY
        if mass <= 0:
            continue
        columns = {name: np.asarray(values, dtype=np.float64) for name, values in trace.columns.items()}
        x = simulated(columns["t"], columns["pressure"], load, params | {"M": mass}, float(columns["displacement"][0]))
        known = np.isfinite(columns["model"]) & (columns["pressure"] >= params["P"][0])
        fitted.append((x - columns["model"])[known])
        measured.append((x - columns["displacement"])[known])
    if not fitted or not sum(map(len, fitted)):
        return None
    off, out = np.concatenate(fitted), np.concatenate(measured)
    rms, measured_rms = (float(np.sqrt(np.mean(values**2))) for values in (off, out))
    return Deviation(len(fitted), rms, float(np.max(np.abs(off))), measured_rms)


def simulated(t: Array, P: Array, load: float, params: dict[str, Any], x: float = 0.0) -> Array:
    """Contraction [m], shape (n,), of the exported law from rest at `x` under pressures P [Pa] at times t [s]."""
    from scipy.integrate import odeint

    times, pressures, slopes = t.tolist(), P.tolist(), [*(np.diff(P) / np.diff(t)).tolist(), 0.0]

    def law(state: Any, now: float) -> Any:
        before = max(bisect_left(times, now) - 1, 0)  # several times as fast as np.interp for one number
        return rates(now, state, (pressures[before] + slopes[before] * (now - times[before]), load), params)

    step = float(np.min(np.diff(t))) if len(t) > 1 else 0.0
    return np.asarray(odeint(law, [x, 0.0], t, rtol=1e-7, atol=1e-9, hmax=step, mxstep=20_000)[:, 0])


def control_text(model: ControlModel, analysis: Analysis) -> str:
    """The model as a Python file that needs numpy and python-control; the same bytes for the same analysis."""
    lines = ['"""A pneumatic muscle as fitted, for python-control.', ""]
    mark = "SIMULATED. " if analysis.simulated else ""
    lines += [f"{mark}Method {inside(model.method)}, pmabench {__version__}; runs:"]
    lines += [f"- {inside(run)}" for run in analysis.runs]
    lines += ["", *remarks_of(model)]
    lines += ['Friction makes it stiff: control.input_output_response(..., solve_ivp_method="LSODA").']
    lines += ["The coefficients hold inside the pressures of `P`; M is the moving mass: put yours.", '"""', ""]
    lines += ["from bisect import bisect_left", "from typing import Any", ""]
    lines += ["import control", "import numpy as np", ""]
    lines += ["# SI: P [Pa gauge], F_ce [N], K [N/m], B_c and B_r [N.s/m], F_c [N], M [kg], v_0 [m/s], x [m], bend [N]"]
    lines += ["PARAMETERS = {"]
    lines += [f'    "{name}": {_literal(value)},' for name, value in model.params.items()]
    lines += ["}", "", "", inspect.getsource(rates).rstrip(), "", ""]
    lines += [
        "def law(t, state, inputs, params):",
        '    """As `rates`, with what is given in place of `PARAMETERS`."""',
        "    return rates(t, state, inputs, PARAMETERS | params)",
        "",
        "",
        "muscle = control.nlsys(",
        "    law,",
        "    lambda t, state, inputs, params: state[:1],",
        '    inputs=["P", "F_L"],',
        '    outputs=["x"],',
        '    states=["x", "v"],',
        '    name="muscle",',
        ")",
        '"""Contraction x [m] under pressure P [Pa gauge] and load F_L [N]."""',
    ]
    return "\n".join(lines) + "\n"


def _literal(value: Any) -> str:
    """A number, or the rows of an array, as Python text."""
    rows = [[float(f"{v:.12g}") for v in row] for row in np.atleast_2d(value)]
    if np.ndim(value) < 2:
        return f"np.array({rows[0]})" if np.ndim(value) else f"{float(value):.12g}"
    return "\n        ".join(["np.array([", *(f"    {row}," for row in rows), "])"])


def remarks_of(model: ControlModel) -> list[str]:
    """How far it is off the fit, and its notes, in lines for the head of a file."""
    lines = ["How far it is off the fit was not found: the analysis has no free runs."]
    if (d := model.deviation) is not None:
        lines = [
            f"Along the pressures of {d.runs} measured trials its contraction is {d.rms * 1e3:.2g} mm rms off",
            f"that of the fitted muscle (largest {d.largest * 1e3:.2g} mm), and {d.measured_rms * 1e3:.2g} mm rms",
            "off the measured one.",
        ]
    return [*lines, *(f"{note[:1].upper()}{note[1:]}." for note in model.notes)]


def inside(text: str) -> str:
    """Text without the signs that could end the docstring or comment that holds it."""
    return re.sub(r"[^A-Za-z0-9 ._:/-]", "?", clean(text, 120))


STEP = 0.0005
"""Time step of the file [s]."""
STIFF = "0.9999 0.9999 0.001"
"""Impedance of the joint's friction: with less of it a muscle at rest creeps."""


def mujoco_model(analysis: Analysis, runs: Sequence[RunData] = ()) -> ControlModel:
    """The model of `control_model` with each coefficient on one straight line; UsageError where it makes none.

    The lines are those of least squares through the values at the tested pressures. B is the mean of B_c and B_r. Of a
    bent muscle it is the tangent where K is the slope.
    """
    model = _curves(analysis, runs)
    P, notes = model.params["P"], list(model.notes)
    straight = {name: value for name, value in model.params.items() if name not in ("x", "bend")}
    places = slopes_of([analysis], (analysis.estimates[0].method,))
    if "bend" in model.params and set(P) <= set(places):
        straight["F_ce"] = np.array([places[at][1] + K * places[at][0] for at, K in zip(P, straight["K"], strict=True)])
        x = [1e3 * place for place, _ in places.values()]
        notes.append(f"the muscle is bent: this is its tangent at {min(x):.3g} to {max(x):.3g} mm of contraction")
    model = replace(model, params=straight, notes=notes)
    ends = np.array([P[0], P[-1] if len(P) > 1 else P[0] + 1e5])
    values = {name: model.params[name] for name in ("F_ce", "K")}
    values["B_c"] = values["B_r"] = 0.5 * (model.params["B_c"] + model.params["B_r"])
    lines = {name: np.polyval(line_through(P, value), ends) for name, value in values.items()}
    params = model.params | {"P": ends} | lines
    notes = [*notes, "one damping for both directions: the mean of B_c and B_r"]
    return replace(model, params=params, notes=notes, deviation=deviation_of(analysis, runs, params))


def line_through(P: Array, values: Array) -> Array:
    """Slope and intercept of least squares, shape (2,); a constant where there is one pressure."""
    return np.polyfit(P, values, 1) if len(P) > 1 else np.array([0.0, float(values[0])])


def mujoco_text(model: ControlModel, analysis: Analysis) -> str:
    """The MJCF file; the same bytes for the same analysis. Controls: pressure [Pa gauge] and load [N]."""
    P = model.params["P"]
    signs = (("F_ce", 1), ("K", -1), ("B_c", -1))
    lines = [sign * line_through(P, np.asarray(model.params[symbol])) for symbol, sign in signs]
    (f_1, f_0), (k_1, k_0), (b_1, b_0) = ((f"{slope:.12g}", f"{start:.12g}") for slope, start in lines)
    remarks = ["SIMULATED."] if analysis.simulated else []
    remarks += [f"A pneumatic muscle as fitted: method {inside(model.method)}, pmabench {__version__}; runs:"]
    remarks += [inside(run) for run in analysis.runs]
    remarks += [
        *remarks_of(model),
        f"It holds from {P[0] / 1e3:g} to {P[-1] / 1e3:g} kPa. Controls: pressure [Pa gauge] and load [N].",
        "The joint is the contraction [m]; the mass is the moving mass: put yours.",
    ]
    comment = "\n".join(f"  {line.replace('--', '- -')}" for line in remarks)
    mass, friction = (f"{model.params[name]:.12g}" for name in ("M", "F_c"))
    return f"""<mujoco model="pneumatic muscle">
  <!--
{comment}
  -->
  <option timestep="{STEP:g}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="end">
      <joint name="contraction" type="slide" axis="0 0 1" limited="true" range="0 1"
        frictionloss="{friction}" solimpfriction="{STIFF}"/>
      <geom type="sphere" size="0.02" mass="{mass}" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <general name="muscle" joint="contraction" gaintype="affine" biastype="affine"
      gainprm="{f_1} {k_1} {b_1}" biasprm="{f_0} {k_0} {b_0}"/>
    <motor name="load" joint="contraction" gear="-1"/>
  </actuator>
</mujoco>
"""
