"""Steps and sines of a joint's angle in closed loop: both muscles pull, with the stiffness from the protocol.

The feed-forward, both pressures over the angle, comes from a model of the muscles or a measured map.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from pmabench.base.errors import PmaError
from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import (
    Angle,
    AngularIntegralGain,
    Force,
    Frequency,
    Length,
    Pressure,
    Ratio,
    Time,
    TorsionalStiffness,
)
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.driven import MUSCLES, vented
from pmabench.protocol.plan import Control, Hold, Plan, Record, Set
from pmabench.protocol.sweep import AngleAxis, Point, Sweep, expand
from pmabench.store.records import Array

ROWS = 91
"""Angles in the table."""
SMALL = 1e-3
"""Torque for the derivative of the pressures by torque [N m]; they are linear in it."""
FEWEST = 7
"""Angles that a map needs."""
ORDER = 5
"""Order of the polynomials through the map over the angle."""
Table = dict[str, list[float]]


def by_model(
    model: Mapping[str, float], ends: tuple[float, float], stiffness: float, limits: tuple[float, float]
) -> Table:
    """Pressures at zero torque and their derivative by torque, from `joint-inverse` of the library.

    `ends` of the angle [rad], `stiffness` [N m/rad], `limits` of the pressures [Pa]. Raises ValueError with a message
    for the user.
    """
    from pmabench.model.library import MODELS

    angles, inverse = np.linspace(*ends, ROWS), MODELS["joint-inverse"]
    known: dict[str, Any] = {**model, "angle": angles, "stiffness": stiffness}
    held = inverse.evaluate(known | {"pressure_min": limits[0], "pressure_max": limits[1]})
    wide = known | {"pressure_min": 0.0, "pressure_max": 1e6}
    more, less = (inverse.evaluate(wide | {"torque": sign * SMALL}) for sign in (1.0, -1.0))
    gains = [(more[name] - less[name]) / (2 * SMALL) for name in MUSCLES]
    return _table(angles, [held[name] for name in MUSCLES], gains)


def by_map(folder: Path, ends: tuple[float, float], stiffness: float, limits: tuple[float, float]) -> Table:
    """The same from an analysis of kind joint-torque: tau = tau_0 + s_1 P_1 - s_2 P_2 with polynomials over the angle.

    Stiffness is minus its slope at constant pressures. Raises ValueError with a message where the map does not cover
    the angles.
    """
    from pmabench.store.analyses.folder import read_analysis

    try:
        analysis = read_analysis(folder)
    except PmaError as error:
        raise ValueError(str(error)) from error
    terms = {}
    for symbol in ("tau_0", "s_1", "s_2"):
        points = sorted(
            (e.at["angle"], e.value) for e in analysis.estimates if e.symbol == symbol and e.value is not None
        )
        if len(points) < FEWEST:
            raise ValueError(
                f"{folder} gives {symbol} at {len(points)} angles, and {FEWEST} are needed: an analysis of "
                "joint-torque with three levels of each pressure or more has them"
            )
        first, last = points[0][0], points[-1][0]
        if ends[0] < first - 1e-9 or ends[1] > last + 1e-9:
            reach = " to ".join(show(angle, "angle", 3) for angle in (first, last))
            raise ValueError(f"the map of {folder} reaches from {reach}, and the joint is to go beyond")
        table = np.array(points, dtype=np.float64)
        terms[symbol] = np.polyfit(table[:, 0], table[:, 1], ORDER)
    angles = np.linspace(*ends, ROWS)
    (t, s_1, s_2), (dt, ds_1, ds_2) = (
        [np.polyval(change(terms[symbol]), angles) for symbol in ("tau_0", "s_1", "s_2")]
        for change in (np.asarray, np.polyder)
    )
    # s_1 P_1 - s_2 P_2 = torque - tau_0 and -s_1' P_1 + s_2' P_2 = stiffness + tau_0'
    determinant = s_1 * ds_2 - s_2 * ds_1
    wanted = stiffness + dt
    held = [(-t * ds_2 + s_2 * wanted) / determinant, (s_1 * wanted - t * ds_1) / determinant]
    for name, values in zip(MUSCLES, held, strict=True):
        if not (limits[0] <= values.min() and values.max() <= limits[1]):
            needed, allowed = (
                " to ".join(show(end, "pressure", 4) for end in pair) for pair in ((values.min(), values.max()), limits)
            )
            raise ValueError(f"it takes {name} of {needed}, outside {allowed}; ask for another stiffness")
    return _table(angles, held, [ds_2 / determinant, ds_1 / determinant])


def _table(angles: Array, held: list[Array], gains: list[Array]) -> Table:
    """Plain numbers for the plan."""
    columns = dict(zip(("angle", *MUSCLES, "gain_1", "gain_2"), (angles, *held, *gains), strict=True))
    return {
        name: [float(f"{value:.9g}") for value in np.broadcast_to(values, angles.shape)]
        for name, values in columns.items()
    }


SLACK = 5.0
"""Time beyond the trial after which a loop counts as hung [s]."""


class StepAxes(Strict):
    """What is swept: goal angles and the gain of the integral action; with `frequency`, sines of that amplitude."""

    goal: AngleAxis
    integral: Annotated[list[AngularIntegralGain], Field(min_length=1)]
    frequency: Annotated[list[Frequency], Field(min_length=1)] | None = None


class JointModel(Strict):
    """Muscles and pulley for the feed-forward, as in the model `joint-inverse`."""

    pulley_radius: Length
    preload: Ratio
    diameter: Length
    length: Length
    braid_angle: Angle
    alpha: float
    A: Force
    B1: Ratio
    B2: Ratio


class StepController(Strict):
    """Stiffness, limits and reference of the joint's controller."""

    stiffness: TorsionalStiffness
    """Stiffness of the joint by co-contraction."""
    output: tuple[Pressure, Pressure]
    """Lowest and highest pressure."""
    reference_lag: Time
    """Time constant of each of the two lags of the reference."""


