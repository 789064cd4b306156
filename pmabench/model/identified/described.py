"""The model that an analysis of kind surface holds, from its plain facts, with the straight form of the same tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.model.curve import Curve
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import Described
from pmabench.model.regulator import Regulator

MUSCLE, STRAIGHT = "muscle", "straight_form"
"""Entries of the facts of an analysis."""
LEAST_K, LEAST_B = 1e3, 10.0
"""Stiffness [N/m] and damping [N.s/m] of the straight form where its lines fall below."""


def holds_surface(facts: Mapping[str, Any]) -> bool:
    """Whether the facts of an analysis hold a muscle; those of earlier versions do not."""
    return isinstance(facts.get(MUSCLE), Mapping) and isinstance(facts.get(STRAIGHT), Mapping)


def described(facts: Mapping[str, Any], source: str, regulator: Regulator) -> Described:
    """The muscle of an analysis' facts behind a regulator, with the straight form as `muscle`; ValueError in words."""
    if not holds_surface(facts):
        raise ValueError(f"{source} holds no muscle as a surface; process its runs again with --form surface")
    try:
        surface = IdentifiedMuscle.of(facts[MUSCLE], source)
        form = straight(facts[STRAIGHT], source, surface.stop)
        return Described(form, regulator, source, (surface.over_P.low, surface.over_P.high), surface=surface)
    except (KeyError, TypeError) as error:
        raise ValueError(f"the muscle of {source} is damaged ({error}); process its runs again") from error


def straight(form: Mapping[str, Any], name: str, stop: float) -> Muscle:
    """The straight form of the same tests: F_ce(P) - K(P) x - B x' - F_c sign x', straight lines between pressures."""

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
