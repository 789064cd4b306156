"""The controller of a position loop as protocols write it: gains by set-point, filter, anti-windup, output range."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Gain, Length, Pressure, Time
from pmabench.protocol.common import Compilation
from pmabench.protocol.reference_model import read_folder

Text = Annotated[str, Field(min_length=1, max_length=400)]
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
    """An ultimate gain and period, from which the controller's rule makes the gains."""

    K_u: Gain
    T_u: Time


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


class Controller(Strict):
    """A P, PI or PID controller in ideal form.

    `gains`: one set; a list of sets over the set-point, straight lines between; `{K_u, T_u}`, to which `rule` is
    applied; or the folder of an analysis of ultimate-gain runs, whose K_u and T_u at each set-point make a schedule.
    """

    form: Literal["P", "PI", "PID"]
    gains: GainsFile
    rule: Literal["Ziegler-Nichols", "Tyreus-Luyben"] = "Ziegler-Nichols"
    filter: Annotated[float, Field(ge=1, le=1000)] = 10.0
    """N, ratio of T_d to the lag of the derivative's filter."""
    anti_windup: Literal["back-calculation", "clamping"] = "back-calculation"
    tracking: Time | None = None
    """Tracking time of back-calculation."""
    output: tuple[Pressure, Pressure]
    """Range that the command cannot leave."""


def schedule(c: Compilation, controller: Controller, at: Location) -> list[tuple[float, Settings]]:
    """Gains by rising set-point [m]; one at nan means for all. Empty with a problem noted."""
    given, place = controller.gains, (*at, "gains")
    if isinstance(given, str):
        return _measured(c, controller, given, place)
    if isinstance(given, Ultimate):
        c.positive(given.K_u, (*place, "K_u"))
        c.positive(given.T_u, (*place, "T_u"))
        made = _by_rule(c, controller, given.K_u, given.T_u, (*at, "rule")) if not c.problems else None
        return [] if made is None else [(float("nan"), made)]
    if isinstance(given, list):
        rows = [(one.setpoint, _checked(c, controller.form, one, (*place, i))) for i, one in enumerate(given)]
        if any(a[0] >= b[0] for a, b in pairwise(rows)):
            c.fault(place, "the set-points of a schedule must rise")
        return [(x, settings) for x, settings in rows if settings]
    settings = _checked(c, controller.form, given, place)
    return [(float("nan"), settings)] if settings else []


def gains_at(c: Compilation, table: list[tuple[float, Settings]], setpoint: float, place: Location) -> Settings:
    """The gains at a set-point [m], straight lines between those of the schedule; a fault outside it."""
    if len(table) == 1:
        return table[0][1]
    if not table[0][0] - 1e-9 <= setpoint <= table[-1][0] + 1e-9:
        ends = f"{show(table[0][0], 'length')} to {show(table[-1][0], 'length')}"
        c.fault(place, f"{show(setpoint, 'length')} lies outside the schedule of gains, {ends}")
        return table[0][1]
    above = next((i for i, (x, _) in enumerate(table) if x >= setpoint - 1e-9), len(table) - 1)
    (x1, before), (x2, after) = table[max(0, above - 1)], table[above]
    share = (setpoint - x1) / (x2 - x1) if x2 > x1 else 1.0
    return {name: before[name] + share * (after[name] - before[name]) for name in before}


def _checked(c: Compilation, form: str, gains: Gains, place: Location) -> Settings:
    """The gains that the form has, each above zero; what it has not must not be given."""
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


def _by_rule(c: Compilation, controller: Controller, K_u: float, T_u: float, place: Location) -> Settings | None:
    from pmabench.analysis.loops.tuning import RULES

    rule = next((r for r in RULES if (r.name, r.form) == (controller.rule, controller.form)), None)
    if rule is None:
        c.fault(place, f"{controller.rule} has no rule for a {controller.form} controller")
        return None
    made = {"K_p": rule.gain * K_u}
    made |= {"T_i": rule.integral * T_u} if rule.integral is not None else {}
    return made | ({"T_d": rule.derivative * T_u} if rule.derivative is not None else {})


def _measured(c: Compilation, controller: Controller, folder: str, place: Location) -> list[tuple[float, Settings]]:
    """From the K_u and T_u that an analysis found at each set-point."""
    try:
        analysis = read_folder(c, folder, "ultimate-gain")
    except ValueError as error:
        c.fault(place, str(error))
        return []
    found: dict[float, dict[str, Any]] = {}
    for e in analysis.estimates:
        if e.value is not None and "setpoint" in e.at and e.symbol in ("K_u", "T_u"):
            found.setdefault(e.at["setpoint"], {})[e.symbol] = e.value
    rows = []
    for setpoint, pair in sorted(found.items()):
        if len(pair) == 2:
            made = _by_rule(c, controller, pair["K_u"], pair["T_u"], (*place[:-1], "rule"))
            if made is None:
                return []
            rows.append((setpoint, made))
    if not rows:
        c.fault(place, f'the analysis "{folder}" gives no ultimate gain and period')
    return rows
