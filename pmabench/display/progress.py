"""Position of a run in its plan, from its events, and the time that the plan has for the rest; uses no samples."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from itertools import accumulate
from typing import Any

from pmabench.protocol.plan import STEPS, Ask, Record, Step, WaitUntil
from pmabench.store.records import Event


class Progress:
    """The place in a plan of the last beginning or end of a trial, and the time since, not beyond the next.

    While a question is open, in a pause, and in a reference trial that is done again, the clock of the plan stands.
    """

    def __init__(self, plan: Mapping[str, Any], before: Collection[int] = ()) -> None:
        """A run that goes on stands at the first trial that was not finished `before`."""
        steps: list[Step] = []
        with suppress(KeyError, TypeError, AttributeError):
            for item in plan.get("steps") or ():
                fields = dict(item)
                steps.append(STEPS[fields.pop("step")](**fields))
        usual = (s.shortest() if isinstance(s, Ask | WaitUntil) else s.longest() for s in steps)
        until = list(accumulate((max(0.0, float(seconds)) for seconds in usual), initial=0.0))
        self.length = until[-1]
        """Planned duration [s] if every wait ends at once and every search takes its longest time."""
        marks = [(s.on, s.trial, at) for s, at in zip(steps, until, strict=False) if isinstance(s, Record)]
        marks = [mark for mark in marks if mark[1] is not None]
        ends = [*(at for _, _, at in marks), self.length]
        self._places = {(on, trial): (at, ends[n + 1]) for n, (on, trial, at) in enumerate(marks)}
        start = next((place for (on, trial), place in self._places.items() if on and trial not in before), None)
        self._here = start if before and start is not None else (0.0, ends[0])
        """Time of the plan [s] at the last mark, and at the next."""
        self._since: float | None = None
        self._stopped: float | None = None

    def take(self, event: Event) -> None:
        """Go to the mark that an event is, or stop and start the clock."""
        kind = event.kind
        self._since = event.t if self._since is None else self._since
        if kind in ("pause", "prompt") or (kind == "trial-begin" and event.data.get("again")):
            self._stopped = event.t
        elif self._stopped is not None:
            if kind in ("goes-on", "answer", "trial-end"):
                self._since += event.t - self._stopped
                self._stopped = None
        elif kind in ("trial-begin", "trial-end"):
            place = self._places.get((kind == "trial-begin", event.data.get("trial")))
            self._here, self._since = (place, event.t) if place is not None else (self._here, self._since)

    def done(self, t: float) -> float:
        """Fraction of the plan that is done at `t` [s]."""
        return self._behind(t) / self.length if self.length > 0 else 0.0

    def _behind(self, t: float) -> float:
        now = t if self._stopped is None else self._stopped
        since = 0.0 if self._since is None else max(0.0, now - self._since)
        return min(self._here[0] + since, self._here[1])

    def left(self, t: float) -> float | None:
        """What the plan has left at `t` [s], without the operator's time; None if unknown."""
        return self.length - self._behind(t) if self.length else None
