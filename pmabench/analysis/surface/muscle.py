"""The muscle that a fit gives: its force, stiffness, loops and creep, from the weights of its terms; SI throughout."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.surface.columns import FAST, LAW, SETTLED, TIMES, Frame, Memory, between, memory
from pmabench.analysis.surface.record import Record, Rows
from pmabench.model.identified.muscle import IdentifiedMuscle, Splines, Weights
from pmabench.store.records import Array

SURFACE, VISCOUS, SLIDING, STOPS_X, STOPS_P, CREEP_X, CREEP_P = TERMS = (
    "static surface",
    "viscous",
    "sliding friction",
    "hysteresis of contraction",
    "hysteresis of pressure",
    "creep of contraction",
    "creep under pressure",
)
STRAIGHT = "straight lines"
"""F_ce(P) - K(P) x in place of the surface, for comparison only."""
FREE = (SURFACE, STRAIGHT)
"""Terms whose weights may have either sign."""
ALWAYS = (SURFACE, VISCOUS)
"""Terms that every muscle has; the data decide about the others."""


@dataclass(frozen=True, eq=False)
class Muscle:
    """F = surface(P, x) - friction and hysteresis - damping + creep, with the weights of each term."""

    frame: Frame
    weights: Mapping[str, Array]
    """By term; a term that is not there is left out."""

    def static(self, P: Array, x: Array) -> Array:
        """Force of the surface alone [N] at pressures [Pa] and contractions [m], shape (n,)."""
        return np.asarray(self.frame.surface(P, x) @ self.weights[SURFACE])

    def stiffness(self, P: Array, x: Array) -> Array:
        """Minus the slope of the surface over contraction [N/m], shape (n,)."""
        return np.asarray(-self.frame.slope(P, x) @ self.weights[SURFACE])

    def secant(self, P: float, first: float, last: float, places: int = 41) -> float:
        """Minus the slope of the least-squares straight line through the surface between two contractions [N/m]."""
        x = np.linspace(first, last, places)
        return float(-np.polyfit(x - x.mean(), self.static(np.full(places, P), x), 1)[0])

    def force(self, records: Sequence[Record]) -> Array:
        """Force [N] along the rows of records, one after the other, shape (n,)."""
        rows, past = Rows.of_records(records), memory(records, self.frame)
        found = np.zeros(len(rows.P))
        for term, weights in self.weights.items():
            found += columns_of(term, self.frame, rows, past, self.stiffness) @ weights
        return found

    def gap(self, P: float, amplitude: float) -> float:
        """Width of the loop of force over contraction at its centre at rest [N], for a stroke of +- amplitude [m]."""
        reach = np.minimum(self.frame.radii, np.maximum(amplitude - self.frame.radii, 0.0)) / self.frame.radii
        return float(2.0 * self._stops_x(P) @ reach)

    def area(self, P: float, amplitude: float) -> float:
        """Work lost in a slow cycle of contraction of +- amplitude [m] at constant pressure [J]."""
        return float(4.0 * self._stops_x(P) @ np.maximum(amplitude - self.frame.radii, 0.0))

    def pressure_gap(self, x: float, amplitude: float) -> float:
        """Width of the loop of force over pressure at its centre at rest [N], for a stroke of +- amplitude [Pa]."""
        radii = self.frame.pressure_radii
        reach = np.minimum(radii, np.maximum(amplitude - radii, 0.0)) / radii
        share = self.frame.x.share(np.array([x]))
        weights = self.weights.get(STOPS_P)
        return 0.0 if weights is None else float(2.0 * (between(share, reach[None, :]) @ weights)[0])

    def creep_per_decade(self, first: float, last: float) -> float:
        """Contraction that creep adds in each decade between two times [s] after a step, over that of the step [1]."""
        weights = self.weights.get(CREEP_X)
        if weights is None:
            return 0.0
        T = np.array(TIMES)
        return float((LAW @ weights) @ (np.exp(-first / T) - np.exp(-last / T)) / np.log10(last / first))

    def pressure_creep_per_decade(self, x: float, first: float, last: float) -> float:
        """Force that creep adds in each decade between two times [s] after a step, per step of pressure [N/Pa]."""
        weights = self.weights.get(CREEP_P)
        if weights is None:
            return 0.0
        T = np.array(TIMES)
        risen = (np.exp(-first / T) - np.exp(-last / T)) @ LAW / np.log10(last / first)
        share = self.frame.x.share(np.array([x]))
        return float((between(share, risen[None, :]) @ weights)[0]) / max(self.frame.P.span, 1.0)

    def damping(self, P: float) -> tuple[float, float]:
        """Damping while contracting and while expanding [N.s/m]."""
        share = self.frame.P.share(np.array([P]))
        contracting, expanding = between(share, np.eye(2)) @ self.weights[VISCOUS]
        return float(contracting), float(expanding)

    def friction(self, P: float) -> float:
        """Friction that turns round at once [N]."""
        weights = self.weights.get(SLIDING)
        share = self.frame.P.share(np.array([P]))
        return 0.0 if weights is None else float((between(share, np.ones((1, 1))) @ weights)[0])

    def straight_form(self) -> dict[str, list[float]]:
        """Pressures [Pa] and there F_ce [N], K [N/m], B_c, B_r [N.s/m] and F_c [N], of a muscle of straight lines."""
        pressures = self.frame.pressures
        F_ce, K = self.weights[STRAIGHT].reshape(2, -1)
        damping = [self.damping(float(P)) for P in pressures]
        return {
            "pressure": pressures.tolist(),
            "F_ce": F_ce.tolist(),
            "K": K.tolist(),
            "B_c": [both[0] for both in damping],
            "B_r": [both[1] for both in damping],
            "F_c": [self.friction(float(P)) for P in pressures],
        }

    def identified(self, name: str) -> IdentifiedMuscle:
        """The same muscle as a model, which needs no record to go along."""
        frame, weights = self.frame, self.weights
        low, high = frame.P.low, frame.P.high

        def of(term: str, number: int) -> Array:
            return weights.get(term, np.zeros(2 * number)).reshape(2, -1)

        number = len(frame.pressure_radii)
        creep = LAW @ weights.get(CREEP_X, np.zeros(LAW.shape[1]))
        under = of(CREEP_P, LAW.shape[1]) @ LAW.T / max(frame.P.span, 1.0)
        ends = [self.damping(P) for P in (low, high)]
        return IdentifiedMuscle(
            name,
            Splines(tuple(low + frame.P.span * share for share in frame.P.shares) if frame.P.span > 0 else (low,)),
            Splines(
                tuple(frame.x.low + frame.x.span * share for share in frame.x.shares)
                if frame.x.span > 0
                else (frame.x.low,)
            ),
            weights[SURFACE].reshape(frame.P.size, frame.x.size),
            Weights(frame.radii, self._stops_x(low), self._stops_x(high)),
            Weights(frame.pressure_radii, *of(STOPS_P, number)),
            (ends[0][0], ends[1][0]),
            (ends[0][1], ends[1][1]),
            Weights(np.array(TIMES), creep, creep),
            Weights(np.array(TIMES), *under),
            FAST,
            SETTLED,
        )

    def _stops_x(self, P: float) -> Array:
        """Weight of each stop on contraction at a pressure [N]."""
        share = self.frame.P.share(np.array([P]))
        found = np.zeros(len(self.frame.radii))
        found[0] = self.friction(P)
        if STOPS_X in self.weights:
            found[1:] = between(share, np.eye(len(found) - 1)) @ self.weights[STOPS_X]
        return found


Stiffness = Callable[[Array, Array], Array]
"""Stiffness [N/m] at pressures [Pa] and contractions [m]."""


def columns_of(term: str, frame: Frame, record: Rows, past: Memory, stiffness: Stiffness) -> Array:
    """What a term adds to the force along rows, for each of its weights; shape (n, number of weights).

    All weights but those of the surface are at least 0: friction and damping take work, and creep gives way. Those of
    hysteresis and damping are straight lines over pressure or contraction, from one end of the range to the other.
    """
    over_P, over_x = frame.P.share(record.P), frame.x.share(record.x)
    if term == SURFACE:
        return frame.surface(record.P, record.x)
    if term == STRAIGHT:
        return frame.straight(record.P, record.x)
    if term == VISCOUS:
        both = np.column_stack([np.maximum(record.v, 0.0), np.minimum(record.v, 0.0)])
        return between(over_P, -both)
    if term == SLIDING:
        return between(over_P, -past.stops_x[:, :1])
    if term == STOPS_X:
        return between(over_P, -past.stops_x[:, 1:])
    if term == STOPS_P:
        return between(over_x, -past.stops_P)
    if term == CREEP_X:
        return np.asarray(np.maximum(stiffness(record.P, record.x), 0.0)[:, None] * (past.lag_x @ LAW))
    if term == CREEP_P:
        return between(over_x, past.lag_P @ LAW / max(frame.P.span, 1.0))
    raise ValueError(f'unknown term "{term}"; known are {", ".join(TERMS)}')
