"""Positions taken and held in closed loop, set-point by set-point (paper 0, control).

Also paths for the controller to follow, and the feed-forward pressure by a surface model of the muscle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Ratio, Speed, Time
from pmabench.kinds.positioning import controller as control
from pmabench.model.pid import ReferencePath
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Seek, Set
from pmabench.protocol.reference_model import ReferenceModel, described
from pmabench.protocol.sweep import LengthAxis, Sweep, expand

if TYPE_CHECKING:
    from pmabench.model.presets import Described

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
    controller: control.Controller
    trial: PositioningTrial
    model: ReferenceModel | None = None

    def compile(self, c: Compilation) -> Plan:
        """The plan: per set-point a rest, the loop, and a vent."""
        trial, controller = self.trial, self.controller
        self._sound(c)
        low, high = controller.output
        model = None if self.model is None else described(c, self.model, ("model",))
        muscle: Described | None = None
        table = [] if controller.gains == control.MODEL else control.schedule(c, controller)
        if controller.gains == control.MODEL and (model is not None or not c.problems):
            with c.noting(control.PLACE):
                muscle = control.model_for_gains(model)
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
                gains = control.of_model(c, controller, muscle, values, place)
            else:
                gains = control.gains_at(c, table, setpoint, place)
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
        c.positive(trial.hold, ("trial", "hold"))
        c.positive(trial.band, ("trial", "band"))
        c.inside_hold(trial.window, trial.hold)
        c.controls(("pressure",), controller.output)
        if controller.tracking is not None:
            c.positive(controller.tracking, ("controller", "tracking"))
