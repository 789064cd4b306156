"""An identified muscle as a model of the library: force, stiffness, loop width and damping at an operating point.

`described`: the muscle of an analysis of kind surface, from its facts, together with the three-element form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pmabench.model.curve import Curve
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.library.description import Model, Output, Parameter, Values, refuse
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import Described
from pmabench.model.regulator import Regulator

MUSCLE, STRAIGHT = "muscle", "straight_form"
"""Entries of the facts of an analysis."""
LEAST_K, LEAST_B = 1e3, 10.0
"""Lower bounds of stiffness [N/m] and damping [N.s/m] of the three-element form."""


def holds_surface(facts: Mapping[str, Any]) -> bool:
    """Whether the facts of an analysis contain a muscle; those of earlier versions do not."""
    return isinstance(facts.get(MUSCLE), Mapping) and isinstance(facts.get(STRAIGHT), Mapping)


def described(facts: Mapping[str, Any], source: str, regulator: Regulator) -> Described:
    """The muscle in an analysis' facts with a regulator, and its three-element form as `muscle`; raises ValueError."""
    if not holds_surface(facts):
        raise ValueError(f"{source} holds no muscle as a surface; process its runs again with --form surface")
    try:
        surface = IdentifiedMuscle.of(facts[MUSCLE], source)
        form = straight(facts[STRAIGHT], source, surface.stop)
        return Described(form, regulator, source, (surface.over_P.low, surface.over_P.high), surface=surface)
    except (KeyError, TypeError) as error:
        raise ValueError(f"the muscle of {source} is damaged ({error}); process its runs again") from error


def straight(form: Mapping[str, Any], name: str, stop: float) -> Muscle:
    """The three-element form of the same tests: F_ce(P) - K(P) x - B x' - F_c sign x', linear between pressures."""

    def through(symbol: str, least: float) -> Curve:
        return Curve.through(pressures, [max(float(value), least) for value in form[symbol]])

    pressures = [float(P) for P in form["pressure"]]
    lines = Curve.through(pressures, [float(value) for value in form["F_ce"]]).pieces[1:-1]
    friction = sum(form["F_c"]) / len(form["F_c"])
    return Muscle(
        name,
        F_ce=Curve(lines, tuple(pressures[1:-1])),
        K=through("K", LEAST_K),
        B_c=through("B_c", LEAST_B),
        B_r=through("B_r", LEAST_B),
        friction=Friction(friction, friction),
        stop=stop,
    )


WAYS = (True, False)
"""Contracting: true; relaxing: false."""
UNTESTED = "beyond what was tested"
AMPLITUDE = 5e-3
"""Default amplitude of the loop whose width is given [m]."""


def as_model(muscle: IdentifiedMuscle, name: str, source: str, note: str) -> Model:
    """The model `name` of a muscle; it raises OutsideDomain outside the tested pressures and contractions."""
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
        values, values,
    )  # fmt: skip


OUTPUTS = (
    Output("force", "F_s", "force", "force half way between both directions"),
    Output("stiffness", "K", "stiffness", "local tangent"),
    Output("gap", "2 H", "force", "width of the loop at its centre"),
    Output("damping_contracting", "B_c", "damping", "damping, contracting"),
    Output("damping_relaxing", "B_r", "damping", "damping, relaxing"),
)
