"""Length and arm angle of paper 2 with their coefficients as inputs: to be fitted to muscles of one's own."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, DEG
from pmabench.model.library.contractor import ARM, CM, RANGE_BAR
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse

PRESSURE = Parameter("pressure", "p", "pressure", 3 * BAR, "gauge pressure", 0.0, 5 * BAR, RANGE_BAR)
ANGLE = Output("angle", "alpha", "angle", "bending angle, 0 for the straight arm")
ROWS = {"a": (DEG, "angle"), "b": (DEG, "angle"), "c": (BAR, "pressure"), "d": (1.0, "count")}
"""Rows of the matrix of the arm's angle: SI value of the print's unit, quantity."""


@described(
    "sigmoid-length-coefficients", "length", "Free length of one muscle over pressure, with a to e of its own",
    equation=("L = a + b / [1 + (p / c)^d]^e - r L0 sqrt(p / 1 bar)",),
    source="paper 2 eq. 1; reference values are its eq. 2 at 30 cm with the mended exponent",
    parameters=(
        PRESSURE,
        Parameter("nominal_length", "L0", "length", 30 * CM, "length without pressure", 0.0, 2.0, "", above=True),
        Parameter("a", "a", "length", 21.423 * CM, "length that is left", 0.0, 2.0),
        Parameter("b", "b", "length", 8.577 * CM, "what the sigmoid takes off; a + b = L0 in paper 2", 0.0, 2.0),
        Parameter("c", "c", "pressure", 0.747 * BAR, "pressure of the knee", 0.0, 10 * BAR, "", above=True),
        Parameter("d", "d", "count", 6.111, "steepness", 0.0, 60.0, "", above=True),
        Parameter("e", "e", "count", 0.1589, "exponent", 0.0, 10.0, "", above=True),
        Parameter("r", "r", "count", 0.009, "share of L0 that goes on with the root of p", 0.0, 0.1, "", "printed"),
    ),
    outputs=(
        Output("length", "L", "length", "length without load"),
        Output("contraction", "eps", "ratio", "(L0 - L) / L0"),
    ),
    references=(
        Reference("contraction", "22.7", "%", 0.01, "table of sigmoid-length at 30 cm, 3 bar"),
        Reference("contraction", "8.5", "%", 0.01, "the same at 1 bar", {"pressure": 1 * BAR}),
        Reference("length", "30", "cm", CM, "a + b = L0", {"pressure": 0.0}),
    ),
    fitted=("a", "b", "c", "d", "e"),
    notes=("d and e share the slope of the tail: the curve is well known where each of them is not.",),
)  # fmt: skip
def sigmoid_length_coefficients(
    pressure: Array, nominal_length: Array, a: Array, b: Array, c: Array, d: Array, e: Array, r: Array
) -> Values:
    """L [m] and eps [1] from p and c [Pa gauge], L0, a, b [m], d, e and r [1]."""
    root = r * nominal_length * np.sqrt(pressure / BAR)
    length = a + b / (1 + (pressure / c) ** d) ** e - root
    return {"length": length, "contraction": (nominal_length - length) / nominal_length}


@described(
    "arm-angle-at-load", "composition", "Bending angle of an arm at one load, with coefficients of its own",
    equation=("alpha = a + b / (1 + (p / c)^d)",),
    source="paper 2, the second of its eqs. 10, at one load; reference values without load",
    parameters=(
        PRESSURE,
        Parameter("a", "a", "angle", 85.109 * DEG, "final angle", 0.0, 3.2),
        Parameter("b", "b", "angle", -86.195 * DEG, "angle at the start less the final one", -3.2, 3.2),
        Parameter("c", "c", "pressure", 1.047706 * BAR, "pressure at half the way", 0.0, 5 * BAR, "", above=True),
        Parameter("d", "d", "count", 3.459321, "steepness", 0.0, 40.0, "", above=True),
    ),
    outputs=(ANGLE,),
    references=(
        Reference("angle", "84.12", "deg", DEG, "Table 1 of paper 2, 84.333, and the model's deviation there, -0.21",
                  {"pressure": 3.8 * BAR}),
        Reference("angle", "42.01", "deg", DEG, "by hand: a + b / 2", {"pressure": 1.047706 * BAR}),
    ),
    fitted=("a", "b", "c", "d"),
)  # fmt: skip
def arm_angle_at_load(pressure: Array, a: Array, b: Array, c: Array, d: Array) -> Values:
    """Gives alpha [rad] from p and c [Pa gauge], a and b [rad], d [1]."""
    return {"angle": a + b / (1 + (pressure / c) ** d)}


@described(
    "arm-angle-coefficients", "composition", "Bending angle of an arm over pressure and load, all coefficients open",
    equation=(
        "alpha = a + b / (1 + (p / c)^d);  a = a_0 + a_1 w + .. + a_4 w^4, w in kg;  b, c, d likewise",
    ),
    source="paper 2, the second of its eqs. 10; reference values are printed",
    parameters=(
        Parameter("pressure", "p", "pressure", 3.8 * BAR, "gauge pressure of the bending muscle", 0.0, 5 * BAR,
                  RANGE_BAR),
        Parameter("load", "w", "mass", 0.0, "mass at the arm's end", 0.0, 0.5, "0 to 0.5 kg were measured"),
        *(
            Parameter(f"{row}_{power}", f"{row}_{power}", quantity, float(value) * unit, f"of w^{power} in {row}",
                      origin="printed")
            for (row, (unit, quantity)), values in zip(ROWS.items(), ARM, strict=True)
            for power, value in enumerate(values)
        ),
    ),
    outputs=(ANGLE,),
    references=(
        Reference("angle", "84.12", "deg", DEG, "Table 1 of paper 2, 84.333, and the model's deviation there, -0.21"),
        Reference("angle", "46.9", "deg", DEG, "Table 1, 47.0, and the deviation there, -0.13",
                  {"load": 0.5, "pressure": 2.8 * BAR}),
    ),
    fitted=tuple(f"{row}_{power}" for row in ROWS for power in range(5)),
    notes=("Five loads at least are needed for the powers of w; the curve at each is arm-angle-at-load.",),
)  # fmt: skip
def arm_angle_coefficients(
    pressure: Array,
    load: Array,
    a_0: Array,
    a_1: Array,
    a_2: Array,
    a_3: Array,
    a_4: Array,
    b_0: Array,
    b_1: Array,
    b_2: Array,
    b_3: Array,
    b_4: Array,
    c_0: Array,
    c_1: Array,
    c_2: Array,
    c_3: Array,
    c_4: Array,
    d_0: Array,
    d_1: Array,
    d_2: Array,
    d_3: Array,
    d_4: Array,
) -> Values:
    """Gives alpha [rad] from p [Pa gauge] and w [kg]; a [rad], b [rad], c [Pa] and d [1] per kg^n."""

    def at_load(*terms: Array) -> Array:
        return np.asarray(sum(term * load**power for power, term in enumerate(terms)))

    a, b = at_load(a_0, a_1, a_2, a_3, a_4), at_load(b_0, b_1, b_2, b_3, b_4)
    c, d = at_load(c_0, c_1, c_2, c_3, c_4), at_load(d_0, d_1, d_2, d_3, d_4)
    refuse("load", "the coefficient c is not above 0 there", c <= 0, load)
    return {"angle": a + b / (1 + (pressure / c) ** d)}