class StepTrial(Strict):
    """One step from angle 0 to the goal, or a sine about 0."""

    settle: Time
    """Time at the pressures of angle 0 before the loop closes."""
    approach: Annotated[list[Angle], Field(max_length=50)] = []
    """Angles to visit before the baseline, `dwell` at each, since muscles have hysteresis."""
    dwell: Time = 1.0
    baseline: Time
    """Time in the loop at angle 0 before the step."""
    hold: Time
    """Time from the step on; of a sine the time that it lasts."""
    window: tuple[Time, Time]
    """Part of the hold for the end error; of a sine the part that is evaluated."""
    band: Angle
    """Distance from the goal within which the joint counts as settled."""
    rest: Time
    """Time without pressure between two trials."""


class JointStep(ProtocolHead):
    """Protocol of kind joint-step."""

    cannot_do_without: ClassVar[tuple[str, ...]] = (*MUSCLES, "angle")
    kind: Literal["joint-step"]
    sweep: Sweep[StepAxes]
    model: JointModel | None = None
    map: Annotated[str, Field(max_length=400)] | None = None
    """Folder of an analysis of kind joint-torque, instead of `model`."""
    controller: StepController
    trial: StepTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per trial both muscles to the pressures of angle 0, the loop, a vent and a rest."""
        self._sound(c)
        trial, controller = self.trial, self.controller
        low, high = controller.output
        for point in expand(self.sweep, c.document):
            values = {name: float(value) for name, value in point.values.items() if value is not None}
            table = self._table(c, point)
            if table is None or c.problems or c.too_long():
                continue
            middle = {name: float(np.interp(0.0, table["angle"], table[name])) for name in MUSCLES}
            ready = trial.dwell * len(trial.approach)
            begin, duration = ready + trial.baseline, ready + trial.baseline + trial.hold
            goals = [[trial.dwell * n, angle] for n, angle in enumerate([*trial.approach, 0.0])]
            if "frequency" not in values:
                goals.append([begin, values["goal"]])
            parameters: dict[str, Any] = {
                "goals": goals, "duration": duration, "table": table, "K_i": values["integral"],
                "reference_lag": controller.reference_lag, "low": low, "high": high,
            }  # fmt: skip
            if "frequency" in values:
                sine = {"begin": begin, "amplitude": values["goal"], "frequency": values["frequency"]}
                parameters["sine"] = sine
            index = c.add_trial(values, point.repeat)
            c.steps += [
                *(Set("pressurise", name, value) for name, value in middle.items()),
                Hold("pressurise", trial.settle),
                Record("hold", True, index),
                Control("hold", "joint", dict.fromkeys(MUSCLES, (low, high)), duration + SLACK, parameters),
                Record("hold", False, index),
                *(Set("vent", name, 0.0) for name in MUSCLES),
                Hold("vent", trial.rest),
            ]
        c.steps += vented()
        begin = trial.dwell * len(trial.approach) + trial.baseline
        settings = {"window": list(trial.window), "band": trial.band, "begin": begin}
        return c.plan("joint-step", {**settings, "stiffness": controller.stiffness})

    def _sound(self, c: Compilation) -> None:
        """Checks that do not depend on the point."""
        trial = self.trial
        if (self.model is None) == (self.map is None):
            c.fault(("kind",), "needs one of model and map: what the pressures are computed from")
        c.positives(trial, ("trial",), "settle", "dwell", "baseline", "hold", "band")
        c.inside_hold(trial.window, trial.hold)
        c.controls(MUSCLES, self.controller.output)
        if any(output.name == "angle" for output in c.mounted.bench.outputs):
            c.fault(("needs",), "a drive holds the joint of this bench; steps need one that turns freely")

    def _table(self, c: Compilation, point: Point) -> Table | None:
        """Pressures of both muscles over the angles from 0 to the goal; None with a problem noted."""
        goal, place = float(point.values["goal"]), point.places["goal"]
        joint, approach = c.mounted.bench_file.joint, self.trial.approach
        ends = (-abs(goal), abs(goal)) if point.values.get("frequency") else (min(goal, 0.0), max(goal, 0.0))
        for places, at in ((ends, place), (approach, ("trial", "approach"))):
            if joint is not None and not all(joint.stroke[0] <= angle <= joint.stroke[1] for angle in places):
                stroke = " to ".join(show(end, "angle") for end in joint.stroke)
                c.fault(at, f"must lie in the stroke of the joint, {stroke}")
                return None
        if goal == 0:
            c.fault(place, "must not be 0: nothing would move")
            return None
        reach = (min(*ends, *approach), max(*ends, *approach)), self.controller.stiffness, self.controller.output
        try:
            if self.model is not None:
                return by_model(self.model.model_dump(), *reach)
            return by_map(Path(self.map or ""), *reach)
        except ValueError as error:
            c.fault(place, f"the joint cannot be held there: {error}")
            return None
