"""Trials of ultimate-gain runs at one operating point, and what several ways to K_u and T_u say about each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, Self, TypeVar

from pmabench.analysis import tuning
from pmabench.analysis.shared.trials import by_point
from pmabench.base.quantities import show
from pmabench.model.loop import Loop
from pmabench.store.analyses.results import Dropped, Estimate, Finding
from pmabench.store.records import RunData, TrialData


class Examined(Protocol):
    """What was found in one trial."""

    @property
    def refused(self) -> Sequence[str]:
        """Why it gives no value; empty where it does."""


Found = TypeVar("Found", bound=Examined)

DESCRIBED = "relay-describing-function"


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


APART = {"K_u": 0.25, "T_u": 0.1}
"""How far open-loop steps, relay and rising gain may be apart without friction; with it they are 30 % to 300 %."""
SCHEDULE = 1.3
"""Ratio of K_u between set-points above which one set of gains does not do."""


def findings(estimates: Sequence[Estimate], loops: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """The spread of the ways, each way against the fitted loop of its operating point, and K_u over the set-points.

    `loops` are those that were fitted: `at` [SI], `gain` [m/Pa], `dead_time` [s], `lags` [s].
    """
    return [*_spread(estimates), *_against_loops(estimates, loops), *_schedule(estimates)]


def _spread(estimates: Sequence[Estimate]) -> list[Finding]:
    """How far the ways to K_u and T_u at one operating point are apart.

    The describing function is reported but not counted: without friction it is low in K_u by a fifth and more.
    """
    lines = []
    for symbol in ("K_u", "T_u"):
        points: dict[tuple[tuple[str, float], ...], list[Estimate]] = {}
        for e in estimates:
            if e.symbol == symbol and e.value:
                points.setdefault(tuple(sorted(e.at.items())), []).append(e)
        for found in points.values():
            if len(found) < 2:
                continue
            where = show(found[0].at["setpoint"], "length") if "setpoint" in found[0].at else "one operating point"
            values = ", ".join(f"{show(e.value or 0.0, e.quantity, 4)} ({e.method})" for e in found)
            exact = [e.value for e in found if e.value and e.method != DESCRIBED]
            text = f"{symbol} at {where}: {values}"
            if len(exact) < 2:
                lines.append(Finding("note", text))
                continue
            apart = max(exact) / min(exact) - 1
            text += f"; the ways {'but the describing function ' * (len(exact) < len(found))}are {apart:.1%} apart"
            if apart > APART[symbol]:
                text += ", more than without friction: stiction, or a muscle that bends within the swings"
            lines.append(Finding("doubt" if apart > APART[symbol] else "note", text))
    return lines


def _against_loops(estimates: Sequence[Estimate], loops: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """Other ways' K_u and T_u held against the loop that was fitted at the same operating point."""
    lines = []
    for entry in loops:
        lags = [complex(*lag) if isinstance(lag, list) else lag for lag in entry["lags"]]
        here = [e for e in estimates if e.value and dict(e.at) == entry["at"] and e.method != DESCRIBED]
        if not here:
            continue
        loop = Loop(entry["gain"], entry["dead_time"], tuple(lags))
        for method in list(dict.fromkeys(e.method for e in here))[1:]:  # the first is the loop's own
            pair = {e.symbol: e.value for e in here if e.method == method}
            if pair.get("T_u"):
                said = tuning.plausibility(pair["T_u"] or 0.0, loop, pair.get("K_u"))
                lines.append(replace(said, text=f"{method} against the loop of {here[0].method}: {said.text}"))
    return lines


def _schedule(estimates: Sequence[Estimate]) -> list[Finding]:
    """K_u belongs to its set-point: say so where it changes much."""
    known = [e for e in estimates if e.symbol == "K_u" and e.value and "setpoint" in e.at]
    known = [e for e in known if e.method == known[0].method]
    if len({e.at["setpoint"] for e in known}) < 2:
        return []
    low, high = min(known, key=lambda e: e.value or 0.0), max(known, key=lambda e: e.value or 0.0)
    ratio = (high.value or 0.0) / (low.value or 1.0)
    if ratio < SCHEDULE:
        return []
    return [
        Finding(
            "note",
            f"K_u changes {ratio:.2g}-fold between {show(low.at['setpoint'], 'length')} and "
            f"{show(high.at['setpoint'], 'length')}: settings hold for their own set-point only",
        )
    ]
