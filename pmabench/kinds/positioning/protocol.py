"""Positions taken and held in closed loop, set-point by set-point (paper 0, control)."""

from __future__ import annotations

from math import isfinite
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Ratio, Time
from pmabench.kinds.positioning.controller import (
    MODEL,
    Controller,
    PathFile,
    as_parameters,
    feedforward,
    gains_at,
    model_for_gains,
    of_model,
    path_of,
    schedule,
)
from pmabench.model.reference_path import ReferencePath
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Seek, Set, TrialRecord
from pmabench.protocol.reference_model import ReferenceModel, described
from pmabench.protocol.sweep import LengthAxis, Sweep, expand

SLACK = 5.0
"""Time beyond the hold after which a loop counts as hung [s]."""


class PositioningAxes(Strict):
    """What is swept: set-points, and the load."""

    setpoint: LengthAxis
    load: Annotated[list[Load], Field(min_length=1)]


class PositioningTrial(Strict):
    """One run: from rest at no pressure to the set-point, or along a path to shares of it, and hold."""

    baseline: Time = 0.2
    hold: Time
    window: tuple[Time, Time]
    """Part of the hold, counted from the step of the set-point, in which error and limit cycle are taken."""
    band: Ratio = 0.02
    """Band around the set-point that counts as settled, as a share of the step."""
    rest: Time = 3.0
    """Time without pressure between two runs."""
    path: PathFile | None = None
    """Places to follow in place of one step; then the hold comes after it."""


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
        by_model = controller.gains == MODEL
        muscle = model_for_gains(c, model, ("controller",)) if by_model else None
        table = [] if by_model else schedule(c, controller, ("controller",))
        longest = c.mounted.specimen_file.limits.contraction * c.mounted.bench.length
        for index, point in enumerate(expand(self.sweep, c.document)):
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
            if index == 0:
                c.precondition()
            if c.too_long():
                break
            c.trials.append(TrialRecord(index, values, point.repeat))
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
        if len(table) == 1 and isfinite(table[0][0]):
            settings["gains_of"] = table[0][0]
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
        path = path_of(c, file, point["setpoint"], ("trial", "path"))
        if path is None:
            return None
        extra: dict[str, Any] = {"path": as_parameters(path, file)}
        if self.controller.feedforward:
            values = feedforward(c, model, path, point["load"], self.controller.output, ahead)
            if values is None:
                return None
            extra["feedforward"] = values
        return path, extra

    def _sound(self, c: Compilation) -> None:
        """Check hold, window, band and the controller's output by themselves."""
        trial, controller = self.trial, self.controller
        c.needs_channel("displacement")
        c.positive(trial.hold, ("trial", "hold"))
        c.positive(trial.band, ("trial", "band"))
        begin, end = trial.window
        if not 0 <= begin < end <= trial.hold:
            c.fault(("trial", "window"), "must rise and lie inside the hold")
        low, high = controller.output
        c.within("pressure", low, ("controller", "output", 0))
        c.within("pressure", high, ("controller", "output", 1))
        if not low < high:
            c.fault(("controller", "output"), "must rise")
        if controller.tracking is not None:
            c.positive(controller.tracking, ("controller", "tracking"))
