"""Coefficients over pressure that somebody fitted, with the pressures they hold for: parabolas, lines, polynomials."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, MM
from pmabench.model.library.coefficients import CENTRE, KPA, N_MM, OUTPUTS, POLYNOMIALS, SCALE, with_motion
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse
from pmabench.model.library.three_element import FAMILY, LOAD

PRESSURE = Parameter("pressure", "P", "pressure", 300 * KPA, "gauge pressure", 0.0, INF, "gauge pressure of a muscle")


def within(pressure: Array, low: Array, high: Array) -> None:
    """Refuse pressures outside of what a fit holds for, all [Pa gauge]."""
    refuse("pressure_high", "it must be above pressure_low", high <= low)
    outside = (pressure < low * (1 - 1e-12)) | (pressure > high * (1 + 1e-12))
    refuse("pressure", "the coefficients hold from pressure_low to pressure_high only", outside, pressure)


def _sound(pressure: Array, stiffness: Array, *dampings: Array) -> None:
    refuse("pressure", "the stiffness would not be above 0 there: the fit does not hold", stiffness <= 0, pressure)
    for damping in dampings:
        refuse("pressure", "the damping would be negative there: the fit does not hold", damping < 0, pressure)


def limits(low: float, high: float) -> tuple[Parameter, ...]:
    """The inputs pressure_low and pressure_high [Pa gauge]."""
    return (
        Parameter("pressure_low", "P_low", "pressure", low, "lowest pressure of the fit", 0.0),
        Parameter("pressure_high", "P_high", "pressure", high, "highest pressure of the fit", 0.0),
    )


def _coefficient(name: str, symbol: str, base: str, values: tuple[float, ...]) -> tuple[Parameter, ...]:
    """Parameters name_0, name_1 .. of a polynomial; `base` is the quantity at power 0, values per kPa**power."""
    per = ("", " per pressure", " per pressure squared")
    return tuple(
        Parameter(f"{name}_{n}", f"{symbol}_{n}", base + per[n], value / KPA**n, f"of P^{n} in {symbol}")
        for n, value in enumerate(values)
    )


TERMS = (
    *_coefficient("force", "F", "force", (-49.0, 1.08)),
    *_coefficient("stiffness", "K", "stiffness", (5.6 * N_MM, 1.0e-3 * N_MM, 9.7e-6 * N_MM)),
    *_coefficient("damping_contract", "B_c", "damping", (1.2 * N_MM, 1.6e-3 * N_MM, 0.0)),
    *_coefficient("damping_relax", "B_r", "damping", (1.1 * N_MM, 3.4e-3 * N_MM, 0.0)),
)


@described(
    "polynomial-coefficients", FAMILY, "Your own F_ce line, K and B parabolas, and what they make",
    equation=(
        "F_ce = F_0 + F_1 P, not below 0;  K = K_0 + K_1 P + K_2 P^2;  B_c, B_r likewise",
        "x = (F_ce - F_L) / K;  tau = B / K;  P_low <= P <= P_high",
    ),
    source="form of paper 0's curve fits; reference values are those of mas-20-250-paper0",
    fitted=tuple(term.name for term in TERMS),
    parameters=(PRESSURE, LOAD, *limits(100 * KPA, 600 * KPA), *TERMS),
    outputs=OUTPUTS,
    references=(
        Reference("stiffness", "6.773", "N/mm", N_MM, "by hand: 5.6 + 0.3 + 0.873"),
        Reference("displacement", "40.60", "mm", MM, "by hand: 275 / 6.773"),
        Reference("tau_relax", "0.313", "s", 1.0, "by hand: 2.12 / 6.773"),
    ),
    notes=("Refused where K is not above 0 or B would be negative, also inside of P_low to P_high.",),
)  # fmt: skip
def polynomial_coefficients(
    pressure: Array, load: Array, pressure_low: Array, pressure_high: Array, *terms: Array
) -> Values:
    """F_ce [N], K [N/m], B_c and B_r [N.s/m], x [m], tau [s]; P [Pa gauge], F_L [N], `TERMS` SI per Pa**n."""
    P = pressure
    within(P, pressure_low, pressure_high)
    F_ce = np.maximum(terms[0] + terms[1] * P, 0)
    K, B_c, B_r = (a + P * (b + P * c) for a, b, c in (terms[2:5], terms[5:8], terms[8:]))
    _sound(pressure, K, B_c, B_r)
    return with_motion(F_ce, K, B_c, B_r, load)


@described(
    "piecewise-coefficients", FAMILY, "Your own K and B of two straight lines each, joined at a pressure",
    equation=(
        "K = Ka_0 + Ka_1 P below P_K, Kb_0 + Kb_1 P from there on;  B = Ba_0 + Ba_1 P below P_B, Bb_0 + Bb_1 P from "
        "there on",
        "jump = upper less lower line where they join;  P_low <= P <= P_high",
    ),
    source="form of Serres and others 2009; reference values are theirs (B: relaxation)",
    fitted=(
        "stiffness_below_0", "stiffness_below_1", "stiffness_above_0", "stiffness_above_1", "damping_below_0",
        "damping_below_1", "damping_above_0", "damping_above_1",
    ),
    parameters=(
        PRESSURE, *limits(150 * KPA, 550 * KPA),
        *_coefficient("stiffness_below", "Ka", "stiffness", (32.7 * N_MM, -0.0321 * N_MM)),
        Parameter("stiffness_break", "P_K", "pressure", 314 * KPA, "where the lines of K join", 0.0),
        *_coefficient("stiffness_above", "Kb", "stiffness", (17.0 * N_MM, 0.0179 * N_MM)),
        *_coefficient("damping_below", "Ba", "damping", (1.57 * N_MM, 0.0)),
        Parameter("damping_break", "P_B", "pressure", 372 * KPA, "where the lines of B join", 0.0),
        *_coefficient("damping_above", "Bb", "damping", (0.311 * N_MM, 0.00338 * N_MM)),
    ),
    outputs=(
        Output("stiffness", "K", "stiffness", "stiffness"),
        Output("damping", "B", "damping", "damping"),
        Output("tau", "tau", "time", "B / K"),
        Output("stiffness_jump", "", "stiffness", "of K at the join"),
        Output("damping_jump", "", "damping", "of B at the join"),
    ),
    references=(
        Reference("stiffness", "27.885", "N/mm", N_MM, "by hand: 32.7 - 0.0321 150", {"pressure": 150 * KPA}),
        Reference("stiffness", "24.160", "N/mm", N_MM, "by hand: 17 + 0.0179 400", {"pressure": 400 * KPA}),
        Reference("damping", "1.663", "N.s/mm", N_MM, "by hand: 0.311 + 0.00338 400", {"pressure": 400 * KPA}),
        Reference("stiffness_jump", "0.000", "N/mm", N_MM, "by hand: 15.7 - 0.05 314"),
    ),
    notes=("A jump at the join is an output of the model: lines of two fits seldom meet exactly.",),
)  # fmt: skip
def piecewise_coefficients(pressure: Array, pressure_low: Array, pressure_high: Array, *lines: Array) -> Values:
    """K [N/m], B [N.s/m], tau [s] and the jumps; P [Pa gauge], `lines` of K and of B: below, join, above (SI)."""
    within(pressure, pressure_low, pressure_high)
    values, jumps = [], []
    for low_0, low_1, join, high_0, high_1 in (lines[:5], lines[5:]):
        values.append(np.where(join <= pressure, high_0 + high_1 * pressure, low_0 + low_1 * pressure))
        jumps.append(high_0 - low_0 + (high_1 - low_1) * join + 0 * pressure)
    K, B = values
    _sound(pressure, K, B)
    return {"stiffness": K, "damping": B, "tau": B / K, "stiffness_jump": jumps[0], "damping_jump": jumps[1]}


HIGHEST = 6
"""Highest power."""


def _polynomial(
    name: str, title: str, output: Output, printed: tuple[float, ...], least: float, references: tuple[Reference, ...]
) -> Callable[..., Values]:
    """Enter one polynomial; `printed` are its coefficients, highest power first, values below `least` are refused."""
    symbol, lowest_first = output.symbol, tuple(reversed(printed))

    @described(
        name, FAMILY, title,
        equation=(
            f"{symbol} = c_0 + c_1 z + .. + c_n z^n;  z = (P - centre) / scale;  n = order;  P_low <= P <= P_high",
        ),
        source="form and reference values of paper 1, eqs. 17-19",
        parameters=(
            Parameter("pressure", "P", "pressure", 6 * BAR, "gauge pressure", 0.0, 1e6, "no pressure of a muscle"),
            Parameter("centre", "", "pressure", CENTRE, "the mean of the pressures", 0.0, 1e6, "", "printed"),
            Parameter(
                "scale", "", "pressure", SCALE, "their standard deviation", 0.0, 1e6, "", "printed", above=True
            ),
            Parameter("order", "n", "count", float(HIGHEST), "highest power; terms above it are left out", 0.0, 6.0),
            *limits(1 * BAR, 6 * BAR),
            *(
                Parameter(f"c_{n}", f"c_{n}", output.quantity, value, f"of z^{n}", origin="printed")
                for n, value in enumerate(lowest_first)
            ),
        ),
        outputs=(output,),
        references=references,
        fitted=tuple(f"c_{n}" for n in range(len(printed))),
        notes=(
            f"Refused where {symbol} would be {'negative' if least == 0 else 'not above 0'}: the polynomial does not "
            "hold there.",
        ),
    )  # fmt: skip
    def polynomial(pressure: Array, centre: Array, scale: Array, order: Array, *rest: Array) -> Values:
        """The coefficient [SI] from P, centre, scale and limits [Pa gauge], order [1], terms [as the coefficient]."""
        low, high, *terms = rest
        within(pressure, low, high)
        refuse("order", "a whole number is expected", order != np.round(order), order)
        z = (pressure - centre) / scale
        value = np.zeros(np.broadcast_shapes(np.shape(z), np.shape(order), np.shape(terms[0])))
        for power, term in reversed(list(enumerate(terms))):
            value = value * z + np.where(power <= order, term, 0.0)
        short = value <= 0 if least > 0 else value < 0
        refuse("pressure", f"{symbol} would be {'negative' if least == 0 else 'not above 0'} there", short, pressure)
        return {output.name: value}

    return polynomial


stiffness_polynomial = _polynomial(
    "stiffness-polynomial", "Stiffness as a polynomial with centre and scale",
    Output("stiffness", "K", "stiffness", "stiffness"), POLYNOMIALS["S"], 1.0,
    (
        Reference("stiffness", "69.59", "N/mm", KPA, "table of paper 1's polynomial S"),
        Reference("stiffness", "45.00", "N/mm", KPA, "by hand: c_0", {"pressure": 3.5 * BAR}),
    ),
)  # fmt: skip
damping_polynomial = _polynomial(
    "damping-polynomial", "Damping as a polynomial with centre and scale",
    Output("damping", "B", "damping", "damping"), POLYNOMIALS["D_c"], 0.0,
    (
        Reference("damping", "24.71", "N.s/mm", KPA, "table of paper 1's polynomial D_c"),
        Reference("damping", "18.00", "N.s/mm", KPA, "by hand: c_0", {"pressure": 3.5 * BAR}),
    ),
)  # fmt: skip
