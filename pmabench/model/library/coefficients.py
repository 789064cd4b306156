"""Coefficients over pressure, published or your own, each valid only at the pressures that it was fitted on.

Your own can be parabolas, or polynomials up to the sixth order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, BRAID_ANGLE, DEG, MM, braid_force
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse
from pmabench.model.library.three_element import FAMILY, LOAD
from pmabench.model.muscle import Muscle
from pmabench.model.presets import paper0, serres2009

KPA, N_MM = 1e3, 1e3
OUTPUTS = (
    Output("force_ce", "F_ce", "force", "contractile force at x = 0"),
    Output("stiffness", "K", "stiffness", "stiffness"),
    Output("damping_contract", "B_c", "damping", "damping while it contracts"),
    Output("damping_relax", "B_r", "damping", "damping while it relaxes"),
    Output("displacement", "x", "length", "contraction at rest under the load"),
    Output("tau_contract", "tau_c", "time", "B_c / K"),
    Output("tau_relax", "tau_r", "time", "B_r / K"),
)


def with_motion(F_ce: Array, K: Array, B_c: Array, B_r: Array, load: Array) -> Values:
    """The values of `OUTPUTS` from F_ce and F_L [N], K [N/m], B_c and B_r [N.s/m]."""
    return {
        "force_ce": F_ce, "stiffness": K, "damping_contract": B_c, "damping_relax": B_r,
        "displacement": np.maximum(F_ce - load, 0) / K, "tau_contract": B_c / K, "tau_relax": B_r / K,
    }  # fmt: skip


def _coefficients(muscle: Muscle, pressure: Array, load: Array) -> Values:
    F_ce, K, B_c, B_r = (curve.values(pressure) for curve in (muscle.F_ce, muscle.K, muscle.B_c, muscle.B_r))
    return with_motion(F_ce, K, B_c, B_r, load)


@described(
    "mas-20-250-paper0", FAMILY, "MAS-20-250 with coefficients that give the ranges of paper 0: the simulated bench",
    equation=(
        "P in kPa: F_ce = 1.08 P - 49.0 >= 0 N;  K = 5.6 + 1.0e-3 P + 9.7e-6 P^2 N/mm",
        "B_c = 1.2 + 1.6e-3 P;  B_r = 1.1 + 3.4e-3 P N.s/mm;  x = (F_ce - F_L) / K",
    ),
    source="assumed, because paper 0 prints no coefficients: 10 to 60 mm on 100 to 550 kPa, 59 to 545 N of F_ce",
    parameters=(
        Parameter(
            "pressure", "P", "pressure", 300 * KPA, "gauge pressure", 0.0, 600 * KPA,
            "the muscle's limit is 600 kPa",
        ),
        LOAD,
    ),
    outputs=OUTPUTS,
    references=(
        Reference("force_ce", "275", "N", 1.0, "by hand from the coefficients"),
        Reference("stiffness", "6.773", "N/mm", N_MM, "the same"),
        Reference("displacement", "40.60", "mm", MM, "the same"),
        Reference("tau_contract", "0.248", "s", 1.0, "the same"),
        Reference("tau_relax", "0.313", "s", 1.0, "the same"),
        Reference("displacement", "59.99", "mm", MM, "the same", {"pressure": 550 * KPA}),
    ),
    notes=("Invented, and consistent with what paper 0 prints; not a measured muscle.",),
)  # fmt: skip
def mas_20_250_paper0(pressure: Array, load: Array) -> Values:
    """F_ce [N], K [N/m], B_c and B_r [N.s/m], x [m], tau_c and tau_r [s] from P [Pa gauge], F_L [N]."""
    return _coefficients(paper0(), pressure, load)


@described(
    "mas-20-250-serres2009", FAMILY, "MAS-20-250 as Serres and others fitted it in 2009",
    equation=(
        "P in kPa: F_ce = 2.91 P + 44.6 N;  B_c = 2.90 N.s/mm",
        "K = 32.7 - 0.0321 P to 314 kPa, 17 + 0.0179 P above, N/mm",
        "B_r = 1.57 to 372 kPa, 0.311 + 0.00338 P above, N.s/mm;  x = (F_ce - F_L) / K",
    ),
    source="Serres and others 2009, abstract",
    parameters=(
        Parameter(
            "pressure", "P", "pressure", 550 * KPA, "gauge pressure", 150 * KPA, 550 * KPA,
            "fitted on 150 to 550 kPa; F_ce would be 44.6 N without pressure",
        ),
        LOAD,
    ),
    outputs=OUTPUTS,
    references=(
        Reference("displacement", "61.3", "mm", MM, "by hand from the coefficients"),
        Reference("displacement", "17.3", "mm", MM, "the same", {"pressure": 150 * KPA}),
        Reference("force_ce", "1645.1", "N", 1.0, "the same"),
    ),
    notes=("It relaxes faster than it contracts, unlike the muscle of paper 1.",),
)  # fmt: skip
def mas_20_250_serres2009(pressure: Array, load: Array) -> Values:
    """F_ce [N], K [N/m], B_c and B_r [N.s/m], x [m], tau_c and tau_r [s] from P [Pa gauge], F_L [N]."""
    return _coefficients(serres2009(), pressure, load)


CENTRE, SCALE = 3.5e5, 1.6583e5
POLYNOMIALS = {
    "S": (340.0, -490.0, -460.0, 340.0, 660.0, 16000.0, 45000.0),
    "D_c": (220.0, -350.0, -530.0, 770.0, 1400.0, 2500.0, 18000.0),
    "D_r": (-860.0, 1500.0, 3800.0, -5300.0, 380.0, 37000.0, 49000.0),
}
"""Paper 1 eqs. 17-19, highest power of z = (P - CENTRE) / SCALE first; N/m and N.s/m."""
LINES = {"S": (0.09069, 14133.0), "D_c": (0.01608, 13481.0), "D_r": (0.19929, -17225.0)}
"""Straight lines fitted to the polynomials at 1.0, 1.5 .. 6.0 bar: slope per Pa, value at 0."""
DMSP_PRESSURE = Parameter(
    "pressure", "P", "pressure", 6 * BAR, "gauge pressure", 1 * BAR, 6 * BAR,
    "fitted on 1 to 6 bar; below 0.594 bar the damping of relaxation would be negative",
)  # fmt: skip
DMSP_SHAPE = DMSP_RADIUS, DMSP_LENGTH, DMSP_ANGLE = 20 * MM, 305 * MM, 26.5 * DEG
"""Radius and length [m], nominal, and a braid angle at eps = 0 [rad] that fits the printed stiffness (assumed)."""
FIT = Parameter("fit", "fit", "", "polynomial", "sixth order, or the straight lines", choices=("polynomial", "line"))


def dmsp_coefficients(pressure: Array, fit: str) -> tuple[Array, Array, Array]:
    """S [N/m], D_c and D_r [N.s/m] of paper 1 at P [Pa gauge], 1 to 6 bar."""
    known, z = (LINES, pressure) if fit == "line" else (POLYNOMIALS, (pressure - CENTRE) / SCALE)
    return tuple(np.polyval(known[name], z) for name in POLYNOMIALS)  # type: ignore[return-value]


@described(
    "dmsp-40-305", FAMILY, "Stiffness and damping of a DMSP-40-305 over pressure",
    equation=(
        "z = (P - 3.5e5) / 1.6583e5, P in Pa;  S, D_c, D_r: polynomials of sixth order in z, highest power first",
        *("  " + name + ": " + ", ".join(f"{value:g}" for value in row) for name, row in POLYNOMIALS.items()),
        *(f"  {name} as a line: {line[1]:g} + {line[0]:g} P" for name, line in LINES.items()),
    ),
    source="paper 1 eqs. 17-20",
    parameters=(DMSP_PRESSURE, FIT),
    outputs=(
        Output("stiffness", "S", "stiffness", "stiffness"),
        Output("damping_contract", "D_c", "damping", "damping of contraction"),
        Output("damping_relax", "D_r", "damping", "damping of relaxation, by the pressure before the release"),
        Output("tau_contract", "tau_c", "time", "D_c / S"),
        Output("tau_relax", "tau_r", "time", "D_r / S"),
    ),
    references=(
        Reference("stiffness", "69.59", "N/mm", 1e3, "computed from the printed coefficients"),
        Reference("damping_contract", "24.71", "N.s/mm", 1e3, "the same"),
        Reference("damping_relax", "108.70", "N.s/mm", 1e3, "the same"),
        Reference("tau_contract", "0.355", "s", 1.0, "the same"),
        Reference("tau_relax", "1.562", "s", 1.0, "the same"),
        Reference("damping_relax", "10.09", "N.s/mm", 1e3, "the same", {"pressure": 1 * BAR}),
        Reference("tau_relax", "0.379", "s", 1.0, "the same", {"pressure": 1 * BAR}),
    ),
    notes=(
        "The captions of paper 1 start at 0.5 and 0 bar; the fit does not, and is refused there.",
        "Printed with two digits: worth 21 % of D_r at 1 bar, 9 % at 1.5 bar, 1 to 5 % elsewhere.",
    ),
)  # fmt: skip
def dmsp_40_305(pressure: Array, fit: str) -> Values:
    """S [N/m], D_c and D_r [N.s/m], tau_c and tau_r [s] from P [Pa gauge] and the name of the fit."""
    S, D_c, D_r = dmsp_coefficients(pressure, fit)
    return {
        "stiffness": S, "damping_contract": D_c, "damping_relax": D_r, "tau_contract": D_c / S, "tau_relax": D_r / S
    }  # fmt: skip


@described(
    "dmsp-40-305-contraction", FAMILY, "Contraction of a DMSP-40-305 with F_ce at x = 0 or at x_max",
    equation=(
        "S(P) x = F_ce - L;  F_ce = F(eps) of tondu-lopez with k = 1, S(P) of dmsp-40-305",
        "eps = 0 (fce_at x0) or eps = x / L0, solved with the balance (fce_at xmax)",
    ),
    source="paper 1 eqs. 10 and 17 (xmax); paper 0's meaning of F_ce (x0); theta0, r0 and L assumed, not printed",
    parameters=(
        DMSP_PRESSURE,
        Parameter("load", "L", "force", 5.0, "load, half the muscle's weight when it hangs", 0.0, INF, "", "assumed"),
        Parameter("radius", "r0", "length", DMSP_RADIUS, "radius at eps = 0", 0.0, 1.0, "", "nominal", above=True),
        Parameter(
            "nominal_length", "L0", "length", DMSP_LENGTH, "nominal length", 0.0, 10.0, "", "nominal", above=True
        ),
        Parameter(
            "braid_angle", "theta0", "angle", DMSP_ANGLE, "angle of the braid to the axis at eps = 0", 0.0,
            BRAID_ANGLE.high, BRAID_ANGLE.reason, "assumed", above=True,
        ),
        Parameter("fce_at", "", "", "x0", "where F_ce is taken", choices=("x0", "xmax")),
    ),
    outputs=(
        Output("force_ce", "F_ce", "force", "contractile force in this convention"),
        Output("displacement", "x", "length", "contraction at rest"),
        Output("contraction", "eps", "ratio", "x / L0"),
        Output("stiffness", "S", "stiffness", "stiffness"),
    ),
    references=(
        Reference("force_ce", "5312", "N", 1.0, "885.4 N/bar at 6 bar"),
        Reference("displacement", "76.3", "mm", MM, "computed from the printed polynomial"),
        Reference("displacement", "33.0", "mm", MM, "the same", {"pressure": 1 * BAR}),
        Reference("displacement", "42.4", "mm", MM, "the same", {"fce_at": "xmax"}),
        Reference("displacement", "24.3", "mm", MM, "the same", {"fce_at": "xmax", "pressure": 1 * BAR}),
    ),
    notes=(
        "One convention in plant and fit: a plant whose F_ce follows x has a time constant other than D / S (0.20 s "
        "for 0.355 s at 6 bar).",
    ),
)  # fmt: skip
def dmsp_40_305_contraction(
    pressure: Array, load: Array, radius: Array, nominal_length: Array, braid_angle: Array, fce_at: str
) -> Values:
    """F_ce [N], x [m], eps [1], S [N/m] from P [Pa gauge], L [N], r0 and L0 [m], theta0 [rad]."""
    arrays = np.broadcast_arrays(pressure, load, radius, nominal_length, braid_angle)
    shape = arrays[0].shape
    S = dmsp_coefficients(arrays[0], "polynomial")[0]
    force0, most = braid_force(arrays[0], np.zeros(shape), arrays[2], arrays[4], np.ones(shape))
    refuse("load", "it is more than the muscle lifts at this pressure", arrays[1] > force0, arrays[1])
    force = force0
    if fce_at == "xmax":
        force = np.vectorize(_at_rest, otypes=[float])(*arrays, S, most)
    x = (force - arrays[1]) / S
    return {"force_ce": force, "displacement": x, "contraction": x / arrays[3], "stiffness": S}


def _at_rest(P: float, load: float, radius: float, length: float, angle: float, S: float, most: float) -> float:
    """F_ce [N] at the contraction where it balances S x + load."""

    def force(eps: float) -> float:
        one = np.asarray(1.0)
        return float(braid_force(one * P, one * eps, one * radius, one * angle, one)[0])

    return force(brentq(lambda eps: force(eps) - load - S * eps * length, 0.0, most, xtol=1e-15))


PRESSURE = Parameter("pressure", "P", "pressure", 300 * KPA, "gauge pressure", 0.0, INF, "gauge pressure of a muscle")


def within(pressure: Array, low: Array, high: Array) -> None:
    """Raise OutsideDomain for pressures outside the range of a fit, all [Pa gauge]."""
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


HIGHEST = 6
"""Highest power of a polynomial."""


def _polynomial(
    name: str, title: str, output: Output, printed: tuple[float, ...], least: float, references: tuple[Reference, ...]
) -> Callable[..., Values]:
    """Register one polynomial model; `printed`: coefficients, highest power first.

    Negative values are refused, and also 0 if `least` is above 0.
    """
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
