"""Length, force and arm angle of home-made contractors, as fitted in paper 2 or with your own coefficients.

Only this file uses the units of the paper.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, BRAID_ANGLE, CONTRACTION, DEG, RADIUS, braid_factors
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse

CM = 1e-2
EXPONENTS = {"mended": -0.248, "printed": 0.75}
"""Power of L0 in the coefficient e: with the printed 0.75 the curve is nearly a step."""
RANGE_BAR = "the measurements go from 0 to 5 bar"
PRESSURE = Parameter("pressure", "p", "pressure", 3 * BAR, "gauge pressure", 0.0, 5 * BAR, RANGE_BAR)
ANGLE = Output("angle", "alpha", "angle", "bending angle, 0 for the straight arm")
LENGTHS = (
    Output("length", "L", "length", "length without load"), Output("contraction", "eps", "ratio", "(L0 - L) / L0"),
)  # fmt: skip


@described(
    "sigmoid-length", "length", "Free length of contractors of 15 to 40 cm over pressure",
    equation=(
        "L = a + b / [1 + (p / c)^d]^e - 0.009 L0 sqrt(p);  L, L0 in cm, p in bar (gauge)",
        "a = 0.4351 L0 + 0.0183 L0^2 - 0.0003 L0^3;  b = L0 - a",
        "c = -0.0141 L0 + 0.0031 L0^2 - 0.00006 L0^3;  d = 0.5487 L0 - 0.0136 L0^2 + 0.00007 L0^3",
        "e = 0.3694 L0^-0.248 (mended) or 0.3694 L0^0.75 (printed)",
    ),
    source="paper 2 eqs. 1-2",
    parameters=(
        PRESSURE,
        Parameter(
            "nominal_length", "L0", "length", 30 * CM, "length without pressure", 15 * CM, 40 * CM,
            "muscles of 15 to 40 cm were measured, and c and d fall below 0 further off",
        ),
        Parameter("exponent", "n", "", "mended", "power of L0 in e", choices=tuple(EXPONENTS)),
    ),
    outputs=(
        *LENGTHS,
        Output("c", "c", "pressure", "coefficient c"),
        Output("d", "d", "count", "coefficient d"),
        Output("e", "e", "count", "coefficient e"),
    ),
    references=(
        Reference("contraction", "22.7", "%", 0.01, "computed from the printed coefficients"),
        Reference("contraction", "35.9", "%", 0.01, "the same", {"nominal_length": 15 * CM, "pressure": 5 * BAR}),
        Reference("c", "0.7470", "bar", BAR, "the same"),
        Reference("d", "6.111", "", 1.0, "the same"),
        Reference("e", "0.1589", "", 1.0, "the same"),
        Reference("contraction", "30.6", "%", 0.01, "the same", {"exponent": "printed", "pressure": 5 * BAR}),
        Reference("length", "30", "cm", CM, "a + b = L0", {"pressure": 0.0}),
    ),
    notes=(
        "The printed exponent 0.75 puts 65 to 97 % of the contraction below 0.6 bar, against the paper's own "
        "zero-force pressure of 0.45 bar; -0.248, found in two public scripts, gives the sigmoid that is described.",
        "Rounding of the printed coefficients is worth 1.4 cm in a at 30 cm and 3.3 cm at 40 cm: compare shapes.",
        "An independent fit from corrected-force: their free contractions do not agree.",
    ),
)  # fmt: skip
def sigmoid_length(pressure: Array, nominal_length: Array, exponent: str) -> Values:
    """L [m], eps [1], c [Pa], d and e [1] from p [Pa gauge], L0 [m] and the exponent's name."""
    p, L0 = pressure / BAR, nominal_length / CM
    a = 0.4351 * L0 + 0.0183 * L0**2 - 0.0003 * L0**3
    b = 0.5649 * L0 - 0.0183 * L0**2 + 0.0003 * L0**3
    c = -0.0141 * L0 + 0.0031 * L0**2 - 0.00006 * L0**3
    d = 0.5487 * L0 - 0.0136 * L0**2 + 0.00007 * L0**3
    e = 0.3694 * L0 ** EXPONENTS[exponent]
    length = a + b / (1 + (p / c) ** d) ** e - 0.009 * L0 * np.sqrt(p)
    return {"length": length * CM, "contraction": (L0 - length) / L0, "c": c * BAR, "d": d, "e": e}


