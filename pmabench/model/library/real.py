"""The muscle of plant `real`: its force, its loops and its creep in closed form (`pmabench.model.real.muscle`)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from pmabench.model.curve import Array
from pmabench.model.library.braid import MM
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse
from pmabench.model.real.muscle import reference

KPA = 1e3
MUSCLE = reference()
LOW, HIGH = (ratio * MUSCLE.length for ratio in MUSCLE.reach)
"""Range of contraction [m]."""
SOURCE = "six constants fitted to 46 points of the maker's catalogue of a DMSP-20, form after Sarosi 2012"
ASSUMED = "assumed, in the size that others report: 60 N between both ways at 5 bar, 0.8 % of the stroke a decade"

PRESSURE = Parameter(
    "pressure", "P", "pressure", 300 * KPA, "gauge pressure", 0.0, 600 * KPA, "the catalogue ends at 6 bar"
)
LOAD = Parameter("load", "F_L", "force", 200.0, "held from t = 0 on", 0.0, 5e3, "no load of this muscle")
SHARE = "between -1, all stops at their lower end, and 1"
POINTS = {
    100: ("249.1 43.8", "34.52 11.52 5.48"),
    200: ("503.0 272.7 163.2 85.4 16.1", "36.35 14.45 8.69 7.18 6.78 6.68"),
    300: ("756.8 501.5 361.0 250.6 148.2 47.9", "38.18 17.38 11.91 10.47 10.09 10.00"),
    400: ("1010.7 730.4 558.8 415.8 280.4 146.9", "40.01 20.31 15.13 13.77 13.41 13.31"),
    500: ("1264.6 959.3 756.7 581.0 412.5 245.8", "41.84 23.24 18.34 17.06 16.72 16.63"),
    600: ("1518.4 1188.1 954.5 746.2 544.6 344.8", "43.67 26.16 21.56 20.35 20.03 19.95"),
}
"""P [kPa] -> F_s [N] and K [N/mm] at 0, 10, ... mm, computed independently."""
LOOPS = {
    (1, 200): ("8.25", "0.013"), (5, 200): ("24.00", "0.178"), (10, 200): ("25.50", "0.442"),
    (20, 200): ("30.00", "1.042"), (1, 500): ("16.50", "0.026"), (5, 500): ("48.00", "0.356"),
    (10, 500): ("51.00", "0.884"), (20, 500): ("60.00", "2.084"),
}  # fmt: skip
"""(Amplitude [mm], P [kPa]) -> gap [N] by hand, and area [J] computed independently."""
CREPT = {
    (300, 200): {0: "34.899", 1: "35.124", 3: "35.258", 10: "35.405", 30: "35.534", 100: "35.659"},
    (500, 400): {0: "40.748", 1: "41.010", 3: "41.167", 10: "41.338", 30: "41.489", 100: "41.635"},
}
"""(P [kPa], load [N]) -> time [s] -> contraction [mm], computed independently."""


def _points() -> tuple[Reference, ...]:
    return tuple(
        Reference(name, printed, unit, scale, "computed apart", {"pressure": kPa * KPA, "displacement": cm * 10 * MM})
        for kPa, (forces, stiffnesses) in POINTS.items()
        for name, unit, scale, values in (("surface", "N", 1.0, forces), ("stiffness", "N/mm", 1e3, stiffnesses))
        for cm, printed in enumerate(values.split())
    )


@described(
    "real", "static force", "A muscle that is not straight: bent force, hysteresis over x and P, creep",
    equation=(
        "F = F_s(x - x_c, P) - H(P) s_x - 18 N s_P - B x', not below 0",
        "F_s = (244.7 N - 0.1115 N/kPa P) exp(-33.4 eps) - 8.30 N/kPa P eps + 2.650 N/kPa P - 249.4 N",
        "eps = (x - x_c) / 250 mm;  H = 5 N + 0.05 N/kPa P;  K = -dF_s/dx",
        "s_x = sum w S_r[x] / r: r = 0.2, 0.8, 2.5, 8 mm, w = 0.2, 0.3, 0.3, 0.2, from 0",
        "s_P = sum q S_r[P] / r: r = 20, 100 kPa, q = 0.4, 0.6, from -1 in a vented muscle",
        "S_r[u]: S <- min(r, max(-r, S + du));  B_c = 1.0 + 0.002 P, B_r = 0.7 + 0.0015 P N.s/mm, P in kPa",
        "x_c = sum x_j, T_j x_j' = 0.004 x - x_j, T = 0.5, 1.58, 5, 15.8, 50, 158 s",
    ),
    source=SOURCE,
    parameters=(
        PRESSURE,
        Parameter("displacement", "x", "length", 20 * MM, "contraction, below 0 stretched", LOW, HIGH,
                  "the catalogue ends there"),
        Parameter("crept", "x_c", "length", 0.0, "length that has crept", -5 * MM, 5 * MM, "it creeps by 2.4 % of x"),
        Parameter("stops_x", "s_x", "count", 0.0, f"state of the hysteresis over x, {SHARE}", -1.0, 1.0, "", "example"),
        Parameter("stops_p", "s_P", "count", 0.0, f"state of the hysteresis over P, {SHARE}", -1.0, 1.0, "", "example"),
        Parameter("speed", "x'", "speed", 0.0, "rate of contraction", -10.0, 10.0, "no speed of a muscle"),
    ),
    outputs=(
        Output("force", "F", "force", "what the cell reads"),
        Output("surface", "F_s", "force", "without history and damping; below 0 where it would push"),
        Output("stiffness", "K", "stiffness", "tangent of F_s"),
        Output("height", "H", "force", "most of the hysteresis over x, half the gap of a wide loop"),
        Output("damping", "B", "damping", "of the direction of x'; B_c where it rests"),
    ),
    references=(
        *_points(),
        Reference("force", "13.3", "N", 1.0, "by hand: 244.7 - 249.4 + 18",
                  {"pressure": 0.0, "displacement": 0.0, "stops_p": -1.0}),
        Reference("force", "286", "N", 1.0, "by hand: 361.0 - 20 - 18 - 1.6 23.1",
                  {"stops_x": 1.0, "stops_p": 1.0, "speed": 23.1 * MM}),
    ),
    notes=(
        "rms 7.1 N over the catalogue's points, 0.47 % of its highest force; greatest difference 26.5 N.",
        f"Hysteresis, creep and damping are {ASSUMED}.",
        "In time: pmabench model simulate real; each departure is an option there (creep=0).",
    ),
)  # fmt: skip
def real(pressure: Array, displacement: Array, crept: Array, stops_x: Array, stops_p: Array, speed: Array) -> Values:
    """F and F_s [N], K [N/m], H [N], B [N.s/m] from P [Pa], x and x_c [m], states of the stops [1], x' [m/s]."""
    P, x, x_c, s_x, s_P, v = np.broadcast_arrays(pressure, displacement, crept, stops_x, stops_p, speed)
    surface, height = MUSCLE.pull(P, x - x_c), MUSCLE.over_x.most(P)
    damping = np.where(v < 0, MUSCLE.B_r.values(P), MUSCLE.B_c.values(P))
    force = surface - height * s_x - MUSCLE.over_P.most(P) * s_P - damping * v
    stiffness = MUSCLE.stiffness(P, x - x_c)
    return {
        "force": np.maximum(force, 0.0), "surface": surface, "stiffness": stiffness, "height": height,
        "damping": damping,
    }  # fmt: skip


