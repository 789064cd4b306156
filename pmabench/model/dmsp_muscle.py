"""The DMSP-40-305 of paper 1 as a three-element muscle: printed S and D, F_ce from the braid; knows no friction.

S and D are those of `pmabench.model.library.coefficients`, fitted on 1 to 6 bar; outside they keep the value of the
nearer end, so that the damping is never negative. The braid's angle is the library's default: paper 1 prints none.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from pmabench.model.curve import Curve
from pmabench.model.library.coefficients import CENTRE, DMSP_PRESSURE, POLYNOMIALS, SCALE
from pmabench.model.library.description import MODELS
from pmabench.model.muscle import Muscle

LOW, HIGH = DMSP_PRESSURE.low, DMSP_PRESSURE.high
STOP = 0.30
"""Contraction at which it can go no further [1]: beyond the 25 % of 6 bar."""
GRID = np.linspace(LOW, HIGH, 501)
ORDER = 10
"""Order of the polynomial that replaces F_ce at x_max over pressure: within 0.02 N, worth 0.3 um."""
FCE_EVAL = ("x0", "xmax")


def dmsp_40_305(fce_eval: str = "x0") -> Muscle:
    """The muscle with F_ce at x = 0, or with `xmax` at the contraction that it comes to under 5 N, as in paper 1.

    It relaxes with the time constant D_r / S of the pressure before the release, as paper 1 prints it.
    """
    length = next(p.value for p in MODELS["dmsp-40-305-contraction"].parameters if p.name == "nominal_length")
    tau_r = _printed("D_r").values(GRID) / _printed("S").values(GRID)
    return Muscle(
        name="DMSP-40-305",
        F_ce=_contractile_force(fce_eval),
        K=_printed("S"),
        B_c=_printed("D_c"),
        B_r=_printed("D_r"),
        tau_r=Curve.through(GRID.tolist(), tau_r.tolist()),
        length=float(length),
        stop=STOP * float(length),
    )


def _contractile_force(fce_eval: str) -> Curve:
    """F_ce(P) [N]; below 1 bar a straight line to no force without pressure."""
    if fce_eval not in FCE_EVAL:
        raise ValueError(f'fce_eval can only be {" or ".join(FCE_EVAL)}, not "{fce_eval}"')
    F = MODELS["dmsp-40-305-contraction"].evaluate({"pressure": GRID, "fce_at": fce_eval})["force_ce"]
    line = (float(F[0]) / LOW, 0.0)
    if fce_eval == "x0":
        return Curve((line,))
    return _held(Polynomial.fit(GRID, F, ORDER).convert(), below=line)


def _printed(symbol: str) -> Curve:
    """One of paper 1's polynomials of z = (P - CENTRE) / SCALE, as one of P [Pa]."""
    z = Polynomial([-CENTRE / SCALE, 1 / SCALE])
    return _held(Polynomial(POLYNOMIALS[symbol][::-1])(z))


def _held(polynomial: Polynomial, below: tuple[float, ...] = ()) -> Curve:
    """A polynomial of P on 1 to 6 bar, `below` under it, and constant where nothing else is said."""
    inside = tuple(float(c) for c in polynomial.coef[::-1])
    return Curve((below or (float(polynomial(LOW)),), inside, (float(polynomial(HIGH)),)), (LOW, HIGH))
