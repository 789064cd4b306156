"""Polynomials over pressure with centre and scale, as paper 1 writes them; their coefficients are inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR
from pmabench.model.library.coefficients import CENTRE, POLYNOMIALS, SCALE
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse
from pmabench.model.library.fitted import KPA, limits, within
from pmabench.model.library.three_element import FAMILY

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
    def polynomial(
        pressure: Array,
        centre: Array,
        scale: Array,
        order: Array,
        pressure_low: Array,
        pressure_high: Array,
        c_0: Array,
        c_1: Array,
        c_2: Array,
        c_3: Array,
        c_4: Array,
        c_5: Array,
        c_6: Array,
    ) -> Values:
        """The coefficient [SI] from P, centre, scale and limits [Pa gauge], order [1], terms [as the coefficient]."""
        within(pressure, pressure_low, pressure_high)
        refuse("order", "a whole number is expected", order != np.round(order), order)
        z = (pressure - centre) / scale
        value = np.zeros(np.broadcast_shapes(np.shape(z), np.shape(order), np.shape(c_0)))
        for power, term in reversed(list(enumerate((c_0, c_1, c_2, c_3, c_4, c_5, c_6)))):
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
