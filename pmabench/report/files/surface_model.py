"""A muscle as a surface as a Python file for python-control: a discrete-time system with its memory as states.

The functions `place`, `force` and `step` are put into the file as they are written here; they need numpy alone.
"""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from pmabench import __version__
from pmabench.model.identified.library import holds_surface
from pmabench.model.identified.muscle import IdentifiedMuscle, Weights
from pmabench.report.files.simulator_models import inside
from pmabench.store.analyses.results import Analysis

STEP = 0.0005
"""Time step of the file [s]."""
GRID = 1e-3
"""Distance of the contractions in a table of the surface [m]."""
SLACK = 0.05
"""Share of it by which a contraction may lie beyond the tests."""
MASS = 10.0
"""Moving mass that the file begins with [kg]."""


def place(value: float, knots: Any) -> Any:
    """Number of the interval of a value, powers of the way inside it, their slopes, and the way beyond the knots."""
    cut = min(max(value, knots[0]), knots[-1])
    number = min(max(int(np.searchsorted(knots, cut, side="right")) - 1, 0), max(len(knots) - 2, 0))
    u = cut - knots[number]
    return number, np.array([u**3, u**2, u, 1.0]), np.array([3 * u**2, 2 * u, 1.0, 0.0]), value - cut


def force(pressure: float, x: float, memory: Any, p: dict[str, Any]) -> Any:
    """Force without damping [N] and about minus its slope over contraction [N/m]; `memory`: stops and lags."""
    i, u, du, beyond_P = place(pressure, p["P"])
    j, w, dw, beyond_x = place(x, p["x"])
    at = (u + beyond_P * du) @ p["cubics"][i, j]
    slope = float(at @ dw)
    stiffness = max(-slope, 0.0)
    share_P = (p["P"][i] + u[2] - p["P"][0]) / max(p["P"][-1] - p["P"][0], 1e-300)
    share_x = (p["x"][j] + w[2] - p["x"][0]) / max(p["x"][-1] - p["x"][0], 1e-300)

    def weights(name: str, share: float) -> Any:
        low, high = p[name][1:]
        return low + share * (high - low)

    stops_x, stops_P, lag_x, lag_P = memory
    held = weights("stops_x", share_P)
    crept = p["creep_x"][1] @ (lag_x - p["fast_x"] * x)
    total = float(at @ w) + beyond_x * slope - held @ stops_x - weights("stops_P", share_x) @ stops_P
    total += stiffness * crept + weights("creep_P", share_x) @ (lag_P - p["fast_P"] * pressure)
    return total, stiffness + float((held / p["stops_x"][0])[np.abs(stops_x) < 1.0].sum())


def step(state: Any, inputs: Any, p: dict[str, Any]) -> Any:
    """The state one time step later, under [pressure Pa gauge, load N].

    State: contraction [m], its rate [m/s], pressure [Pa], stops on x and P [-1..1], lags of x [m] and P [Pa].
    """
    n, m, k = (len(p[name][0]) for name in ("stops_x", "stops_P", "creep_x"))
    x, v, before = state[:3]
    stops_x, stops_P, lag_x, lag_P = np.split(state[3:], [n, n + m, n + m + k])
    pressure, load, h = float(inputs[0]), float(inputs[1]), p["step"]
    stops_P = np.clip(stops_P + (pressure - before) / p["stops_P"][0], -1.0, 1.0)
    lag_P = pressure + (lag_P - pressure) * np.exp(-h / p["creep_P"][0])
    pull, stiffness = force(pressure, x, (stops_x, stops_P, lag_x, lag_P), p)
    share = min(max((pressure - p["P"][0]) / max(p["P"][-1] - p["P"][0], 1e-300), 0.0), 1.0)
    low, high = p["B_c"] if (v or pull - load) > 0 else p["B_r"]
    damping = max(low + share * (high - low), 1.0)
    v = (p["M"] * v + h * (pull - load)) / (p["M"] + h * damping + h * h * stiffness)
    if not 0.0 <= x + h * v <= p["stop"]:
        v = (min(max(x, 0.0), p["stop"]) - x) / h
    x = x + h * v
    stops_x = np.clip(stops_x + h * v / p["stops_x"][0], -1.0, 1.0)
    lag_x = x + (lag_x - x) * np.exp(-h / p["creep_x"][0])
    return np.concatenate([[x, v, pressure], stops_x, stops_P, lag_x, lag_P])


def suits_surface(analysis: Analysis) -> bool:
    """Whether an analysis holds a muscle as a surface."""
    return holds_surface(analysis.facts)


