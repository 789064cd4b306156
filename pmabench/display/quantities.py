"""What one trial says by itself, as its kind of test reads it, with the functions that `process` uses; no intervals."""

from __future__ import annotations

from pmabench.analysis.trial import Expected, Found, Quick
from pmabench.kinds import registry
from pmabench.store.records import RunData, TrialData


def prepare(name: str) -> None:
    """Import what a kind needs, which takes a second; so that the first trial's line holds up no key."""
    kind = registry.find(name)
    if kind and kind.live:
        kind.part("live")


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The quantities of a trial and what its own samples say against it; none for kinds that say nothing live."""
    kind = registry.find(run.kind)
    if kind is None or not kind.live:
        return [], []
    found: Found = kind.part("live")(run, trial, expected, quick)
    return found
