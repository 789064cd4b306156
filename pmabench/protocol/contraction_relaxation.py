"""Contraction from rest and relaxation in steps at each load and pressure (paper 0 section 4, paper 1 section 3)."""

from __future__ import annotations

from math import ceil
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Pressure, Time
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Set, TrialRecord
from pmabench.protocol.sweep import Point, PressureAxis, Sweep, expand

MOST_RELAXATIONS = 200


class ContractionAxes(Strict):
    """What is swept: explicit loads, and the pressures contracted to."""

    load: Annotated[list[Load], Field(min_length=1)]
    pressure: PressureAxis


class Contract(Strict):
    """The contraction: one step from 0 to the pressure."""

    hold: Time


class Relax(Strict):
    """Relaxation in steps: a vent straight to 0 says nothing about B_r at high pressure."""

    by: Pressure
    hold: Time
    then: Pressure = 0.0
    hold_at_end: Time


class ContractionTrial(Strict):
    """One trial."""

    baseline: Time = 0.2
    contract: Contract
    relax: Relax


class ReferenceTrial(Strict):
    """The same trial again and again, to show drift."""

    load: Load
    pressure: Pressure
    every: Annotated[int, Field(ge=1)]


class ContractionRelaxation(ProtocolHead):
    """Protocol of kind contraction-relaxation."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("F_ce", "K", "B_c", "B_r", "F_c")
    kind: Literal["contraction-relaxation"]
    sweep: Sweep[ContractionAxes]
    reference_trial: ReferenceTrial | None = None
    trial: ContractionTrial

    def compile(self, c: Compilation) -> Plan:
        """The plan: per trial baseline, contract, relax in steps, vent."""
        trial, relax = self.trial, self.trial.relax
        c.positive(trial.contract.hold, ("trial", "contract", "hold"))
        c.positive(relax.by, ("trial", "relax", "by"))
        c.positive(relax.hold, ("trial", "relax", "hold"))
        c.within("pressure", relax.then, ("trial", "relax", "then"))
        for index, (point, is_reference) in enumerate(self._order(expand(self.sweep, c.document))):
            pressure = point.values["pressure"]
            c.within("pressure", pressure, point.places["pressure"])
            c.positive(pressure, point.places["pressure"])
            values = {**c.load(point.values["load"], point.places["load"]), "pressure": pressure}
            c.put_on(values)
            if index == 0:
                c.precondition()
            if c.too_long():
                break
            c.trials.append(TrialRecord(index, values, point.repeat, is_reference))
            c.steps += [
                Record("rest", True, index),
                Hold("rest", trial.baseline),
                Set("contract", "pressure", pressure),
                Hold("contract", trial.contract.hold),
            ]
            for target in self._down(c, pressure):
                c.steps += [Set("relax", "pressure", target), Hold("relax", relax.hold)]
            c.steps += [
                Set("vent", "pressure", relax.then),
                Hold("vent", relax.hold_at_end),
                Record("vent", False, index),
            ]
        return c.plan("contraction-relaxation", {"contract_hold": trial.contract.hold, "relax_by": relax.by})

    def _down(self, c: Compilation, pressure: float) -> list[float]:
        """The pressures of the relaxation between the first and the last [Pa]."""
        relax = self.trial.relax
        if relax.by <= 0:
            return []
        count = (pressure - relax.then) / relax.by
        if count > MOST_RELAXATIONS:
            c.fault(
                ("trial", "relax", "by"), f"makes {count:.0f} steps a trial; at most {MOST_RELAXATIONS} are allowed"
            )
            return []
        return [pressure - step * relax.by for step in range(1, ceil(count - 1e-9))]

    def _order(self, points: list[Point]) -> list[tuple[Point, bool]]:
        reference = self.reference_trial
        if reference is None:
            return [(point, False) for point in points]
        extra = Point(
            {"load": reference.load, "pressure": reference.pressure},
            {"load": ("reference_trial", "load"), "pressure": ("reference_trial", "pressure")},
        )
        ordered: list[tuple[Point, bool]] = [(extra, True)]
        for count, point in enumerate(points, 1):
            ordered.append((point, False))
            if count % reference.every == 0 or count == len(points):
                ordered.append((extra, True))
        return ordered
