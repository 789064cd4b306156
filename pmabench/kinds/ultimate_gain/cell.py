"""All trials of ultimate-gain runs at one operating point, each examined: what every way to K_u shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from pmabench.analysis.results import Dropped
from pmabench.analysis.shared.cells import by_point
from pmabench.store.records import RunData, TrialData


class Examined(Protocol):
    """What was found in one trial."""

    @property
    def refused(self) -> Sequence[str]:
        """Why it gives no value; empty where it does."""


Found = TypeVar("Found", bound=Examined)


@dataclass(frozen=True)
class GainCell(Generic[Found]):
    """The trials of one operating point `at` [SI], in the order that they came."""

    at: Mapping[str, float]
    runs: tuple[RunData, ...]
    trials: tuple[TrialData, ...]
    found: tuple[Found, ...]

    @property
    def good(self) -> list[int]:
        """Indices of trials with a value."""
        return [i for i, found in enumerate(self.found) if not found.refused]

    @property
    def dropped(self) -> list[Dropped]:
        """Trials that give nothing, with the reason."""
        return [
            Dropped(trial.name, trial.point, "; ".join(found.refused))
            for trial, found in zip(self.trials, self.found, strict=True)
            if found.refused
        ]

    @classmethod
    def all_of(
        cls, members: Sequence[tuple[RunData, TrialData]], examine: Callable[[RunData, TrialData], Found]
    ) -> list[Self]:
        """The trials by operating point, each examined."""
        return [
            cls(
                point,
                tuple(run for run, _ in group),
                tuple(trial for _, trial in group),
                tuple(examine(run, trial) for run, trial in group),
            )
            for point, group in by_point(members)
        ]