def contractor_force(
    pressure: Array, contraction: Array, radius: Array, braid_angle: Array, threshold: Array
) -> tuple[Array, Array]:
    """F [N] and q [1] from p and p0 [Pa gauge], eps [1], r0 [m], theta0 [rad] (paper 2 eqs. 8-9)."""
    a, b = braid_factors(braid_angle)
    q = 1 + np.exp(-pressure / BAR)
    drive = np.maximum(a * np.maximum(1 - q * contraction, 0) ** 2 - b, 0)
    return math.pi * radius**2 * np.maximum(pressure - threshold, 0) * drive, q


@described(
    "corrected-force", "static force", "Force with a dead band of pressure and the correction q(p)",
    equation=(
        "F = 0 for p <= p0;  F = pi r0^2 (p - p0) [a (1 - q eps)^2 - b] for p > p0",
        "q = 1 + exp(-p / 1 bar);  a = 3 / tan^2 theta0;  b = 1 / sin^2 theta0;  eps_max = (1 - sqrt(b / a)) / q",
    ),
    source="paper 2 eqs. 8-9",
    fitted=("radius", "braid_angle", "threshold"),
    parameters=(
        Parameter("pressure", "p", "pressure", 5 * BAR, "gauge pressure", 0.0, 5 * BAR, RANGE_BAR),
        CONTRACTION, RADIUS, BRAID_ANGLE,
        Parameter(
            "threshold", "p0", "pressure", 0.45 * BAR, "pressure below which there is no force; 0.6 bar in paper 4",
            0.0, 2 * BAR, "", "printed",
        ),
    ),
    outputs=(
        Output("force", "F", "force", "pulling force; 0 in the dead band and beyond eps_max"),
        Output("q", "q", "count", "correction of the contraction"),
        Output("contraction_max", "eps_max", "ratio", "contraction at which the force is 0"),
    ),
    references=(
        Reference("q", "2", "", 1.0, "closed form", {"pressure": 0.0}),
        Reference("q", "1.6376", "", 1.0, "closed form", {"pressure": 0.45 * BAR}),
        Reference("q", "1.0067", "", 1.0, "closed form"),
        Reference("contraction_max", "0.222", "", 1.0, "closed form, theta0 = 25 deg", {"pressure": 0.45 * BAR}),
        Reference("contraction_max", "0.361", "", 1.0, "closed form, theta0 = 25 deg"),
        Reference("force", "0", "N", 1.0, "the threshold", {"pressure": 0.45 * BAR}),
    ),
    notes=(
        "In the print q = 1 + 1e^-p is 1 + 1 times e^-p, p in bar, not 10^-p; and the factor 1e5 of bar is left out.",
        "The dead band is a fitted parameter: 0.45 bar in paper 2, 0.6 bar in paper 4.",
    ),
)  # fmt: skip
def corrected_force(pressure: Array, contraction: Array, radius: Array, braid_angle: Array, threshold: Array) -> Values:
    """F [N], q and eps_max [1] from p and p0 [Pa gauge], eps [1], r0 [m], theta0 [rad]."""
    a, b = braid_factors(braid_angle)
    force, q = contractor_force(pressure, contraction, radius, braid_angle, threshold)
    return {"force": force, "q": q, "contraction_max": (1 - np.sqrt(b / a)) / q}


ARM = np.array(
    [
        [85.109, 68.4155, -915.4121, 2145.117, -1779.245],
        [-86.195, -69.7074, 940.9097, -2210.206, 1837.185],
        [1.047706, 0.1331478, -4.69328, 18.98427, -21.75253],
        [3.459321, 0.7990463, -24.19429, 84.25137, -67.01067],
    ]
)
"""Rows a [deg], b [deg], c [bar], d [1] in powers of the load [kg], lowest first (paper 2)."""


