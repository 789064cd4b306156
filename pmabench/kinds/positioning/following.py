"""Paths that a controller follows, and the pressure that a muscle as a surface needs on them, for a protocol's plan."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Ratio, Speed, Time
from pmabench.model.reference_path import ReferencePath
from pmabench.protocol.common import Compilation

EVERY = 0.04
"""Time between the values of a feed-forward, with straight lines between them [s]."""


class PathFile(Strict):
    """Places to go to one after the other, as shares of the set-point, from rest at 0; and how."""

    shares: Annotated[list[Ratio], Field(min_length=1, max_length=100)]
    speed: Speed
    """Highest speed of a move, whose speed begins and ends with 0."""
    rest: Time = 1.0
    """Time at each place, the first included."""


def path_of(c: Compilation, file: PathFile, setpoint: float, at: Location) -> ReferencePath | None:
    """The path to a set-point [m]; None with a problem noted."""
    c.positive(file.speed, (*at, "speed"))
    if any(not 0 <= share <= 1 for share in file.shares) or max(file.shares) < 1:
        c.fault((*at, "shares"), "shares of the set-point lie between 0 % and 100 %, and one of them is 100 %")
        return None
    return (
        ReferencePath([0.0, *(share * setpoint for share in file.shares)], file.speed, file.rest)
        if file.speed > 0
        else None
    )


def as_parameters(path: ReferencePath, file: PathFile) -> dict[str, Any]:
    """The path as plain data for the law."""
    return {"places": list(path.places), "speed": file.speed, "rest": file.rest}


def feedforward(
    c: Compilation,
    model: dict[str, Any] | None,
    path: ReferencePath,
    load: float,
    ends: tuple[float, float],
    at: Location,
) -> dict[str, Any] | None:
    """The command over time by the inverse of the protocol's model, as plain data; None with a problem noted."""
    from pmabench.model.identified.inverse import led, pressures
    from pmabench.model.presets import Described

    known = None if model is None else Described.of(model)
    if known is None or known.surface is None:
        if not c.problems:
            c.fault(
                at, 'a feed-forward needs a muscle as a surface: "model: {coefficients: FOLDER}" with the folder of an '
                'analysis that was made with "process --form surface"',
            )  # fmt: skip
        return None
    surface = known.surface
    if max(path.places) > surface.reach[1] * (1 + 1e-9):
        text = f"the path goes to {show(max(path.places), 'length')}; the surface was tested up to"
        c.fault(at, f"{text} {show(surface.reach[1], 'length')}")
        return None
    t = np.arange(0.0, path.duration + EVERY, EVERY)
    x, v = (np.array([of(float(now)) for now in t]) for of in (path.place, path.speed))
    most = min(ends[1], known.domain[1])
    P = pressures(surface, t, x, v, load, (ends[0], most))
    if P.max() > most - 1.0:
        text = f"under {show(load, 'force')} the path needs more than {show(most, 'pressure')}"
        c.fault(at, f"{text}, the highest pressure of the controller's output and of the surface")
        return None
    return {"every": EVERY, "values": [round(float(one), 1) for one in led(t, P, known.regulator, ends)]}
