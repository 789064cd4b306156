"""Controllers of positions: P, PI or PID, and their gains: given, by set-point, by a tuning rule, or by a model."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag

from pmabench.base.errors import did_you_mean
from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Gain, Length, Pressure, Time
from pmabench.model import rules
from pmabench.protocol.common import Compilation
from pmabench.protocol.reference_model import read_folder

if TYPE_CHECKING:
    from pmabench.model.loop import Loop
    from pmabench.model.presets import Described

Text = Annotated[str, Field(min_length=1, max_length=400)]
PLACE: Location = ("controller", "gains")
RULE: Location = ("controller", "rule")
"""Places of gains and rule in a protocol file."""
Settings = dict[str, float]
"""K_p [Pa/m], and T_i, T_d [s] where the form has them."""


class Gains(Strict):
    """One set of gains."""

    K_p: Gain
    T_i: Time | None = None
    T_d: Time | None = None


class GainsAt(Gains):
    """The gains at one set-point of a schedule."""

    setpoint: Length


class Ultimate(Strict):
    """Ultimate gain and period, to which the controller's rule is applied."""

    K_u: Gain
    T_u: Time


MODEL = "model"
"""Gains from the protocol's own model, at each set-point and load."""


def _shape(value: object) -> str:
    if isinstance(value, list):
        return "schedule"
    if isinstance(value, str):
        return "folder"
    return "ultimate" if isinstance(value, dict) and ("K_u" in value or "T_u" in value) else "gains"


GainsFile = Annotated[
    Annotated[Gains, Tag("gains")]
    | Annotated[list[GainsAt], Field(min_length=1, max_length=200), Tag("schedule")]
    | Annotated[Ultimate, Tag("ultimate")]
    | Annotated[Text, Tag("folder")],
    Discriminator(_shape),
]


def _known_rule(name: str) -> str:
    known = dict.fromkeys(rule.name for rule in rules.all_rules())
    if name not in known:
        raise ValueError(f'unknown tuning rule "{name}"{did_you_mean(name, known)}')
    return name


class Controller(Strict):
    """A P, PI or PID controller in ideal form.

    `gains`: one set; a list of sets over the set-point, interpolated linearly; `{K_u, T_u}`, to which `rule` is
    applied; the folder of an analysis of ultimate-gain runs, whose K_u, T_u and loop at each set-point make a schedule;
    or `model`, the protocol's own model at each set-point and load.
    """

    form: Literal["P", "PI", "PID"]
    gains: GainsFile
    rule: Annotated[str, AfterValidator(_known_rule)] = "Ziegler-Nichols"
    """A tuning rule as `pmabench tune` lists them; SIMC needs the dead time and the lags of the loop."""
    filter: Annotated[float, Field(ge=1, le=1000)] = 10.0
    """N, ratio of T_d to the lag of the derivative's filter."""
    anti_windup: Literal["back-calculation", "clamping"] = "back-calculation"
    tracking: Time | None = None
    """Tracking time of back-calculation."""
    output: tuple[Pressure, Pressure]
    """Range that the command cannot leave."""
    feedforward: bool = False
    """Add the pressure that the protocol's model, a surface model of the muscle, needs for the path of the trial."""


def schedule(c: Compilation, controller: Controller) -> list[tuple[float, Settings]]:
    """Gains by ascending set-point [m]; nan as set-point for all. Empty after a problem was reported."""
    given = controller.gains
    if isinstance(given, str):
        return _measured(c, controller, given)
    if isinstance(given, Ultimate):
        c.positive(given.K_u, (*PLACE, "K_u"))
        c.positive(given.T_u, (*PLACE, "T_u"))
        if c.problems:
            return []
        with c.noting(RULE):
            return [(float("nan"), _by_rule(controller, given.K_u, given.T_u, None))]
        return []
    if "rule" in controller.model_fields_set:
        c.fault(RULE, "these gains are taken as they stand; a rule is for {K_u, T_u}, an analysis, or model")
    if isinstance(given, list):
        rows = [(one.setpoint, _checked(c, controller.form, one, (*PLACE, i))) for i, one in enumerate(given)]
        if any(a[0] >= b[0] for a, b in pairwise(rows)):
            c.fault(PLACE, "the set-points of a schedule must rise")
    else:
        rows = [(float("nan"), _checked(c, controller.form, given, PLACE))]
    return [(x, settings) for x, settings in rows if settings]


