"""Position of a run in its plan, from its events, and the remaining time; uses no samples."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from itertools import accumulate
from typing import Any

from pmabench.protocol.plan import STEPS, Ask, Record, Seek, Step, WaitUntil
from pmabench.store.records import Event

_WITH_EVENT = ("set", "ramp", "follow", "record", "ask", "seek")
"""Steps that begin with an event."""
ENOUGH = 0.02
"""Fraction of the plan after which the remaining time is estimated from the pace so far [1]."""


class Progress:
    """The current step of a plan, found from the events of its run.

    The pace excludes the time between a prompt and its answer, pauses, a repeated reference trial, and steps that were
    skipped because an earlier run had done them.
    """

    def __init__(self, plan: Mapping[str, Any], before: Collection[int] = ()) -> None:
        self._steps: list[Step] = []
        with suppress(KeyError, TypeError, AttributeError):
            for item in plan.get("steps") or ():
                fields = dict(item)
                self._steps.append(STEPS[fields.pop("step")](**fields))
        usual = (s.shortest() if isinstance(s, Ask | WaitUntil) else s.longest() for s in self._steps)
        self._until = list(accumulate((max(0.0, float(seconds)) for seconds in usual), initial=0.0))
        left = (i for i, s in enumerate(self._steps) if _opens(s) and getattr(s, "trial", None) not in before)
        self._at = next(left, len(self._steps)) if before else 0
        """Index of the current step; initially of the first trial that was not finished `before` this run."""
        self._begun = False  # whether the current step has begun
        self._t = 0.0
        self._asked: float | None = None
        self._out = 0.0
        """Time excluded from the pace [s]."""
        self._aside: float | None = None
        """Since when the plan has not advanced [s]: in a pause, or in a trial outside the plan."""
        self._leapt = self._until[self._at]
        """Planned duration of the skipped steps [s], minus that of repeated ones."""
        self._first: float | None = None

    @property
    def length(self) -> float:
        """Planned duration [s] if every wait ends at once and every search takes its longest time."""
        return self._until[-1]

    def take(self, event: Event) -> None:
        """Advance to the step that an event belongs to."""
        self._first = event.t if self._first is None else self._first
        kind, phase = event.kind, event.data.get("phase")
        if kind == "pause" or (kind == "trial-begin" and event.data.get("again")):
            self._aside = event.t
        elif self._aside is not None:
            if kind in ("goes-on", "trial-end"):
                self._out += event.t - self._aside
                self._t, self._aside = max(self._t, event.t), None
        elif kind in ("trial-begin", "trial-end"):
            on, trial = kind == "trial-begin", event.data.get("trial")
            steps = enumerate(self._steps)
            place = next((i for i, s in steps if isinstance(s, Record) and s.on == on and s.trial == trial), None)
            if on and place is not None and (place < self._at or any(map(_opens, self._steps[self._at : place]))):
                self._leapt += self._until[place] - self._until[self._at]
            self._after(event, place)
        elif kind == "command":
            output = event.data.get("output")
            here = self._steps[self._at] if self._begun and self._at < len(self._steps) else None
            if not (isinstance(here, Seek) and here.phase == phase and here.output == output):
                self._begin(event, lambda s: s.phase == phase and getattr(s, "output", None) == output)
        elif kind == "prompt":
            self._begin(event, lambda s: isinstance(s, Ask))
            self._asked = event.t
        elif kind == "answer":
            self._out += event.t - self._asked if self._asked is not None else 0.0
            self._asked, self._t = None, event.t
        elif kind == "found":
            seeks = (i for i in range(self._at, len(self._steps)) if isinstance(self._steps[i], Seek))
            self._after(event, next((i for i in seeks if self._steps[i].phase == phase), None))

    def _after(self, event: Event, place: int | None) -> None:
        if place is not None:
            self._at, self._begun, self._t = place + 1, False, event.t

    def _begin(self, event: Event, fits: Callable[[Step], bool]) -> None:
        """Go to the next step that fits, inside this trial or on the way to the next."""
        for i in range(self._at + self._begun, len(self._steps)):
            step = self._steps[i]
            if fits(step):
                self._at, self._begun, self._t = i, True, event.t
                return
            if _opens(step):
                return

    def done(self, t: float) -> float:
        """Fraction of the plan that is done at `t` [s]."""
        return min(1.0, self._behind(t) / self.length) if self.length > 0 else 0.0

    def _behind(self, t: float) -> float:
        """Planned duration of the completed steps [s]; of the current step at most its planned duration."""
        after = range(self._at + self._begun, len(self._steps))
        ends = next((i for i in after if self._steps[i].kind in _WITH_EVENT), len(self._steps))
        now = t if self._aside is None else self._aside
        since = 0.0 if self._asked is not None else max(0.0, now - self._t)
        return self._until[self._at] + min(since, self._until[ends] - self._until[self._at])

    def left(self, t: float) -> tuple[float, bool] | None:
        """Remaining time at `t` [s] without the operator's, and whether it is from the pace so far; None if unknown."""
        if not self.length:
            return None
        behind = self._behind(t)
        rest, here = self.length - behind, behind - self._leapt
        taken = (t if self._aside is None else self._aside) - (self._first or 0.0) - self._out
        if here < ENOUGH * self.length or taken <= 0:
            return rest, False
        return rest * taken / here, True


def _opens(step: Step) -> bool:
    return isinstance(step, Record) and step.on and step.trial is not None
