"""Contraction from rest and relaxation at each load and pressure (paper 0 section 4, paper 1 section 3).

Relaxation goes in steps; with a `reduction` of paper 1 it is one step to 0, and each direction is a separate trial.
"""

from __future__ import annotations

from math import acos, ceil, sqrt
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from pmabench.base.quantities import show
from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Pressure, Time
from pmabench.protocol.common import OF_FIT, OF_TRIALS, Compilation, ProtocolHead
from pmabench.protocol.plan import Hold, Plan, Record, Set, TrialRecord
from pmabench.protocol.sweep import Point, PressureAxis, Sweep, expand

MOST_RELAXATIONS = 200
LOWEST = 100e3
"""Paper 1 declares its S and D invalid below this pressure [Pa]."""

NEUTRAL = acos(1 / sqrt(3))
"""Braid angle at which the muscle force changes sign: above it a muscle extends [rad]."""


class ContractionAxes(Strict):
    """What is swept: loads, and the target pressures of the contraction."""

    load: Annotated[list[Load], Field(min_length=1)]
    pressure: PressureAxis


class Contract(Strict):
    """The contraction: one step from 0 to the pressure."""

    hold: Time


class Relax(Strict):
    """Relaxation in steps, since a vent straight to 0 shows nothing of B_r at high pressure.

    Without `by` and `hold` it is one step to 0, for the reduction of paper 1 only.
    """

    by: Pressure | None = None
    hold: Time | None = None
    then: Pressure = 0.0
    hold_at_end: Time


class Orders(Strict):
    """Orders of the polynomials over pressure; chosen from the values where they are not given."""

    K: Annotated[int, Field(ge=1, le=9)] | None = None
    B_c: Annotated[int, Field(ge=1, le=9)] | None = None
    B_r: Annotated[int, Field(ge=1, le=9)] | None = None


class Reduction(Strict):
    """Paper 1's reduction of single steps, S = K and D = B: F_ce from the braid, S = (F_ce - L) / x_max, D = tau S."""

    method: Literal["paper-1"]
    F_ce_at: Literal["x0", "xmax"] = "x0"
    """Where F_ce is taken: before the contraction, or at its end as in paper 1. S of one convention is not valid in the
    other.
    """
    orders: Orders = Orders()


class ContractionTrial(Strict):
    """One trial."""

    baseline: Time = 0.2
    contract: Contract
    relax: Relax


class ReferenceTrial(Strict):
    """One trial that is repeated during the run to show drift."""

    load: Load
    pressure: Pressure
    every: Annotated[int, Field(ge=1)]