def surface_rows(analysis: Analysis) -> list[dict[str, float]]:
    """Force and local stiffness over pressure and contraction, where rows of the tests lie and the muscle pulls [SI].

    None of an analysis that does not say where that is.
    """
    if not suits_surface(analysis):
        return []
    muscle = IdentifiedMuscle.of(analysis.facts["muscle"])
    found = []
    for P, low, high in analysis.facts.get("tested", ()):
        for x in GRID * np.arange(np.ceil(low / GRID - SLACK), np.floor(high / GRID + SLACK) + 1):
            if (F := muscle.static(P, float(x))) > 0:
                K = muscle.stiffness(P, float(x))
                found.append({"pressure": P, "contraction": round(float(x), 9), "F": F, "K": K})
    return found


def parameters_of(muscle: IdentifiedMuscle) -> dict[str, Any]:
    """What the functions above take of a muscle; stops and lags without weight are left out."""

    def used(weights: Weights) -> Any:
        kept = (weights.low != 0.0) | (weights.high != 0.0)
        return np.array([weights.sizes[kept], weights.low[kept], weights.high[kept]])

    cubics = np.einsum("iap,pq,jbq->ijab", muscle.over_P.pieces, muscle.heights, muscle.over_x.pieces)
    found: dict[str, Any] = {"P": np.array(muscle.over_P.knots), "x": np.array(muscle.over_x.knots), "cubics": cubics}
    found |= {name: used(getattr(muscle, name)) for name in ("stops_x", "stops_P", "creep_x", "creep_P")}
    found |= {f"fast_{axis}": (found[f"creep_{axis}"][0] < muscle.fast).astype(float) for axis in ("x", "P")}
    found |= {"B_c": np.array(muscle.B_c), "B_r": np.array(muscle.B_r)}
    return found | {"stop": muscle.stop, "M": MASS, "step": STEP}


def surface_text(analysis: Analysis) -> str:
    """The file; the same bytes for the same analysis."""
    muscle = IdentifiedMuscle.of(analysis.facts["muscle"])
    mark = "SIMULATED. " if analysis.simulated else ""
    lines = ['"""A pneumatic muscle as a surface with hysteresis, damping and creep, for numpy and python-control.', ""]
    lines += [f"{mark}pmabench {__version__}; runs:", *(f"- {inside(run)}" for run in analysis.runs), ""]
    left_out, full = (float(analysis.facts.get(name) or 0.0) for name in ("held_out_rms", "straight_form_rms"))
    lines += [f"Trials left out of the fit were predicted to {left_out:.2g} N rms, by straight lines to {full:.2g} N."]
    (low, high), (x_low, x_high) = (
        ends.knots[:: max(len(ends.knots) - 1, 1)] for ends in (muscle.over_P, muscle.over_x)
    )
    lines += [f"It holds from {low / 1e3:.0f} to {high / 1e3:.0f} kPa and {1e3 * x_low:.1f} to {1e3 * x_high:.1f} mm."]
    lines += [
        "Begin at rest, vented: start(). M is the moving mass: put yours. Discrete time: see `step` [s].",
        '"""',
        "",
    ]
    lines += ["from typing import Any", "", "import control", "import numpy as np", ""]
    lines += ["# SI. Stops: half widths, weights [N] at both ends of the range; lags: times [s], weights at both ends."]
    lines += ["PARAMETERS: dict[str, Any] = {"]
    for name, value in parameters_of(muscle).items():
        literal = f"np.array({np.asarray(value).tolist()})" if np.ndim(value) else f"{float(value):.12g}"
        lines.append(f'    "{name}": {literal},')
    lines += ["}", "", ""]
    lines += [part for function in (place, force, step) for part in (inspect.getsource(function).rstrip(), "", "")]
    return "\n".join(lines) + _END


_END = '''def start(p: dict[str, Any] = PARAMETERS) -> Any:
    """State of a muscle that was rested, vented and at its nominal length."""
    n, m, k, j = (len(p[name][0]) for name in ("stops_x", "stops_P", "creep_x", "creep_P"))
    return np.concatenate([np.zeros(3 + n), -np.ones(m), np.zeros(k + j)])


muscle = control.nlsys(
    lambda t, state, inputs, params: step(state, inputs, PARAMETERS | params),
    lambda t, state, inputs, params: state[:1],
    inputs=["P", "F_L"],
    outputs=["x"],
    states=len(start()),
    dt=PARAMETERS["step"],
    name="muscle",
)
"""Contraction x [m] under pressure P [Pa gauge] and load F_L [N], sampled every `step` [s]."""
'''
