"""An identified muscle as a model of the library: force, stiffness, loop width and damping at a place."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.library.description import Model, Output, Parameter, Values, refuse

WAYS = (True, False)
"""Contracting, and relaxing."""
UNTESTED = "beyond what was tested"
AMPLITUDE = 5e-3
"""Stroke of the loop whose width is given, either way, where none is asked for [m]."""


def as_model(muscle: IdentifiedMuscle, name: str, source: str, note: str) -> Model:
    """The model `name` of a muscle; outside the tested pressures [Pa] and contractions [m] it refuses."""
    ends = {"pressure": (muscle.over_P.low, muscle.over_P.high), "displacement": muscle.reach}

    def values(pressure: ArrayLike, displacement: ArrayLike, amplitude: ArrayLike) -> Values:
        """F and 2 H [N], K [N/m], B_c and B_r [N.s/m] from P [Pa gauge], x and A [m]."""
        given = {"pressure": pressure, "displacement": displacement, "amplitude": amplitude}
        arrays = {key: np.asarray(one, dtype=np.float64) for key, one in given.items()}
        for key, (low, high) in ends.items():
            slack = 1e-9 * max(abs(low), abs(high))
            refuse(key, UNTESTED, (arrays[key] < low - slack) | (arrays[key] > high + slack), arrays[key])
        refuse("amplitude", "a stroke is not negative", arrays["amplitude"] < 0, arrays["amplitude"])
        P, x, A = np.broadcast_arrays(*arrays.values())
        rows = [
            (muscle.static(p, at), muscle.stiffness(p, at), muscle.gap(p, a), *(muscle.damping(p, way) for way in WAYS))
            for p, at, a in zip(P.ravel().tolist(), x.ravel().tolist(), A.ravel().tolist(), strict=True)
        ]  # fmt: skip
        columns = np.array(rows).reshape(*P.shape, len(OUTPUTS))
        return {output.name: columns[..., i] for i, output in enumerate(OUTPUTS)}

    middle = {key: 0.5 * (low + high) for key, (low, high) in ends.items()}
    return Model(
        name, "static force", "A muscle as a surface, from an analysis",
        ("F_s(P, x) = products of cubic splines;  K = -dF_s/dx", "2 H = width of a slow loop of x +- A at its centre"),
        source,
        (
            Parameter("pressure", "P", "pressure", middle["pressure"], "gauge pressure", *ends["pressure"], UNTESTED),
            Parameter("displacement", "x", "length", middle["displacement"], "contraction", *muscle.reach, UNTESTED),
            Parameter("amplitude", "A", "length", AMPLITUDE, "stroke of the loop, either way", 0.0),
        ),
        OUTPUTS, (),
        (
            note,
            "Force and stiffness are half way between both directions, about 5 s after the muscle came there.",
            "In time, with what it remembers: pmabench model simulate; intervals: the analysis itself.",
            "Fitted by pmabench process RUN... --form surface; model fit finds a pressure or contraction from forces.",
        ),
        values,
    )  # fmt: skip


OUTPUTS = (
    Output("force", "F_s", "force", "force half way between both directions"),
    Output("stiffness", "K", "stiffness", "local tangent"),
    Output("gap", "2 H", "force", "width of the loop at its centre"),
    Output("damping_contracting", "B_c", "damping", "damping, contracting"),
    Output("damping_relaxing", "B_r", "damping", "damping, relaxing"),
)
