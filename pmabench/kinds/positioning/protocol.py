"""Positions taken and held in closed loop, set-point by set-point (paper 0, control).

Also paths for the controller to follow, and the feed-forward pressure by a surface model of the muscle.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag

from pmabench.base.errors import did_you_mean
from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Gain, Length, Load, Pressure, Ratio, Speed, Time
from pmabench.model import rules
from pmabench.model.pid import ReferencePath
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Seek, Set
from pmabench.protocol.reference_model import ReferenceModel, described, read_folder
from pmabench.protocol.sweep import LengthAxis, Sweep, expand

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


EVERY = 0.04
"""Time between the values of a feed-forward, with straight lines between them [s]."""


class PathFile(Strict):
    """Places to visit in turn, as shares of the set-point, starting at rest at 0; and how."""

    shares: Annotated[list[Ratio], Field(min_length=1, max_length=100)]
    speed: Speed
    """Highest speed of a move, which starts and ends at rest."""
    rest: Time = 1.0
    """Time at each place, the first included."""


def feedforward(
    model: dict[str, Any] | None, path: ReferencePath, load: float, ends: tuple[float, float]
) -> dict[str, Any]:
    """The command over time by inversion of the protocol's model, as plain data; raises ValueError with a message."""
    from pmabench.model.identified.plant import led, pressures
    from pmabench.model.presets import Described

    known = None if model is None else Described.of(model)
    if known is None or known.surface is None:
        raise ValueError(
            'a feed-forward needs a muscle as a surface: "model: {coefficients: FOLDER}" with the folder of an '
            'analysis that was made with "process --form surface"'
        )
    surface = known.surface
    if max(path.places) > surface.reach[1] * (1 + 1e-9):
        text = f"the path goes to {show(max(path.places), 'length')}; the surface was tested up to"
        raise ValueError(f"{text} {show(surface.reach[1], 'length')}")
    t = np.arange(0.0, path.duration + EVERY, EVERY)
    x, v = (np.array([of(float(now)) for now in t]) for of in (path.place, path.speed))
    most = min(ends[1], known.domain[1])
    P = pressures(surface, t, x, v, load, (ends[0], most))
    if P.max() > most - 1.0:
        text = f"under {show(load, 'force')} the path needs more than {show(most, 'pressure')}"
        raise ValueError(f"{text}, the highest pressure of the controller's output and of the surface")
    return {"every": EVERY, "values": [round(float(one), 1) for one in led(t, P, known.regulator, ends)]}


SLACK = 5.0
"""Time beyond the hold after which a loop counts as hung [s]."""


class PositioningAxes(Strict):
    """What is swept: set-points, and the load."""

    setpoint: LengthAxis
    load: Annotated[list[Load], Field(min_length=1)]


class PositioningTrial(Strict):
    """One run: from rest without pressure to the set-point, or along a path to shares of it, and hold."""

    baseline: Time = 0.2
    hold: Time
    window: tuple[Time, Time]
    """Part of the hold, from the step of the set-point on, for error and limit cycle."""
    band: Ratio = 0.02
    """Distance from the set-point that counts as settled, as a share of the step."""
    rest: Time = 3.0
    """Time without pressure between two runs."""
    path: PathFile | None = None
    """Places to follow instead of one step; the hold comes after it."""


class Positioning(ProtocolHead):
    """Protocol of kind positioning."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("displacement",)
    kind: Literal["positioning"]
    sweep: Sweep[PositioningAxes]
    controller: Controller
    trial: PositioningTrial
    model: ReferenceModel | None = None

    def compile(self, c: Compilation) -> Plan:
        """The plan: per set-point a rest, the loop, and a vent."""
        trial, controller = self.trial, self.controller
        self._sound(c)
        low, high = controller.output
        model = None if self.model is None else described(c, self.model, ("model",))
        muscle: Described | None = None
        table = [] if controller.gains == MODEL else schedule(c, controller)
        if controller.gains == MODEL and (model is not None or not c.problems):
            with c.noting(PLACE):
                muscle = model_for_gains(model)
        longest = c.mounted.specimen_file.limits.contraction * c.mounted.bench.length
        for point in expand(self.sweep, c.document):
            setpoint, place = point.values["setpoint"], point.places["setpoint"]
            c.positive(setpoint, place)
            if setpoint > longest:
                c.fault(place, f"{show(setpoint, 'length')} is above the specimen's limit, {show(longest, 'length')}")
            if not table and muscle is None:
                continue
            values = {**c.load(point.values["load"], point.places["load"]), "setpoint": setpoint}
            if muscle is not None:
                gains = of_model(c, controller, muscle, values, place)
            else:
                gains = gains_at(c, table, setpoint, place)
            c.put_on(values)
            if c.too_long():
                break
            index = c.add_trial(values, point.repeat)
            follows = self._following(c, values, model)
            if follows is None:
                continue
            path, extra = follows
            duration = trial.hold if path is None else trial.hold + path.duration
            parameters: dict[str, Any] = {
                "setpoint": setpoint,
                "duration": duration,
                "low": low,
                "high": high,
                "start": min(max(0.0, low), high),
                "N": controller.filter,
                "anti_windup": controller.anti_windup,
                **gains,
                **extra,
            }
            if controller.tracking is not None:
                parameters["tracking"] = controller.tracking
            c.steps += [
                Record("rest", True, index),
                Hold("rest", trial.baseline),
                Seek("position", "pid", "pressure", low, high, duration + SLACK, parameters),
                Record("position", False, index),
                Set("vent", "pressure", 0.0),
                Hold("vent", trial.rest),
            ]
        settings: dict[str, Any] = {"window": list(trial.window), "band": trial.band, "form": controller.form}
        settings |= {"model": model} if model is not None else {}
        return c.plan("positioning", settings)

    def _following(
        self, c: Compilation, point: dict[str, float], model: dict[str, Any] | None
    ) -> tuple[ReferencePath | None, dict[str, Any]] | None:
        """The path of a trial, and its parameters of the law; None with a problem noted."""
        file, ahead = self.trial.path, ("controller", "feedforward")
        if file is None:
            if self.controller.feedforward:
                c.fault(ahead, "a feed-forward is for a trial with a path: give trial.path")
            return None if self.controller.feedforward else (None, {})
        at = ("trial", "path")
        c.positive(file.speed, (*at, "speed"))
        if any(not 0 <= share <= 1 for share in file.shares) or max(file.shares) < 1:
            c.fault((*at, "shares"), "shares of the set-point lie between 0 % and 100 %, and one of them is 100 %")
            return None
        if not file.speed > 0:
            return None
        places = [0.0, *(share * point["setpoint"] for share in file.shares)]
        path = ReferencePath(places, file.speed, file.rest)
        extra: dict[str, Any] = {"path": {"places": list(path.places), "speed": file.speed, "rest": file.rest}}
        if not self.controller.feedforward:
            return path, extra
        if model is not None or not c.problems:
            with c.noting(ahead):
                values = feedforward(model, path, point["load"], self.controller.output)
                return path, {**extra, "feedforward": values}
        return None

    def _sound(self, c: Compilation) -> None:
        """Check hold, window, band and the controller's output on their own."""
        trial, controller = self.trial, self.controller
        c.needs_channel("displacement")
        c.positives(trial, ("trial",), "hold", "band")
        c.inside_hold(trial.window, trial.hold)
        c.controls(("pressure",), controller.output)
        if controller.tracking is not None:
            c.positive(controller.tracking, ("controller", "tracking"))