@described(
    "real-loop", "friction and hysteresis", "Gap and area of a steady loop of stops over the contraction",
    equation=(
        "gap = 2 H sum w min(r, A - min(r, A)) / r;  area = 4 H sum over r < A of w (A - r)",
        "H, r and w as in real",
    ),
    source="closed form; the numbers of plant real",
    parameters=(
        PRESSURE,
        Parameter("amplitude", "A", "length", 10 * MM, "half the way from turn to turn", 0.0, 0.5 * (HIGH - LOW),
                  "it may not go so far", above=True),
    ),
    outputs=(
        Output("gap", "", "force", "relaxing less contracting, in the middle"),
        Output("area", "W", "work", "work that a cycle loses"),
    ),
    references=tuple(
        Reference(name, printed, unit, 1.0, source, {"amplitude": mm * MM, "pressure": kPa * KPA})
        for (mm, kPa), values in LOOPS.items()
        for name, printed, unit, source in (
            ("gap", values[0], "N", "by hand"), ("area", values[1], "J", "computed apart"),
        )
    ),
    notes=("From the second cycle on; about any centre; without damping and creep.",),
)  # fmt: skip
def real_loop(pressure: Array, amplitude: Array) -> Values:
    """Gap [N] and area [J] from P [Pa] and A [m]."""
    P, A = np.broadcast_arrays(pressure, amplitude)
    stops = MUSCLE.over_x
    gap, area = np.zeros(P.shape), np.zeros(P.shape)
    for width, weight in zip(stops.widths, stops.weights, strict=True):
        gap += weight * np.minimum(width, A - np.minimum(width, A)) / width
        area += weight * np.maximum(A - width, 0.0)
    return {"gap": 2 * stops.most(P) * gap, "area": 4 * stops.most(P) * area}