class ContractionRelaxation(ProtocolHead):
    """Protocol of kind contraction-relaxation."""

    cannot_do_without: ClassVar[tuple[str, ...]] = ("pressure", "displacement")
    gives: ClassVar[tuple[str, ...]] = ("F_ce", "K", "B_c", "B_r", "F_c")
    checks: ClassVar[tuple[str, ...]] = (*OF_TRIALS, *OF_FIT)
    kind: Literal["contraction-relaxation"]
    sweep: Sweep[ContractionAxes]
    reference_trial: ReferenceTrial | None = None
    trial: ContractionTrial
    layout: Literal["horizontal", "vertical"] = "horizontal"
    """Vertical: half the weight of the muscle adds to the load, from the `mass` in the specimen file."""
    reduction: Reduction | None = None

    def compile(self, c: Compilation) -> Plan:
        """The plan: per trial baseline, contract, relax in steps, vent; or the single steps of paper 1."""
        c.positive(self.trial.contract.hold, ("trial", "contract", "hold"))
        c.within("pressure", self.trial.relax.then, ("trial", "relax", "then"))
        if self.reduction is not None:
            return self._single_steps(c, self.reduction)
        trial, relax = self.trial, self.trial.relax
        for name in ("by", "hold"):
            if getattr(relax, name) is None:
                c.fault(("trial", "relax"), f'"{name}" is missing; only "reduction: {{method: paper-1}}" vents at once')
                return c.plan("contraction-relaxation", {})
            c.positive(getattr(relax, name), ("trial", "relax", name))
        points = list(self._order(expand(self.sweep, c.document)))
        if points and relax.then > (lowest := min(point.values["pressure"] for point, _ in points)):
            text = f"is above the pressure of a trial, {show(lowest, 'pressure')}: a relaxation goes down"
            c.fault(("trial", "relax", "then"), f"{show(relax.then, 'pressure')} {text}")
        for index, (point, is_reference) in enumerate(points):
            pressure = point.values["pressure"]
            c.within("pressure", pressure, point.places["pressure"])
            c.positive(pressure, point.places["pressure"])
            values = {**self._loaded(c, point), "pressure": pressure}
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
                c.steps += [Set("relax", "pressure", target), Hold("relax", relax.hold or 0.0)]
            c.steps += [
                Set("vent", "pressure", relax.then),
                Hold("vent", relax.hold_at_end),
                Record("vent", False, index),
            ]
        return c.plan("contraction-relaxation", {"contract_hold": trial.contract.hold, "relax_by": relax.by})

    def _single_steps(self, c: Compilation, reduction: Reduction) -> Plan:
        """The plan of paper 1: from 0 to each pressure, and from each pressure to 0, each as a separate trial.

        A trial starts from 0 or is pressurised first, whatever came before, so that it can be repeated or resumed
        alone.
        """
        trial, relax = self.trial, self.trial.relax
        c.positive(relax.hold_at_end, ("trial", "relax", "hold_at_end"))
        for name in ("by", "hold"):
            if getattr(relax, name) is not None:
                c.fault(("trial", "relax", name), 'paper 1 relaxes in one step; leave "by" and "hold" out')
        if relax.then != 0:
            c.fault(("trial", "relax", "then"), "paper 1 relaxes to 0 kPa: contraction is counted from there")
        if self.reference_trial is not None:
            c.fault(("reference_trial",), "cannot be combined with the reduction of paper 1; leave it out")
        for name in c.head.accept:
            if name not in ("K", "B_c", "B_r"):
                lack = "takes {} as known" if name in self.gives else "does not give {}"
                message = f"paper 1's reduction {lack.format(name)}; it gives K, B_c, B_r"
                c.fault(("accept", name), message, key=True)
        for point in expand(self.sweep, c.document):
            pressure, place = point.values["pressure"], point.places["pressure"]
            c.within("pressure", pressure, place)
            if pressure < LOWEST * (1 - 1e-9):
                message = f"{show(pressure, 'pressure')} is below {show(LOWEST, 'pressure')}"
                why = "paper 1's S and D do not hold there, and its damping would come out negative"
                c.fault(place, f"{message}: {why}")
            values = self._loaded(c, point)
            if not c.trials:
                c.precondition()
            if c.too_long():
                break
            up, down = len(c.trials), len(c.trials) + 1
            c.trials += [
                TrialRecord(up, {**values, "from": 0.0, "pressure": pressure}, point.repeat),
                TrialRecord(down, {**values, "from": pressure, "pressure": 0.0}, point.repeat),
            ]
            c.steps += [
                Set("release", "pressure", 0.0),
                Hold("release", relax.hold_at_end),
                Record("rest", True, up),
                Hold("rest", trial.baseline),
                Set("contract", "pressure", pressure),
                Hold("contract", trial.contract.hold),
                Record("contract", False, up),
                Set("pressurise", "pressure", pressure),
                Hold("pressurise", trial.contract.hold),
                Record("held", True, down),
                Hold("held", trial.baseline),
                Set("relax", "pressure", 0.0),
                Hold("relax", relax.hold_at_end),
                Record("relax", False, down),
            ]
        settings = {"contract_hold": trial.contract.hold, "reduction": self._reduction(c, reduction)}
        return c.plan("contraction-relaxation", settings)

    def _reduction(self, c: Compilation, reduction: Reduction) -> dict[str, Any]:
        """Settings that the reduction needs in addition to the samples [SI]; a problem is reported where the specimen
        file lacks one.
        """
        specimen = c.mounted.specimen_file
        if specimen.braid_angle is None:
            message = 'needs "braid_angle" in the specimen file: F_ce is computed from it, for instance "braid_angle:'
            c.fault(("reduction",), f'{message} 25 deg"')
        elif specimen.braid_angle >= NEUTRAL:
            c.fault(("reduction",), 'the "braid_angle" of the specimen file is 54.74 deg or more: it does not contract')
        return {
            "method": reduction.method,
            "F_ce_at": reduction.F_ce_at,
            "orders": reduction.orders.model_dump(exclude_none=True),
            "radius": specimen.inner_diameter / 2,
            "nominal_length": specimen.nominal_length,
            "braid_angle": specimen.braid_angle,
        }

    def _loaded(self, c: Compilation, point: Point) -> dict[str, float]:
        """Add the load of a point to the plan; F_L [N] and moving mass [kg], with half of a vertical muscle in both."""
        values = c.load(point.values["load"], point.places["load"])
        own = 0.0
        if self.layout == "vertical":
            mass = c.mounted.specimen_file.mass
            if mass is None:
                message = 'a muscle that hangs carries half of its weight: the specimen file needs "mass", for instance'
                c.fault(("layout",), f'{message} "mass: 1 kg"')
            own = 0.5 * (mass or 0.0) * c.mounted.bench.gravity
            moving = 0.5 * (mass or 0.0) if c.mounted.bench.hanging else 0.0
            values = {"load": values["load"] + own, "mass": values["mass"] + moving}
        c.put_on(values, own=own)
        return values

    def _down(self, c: Compilation, pressure: float) -> list[float]:
        """Intermediate pressures of the relaxation, descending [Pa]."""
        relax = self.trial.relax
        if relax.by is None or relax.by <= 0 or relax.then >= pressure:
            return []
        count = (pressure - relax.then) / relax.by
        if count > MOST_RELAXATIONS:
            c.fault(("trial", "relax", "by"), f"makes more than {MOST_RELAXATIONS} steps a trial, the most allowed")
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