def gains_at(c: Compilation, table: list[tuple[float, Settings]], setpoint: float, place: Location) -> Settings:
    """The gains at a set-point [m], straight lines between those of the schedule; a fault outside it."""
    if len(table) == 1:
        return table[0][1]
    if not table[0][0] - 1e-9 <= setpoint <= table[-1][0] + 1e-9:
        ends = f"{show(table[0][0], 'length')} to {show(table[-1][0], 'length')}"
        c.fault(place, f"{show(setpoint, 'length')} lies outside the schedule of gains, {ends}")
        return table[0][1]
    rising = [x for x, _ in table]
    return {name: float(np.interp(setpoint, rising, [gains[name] for _, gains in table])) for name in table[0][1]}


def _checked(c: Compilation, form: str, gains: Gains, place: Location) -> Settings:
    """The gains of the form, each above zero; a problem is reported for one that the form does not have."""
    needed = {"P": ("K_p",), "PI": ("K_p", "T_i"), "PID": ("K_p", "T_i", "T_d")}[form]
    before = len(c.problems)
    for name in ("K_p", "T_i", "T_d"):
        value = getattr(gains, name)
        if name in needed and value is None:
            c.fault(place, f"a {form} controller needs {name}")
        elif name in needed:
            c.positive(value, (*place, name))
        elif value is not None:
            c.fault((*place, name), f"a {form} controller has no {name}")
    return {} if len(c.problems) > before else {name: float(getattr(gains, name)) for name in needed}


def model_for_gains(model: Mapping[str, Any] | None) -> Described:
    """The plan's model; raises ValueError with a message where it does not define a loop."""
    from pmabench.model.presets import Described

    if model is None:
        raise ValueError('the protocol has no "model"; give one, or other gains')
    known = Described.of(model)
    if known.air is not None:
        raise ValueError(
            f"the model, {known.source}, has air that its regulator has to move, which makes no loop of lags alone; "
            'give a "model.regulator" in its place, or take an analysis of relays or steps'
        )
    if known.regulator.dead_time or known.regulator.lag or known.regulator.natural_frequency:
        return known
    raise ValueError(
        f"the model, {known.source}, tells no dead time and no lag of the regulator; give them in the protocol as "
        '"model.regulator: {dead_time: 40 ms, lag: 95 ms}"'
    )


def of_model(
    c: Compilation, controller: Controller, model: Described, point: Mapping[str, float], place: Location
) -> Settings:
    """The gains at a set-point [m] and load [N, kg] of a model; empty after a problem was reported at `place`."""
    from pmabench.model.loop import loop_at, ultimate

    try:
        _, loop = loop_at(
            model.muscle, model.regulator, point["setpoint"], point["load"], controller.output,
            mass=point["mass"], sample_period=1 / c.head.sample_rate,
        )  # fmt: skip
        found = ultimate(loop)
    except ValueError as error:
        c.fault(place, f"by the model, {model.source}: {error}")
        return {}
    with c.noting(RULE):
        return _by_rule(controller, found.gain, found.period, loop)
    return {}


def _by_rule(controller: Controller, K_u: float, T_u: float, loop: Loop | None) -> Settings:
    """The gains by the controller's rule; raises ValueError with a message."""
    rule = rules.find(controller.rule, controller.form)
    if rule is None:
        raise ValueError(f"{controller.rule} has no rule for a {controller.form} controller")
    if rule.from_loop and loop is None:
        raise ValueError(
            f'{controller.rule} needs the dead time and the lags of the loop: give "gains: model" and a "model", or an '
            "analysis of relays or steps"
        )
    found = rule.settings(K_u, T_u, loop)
    integral = {"T_i": found.T_i} if isfinite(found.T_i) else {}
    return {"K_p": found.K_p} | integral | ({"T_d": found.T_d} if controller.form == "PID" else {})


def _measured(c: Compilation, controller: Controller, folder: str) -> list[tuple[float, Settings]]:
    """Gains from K_u, T_u and the loop that an analysis found at each set-point; of several methods the first."""
    from pmabench.analysis.tuning import measured_loops

    rows: dict[float, Settings] = {}
    with c.noting(PLACE):
        analysis = read_folder(c, folder, ("K_u", "T_u"))
        with c.noting(RULE):
            for K_u, T_u, loop in measured_loops(analysis):
                setpoint = K_u.at.get("setpoint")
                if setpoint is not None and setpoint not in rows and K_u.value and T_u.value:
                    rows[setpoint] = _by_rule(controller, K_u.value, T_u.value, loop)
            if not rows:
                c.fault(PLACE, f'the analysis "{folder}" gives no ultimate gain and period')
            return sorted(rows.items())
    return []