@described(
    "real-creep", "friction and hysteresis", "Contraction that creeps under a held load after a step of pressure",
    equation=(
        "F_s(u, P) = F_L;  x = u + sum x_j;  T_j x_j' = 0.004 x - x_j, x_j = 0 at t = 0",
        "F_s and T_j as in real",
    ),
    source="closed form, linear in x_j; the numbers of plant real",
    parameters=(
        PRESSURE, LOAD,
        Parameter("time", "t", "time", 10.0, "since the step", 0.0, 1e6, "nobody waits so long"),
    ),
    outputs=(
        Output("displacement", "x", "length", "contraction"),
        Output("crept", "x_c", "length", "of which has crept"),
    ),
    references=tuple(
        Reference("displacement", printed, "mm", MM, "computed apart",
                  {"pressure": kPa * KPA, "load": float(newton), "time": float(seconds)})
        for (kPa, newton), values in CREPT.items()
        for seconds, printed in values.items()
    ),
    notes=("Without hysteresis and damping.",),
)  # fmt: skip
def real_creep(pressure: Array, load: Array, time: Array) -> Values:
    """X and x_c [m] from P [Pa], F_L [N] and t [s]."""
    P, F, t = np.broadcast_arrays(pressure, load, time)
    refuse("load", "the muscle cannot lift it at this pressure", MUSCLE.pull(P, np.zeros(P.shape)) < F, F)
    refuse("load", "the muscle is at its end", MUSCLE.pull(P, np.full(P.shape, HIGH)) > F, F)
    u = np.vectorize(_balance, otypes=[float])(P, F)
    times = np.array(MUSCLE.creep.times)
    share = MUSCLE.creep.share
    rates, modes = np.linalg.eig((share * np.ones((len(times), len(times))) - np.eye(len(times))) / times[:, None])
    rest = np.linalg.solve(np.eye(len(times)) - share * np.ones((len(times), len(times))), np.full(len(times), share))
    kept = modes.sum(axis=0) * np.linalg.solve(modes, rest)
    crept = u * (rest.sum() - (kept * np.exp(rates * t[..., None])).sum(axis=-1)).real
    return {"displacement": u + crept, "crept": crept}


def _balance(P: float, F: float) -> float:
    """Contraction [m] at which the force without history is F [N] at P [Pa]; 0 if there is none above 0."""

    def over(x: float) -> float:
        return float(MUSCLE.pull(np.array(P), np.array(x))) - F

    return float(brentq(over, 0.0, HIGH, xtol=1e-12)) if over(0.0) > 0 else 0.0