@described(
    "arm-angle", "composition", "Bending angle of an arm of four contractors of 30 cm under a load",
    equation=(
        "alpha = a + b / (1 + (p / c)^d);  alpha in deg, p in bar (gauge)",
        "(a, b, c, d) = M (1, w, w^2, w^3, w^4), w in kg",
        *("  " + name + ": " + ", ".join(f"{value:g}" for value in row) for name, row in zip("abcd", ARM, strict=True)),
    ),
    source="paper 2, the second of its eqs. 10",
    parameters=(
        Parameter(
            "pressure", "p", "pressure", 3.8 * BAR, "gauge pressure of the bending muscle, the others at 0.45 bar",
            0.45 * BAR, 5 * BAR, "the arm starts at 0.45 bar in all muscles, and 5 bar is the most that was tried",
        ),
        Parameter(
            "load", "w", "mass", 0.0, "mass at the arm's end", 0.0, 0.5,
            "0 to 0.5 kg were measured; at 0.6 kg the polynomials give nonsense",
        ),
    ),
    outputs=(ANGLE,),
    references=(
        Reference("angle", "84.12", "deg", DEG, "Table 1 of paper 2, 84.333, and the model's deviation there, -0.21"),
        Reference("angle", "46.9", "deg", DEG, "Table 1, 47.0, and the deviation there, -0.13",
                  {"load": 0.5, "pressure": 2.8 * BAR}),
    ),
    notes=(
        "Monotone in p: the pressure of the largest angle in the paper's Table 1 is where the measured curve "
        "flattened.",
        "Between the loads that were measured the polynomials ripple: at 0.05 kg the angle is larger than without "
        "load.",
        "At 0.45 bar the model gives 2 to 5 deg where the arm was straight.",
    ),
)  # fmt: skip
def arm_angle(pressure: Array, load: Array) -> Values:
    """Alpha [rad] from p [Pa gauge] and w [kg]."""
    a, b, c, d = (sum(value * load**power for power, value in enumerate(row)) for row in ARM)
    refuse("load", "the coefficient c is not above 0 there", c <= 0)
    return {"angle": (a + b / (1 + (pressure / BAR / c) ** d)) * DEG}


ROWS = {"a": (DEG, "angle"), "b": (DEG, "angle"), "c": (BAR, "pressure"), "d": (1.0, "count")}
"""Rows of the matrix of the arm's angle: SI value of the print's unit, quantity."""


@described(
    "sigmoid-length-coefficients", "length", "Free length of one muscle over pressure, with fitted a to e",
    equation=("L = a + b / [1 + (p / c)^d]^e - r L0 sqrt(p / 1 bar)",),
    source="paper 2 eq. 1; reference values are its eq. 2 at 30 cm with the mended exponent",
    parameters=(
        replace(PRESSURE, high=5.05 * BAR, reason=f"{RANGE_BAR}, and regulators rest a little beside a set-point"),
        Parameter("nominal_length", "L0", "length", 30 * CM, "length without pressure", 0.0, 2.0, "", above=True),
        Parameter("a", "a", "length", 21.423 * CM, "length that is left", 0.0, 2.0),
        Parameter("b", "b", "length", 8.577 * CM, "what the sigmoid takes off; a + b = L0 in paper 2", 0.0, 2.0),
        Parameter("c", "c", "pressure", 0.747 * BAR, "pressure of the knee", 0.0, 10 * BAR, "", above=True),
        Parameter("d", "d", "count", 6.111, "steepness", 0.0, 60.0, "", above=True),
        Parameter("e", "e", "count", 0.1589, "exponent", 0.0, 10.0, "", above=True),
        Parameter("r", "r", "count", 0.009, "share of L0 that goes on with the root of p", 0.0, 0.1, "", "printed"),
    ),
    outputs=LENGTHS,
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
    "arm-angle-at-load", "composition", "Bending angle of an arm at one load, with fitted coefficients",
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
    """Alpha [rad] from p and c [Pa gauge], a and b [rad], d [1]."""
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
def arm_angle_coefficients(pressure: Array, load: Array, *terms: Array) -> Values:
    """Alpha [rad] from p [Pa gauge] and w [kg]; five terms each of a [rad], b [rad], c [Pa] and d [1], per kg^n."""
    a, b, c, d = (
        np.asarray(sum(term * load**power for power, term in enumerate(terms[first : first + 5])))
        for first in range(0, 20, 5)
    )
    refuse("load", "the coefficient c is not above 0 there", c <= 0, load)
    return {"angle": a + b / (1 + (pressure / c) ** d)}
