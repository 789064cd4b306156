"""Trials that are chosen against the whole sweep, by the independent simulator and the project's fit.

`pytest -s -m study tests/analysis/test_chosen.py` prints the table of `CAMPAIGNS`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from os import cpu_count

import numpy as np
import pytest

from pmabench.analysis.next_trial import MOST_IN_CELL, SWEEP, Goal
from pmabench.kinds.contraction_relaxation.known import Known, cells_of, known_after
from pmabench.kinds.contraction_relaxation.next_trial import Chooser
from pmabench.store.records import Array
from tests.analysis import test_contraction_sensors as sensors
from tests.analysis import test_joined_days as joined
from tests.analysis.chosen import LINES, SMALL, WHOLE, Campaign, Scatter, chosen, grid, plan, run_of, scatter
from tests.judge.muscle import Muscle

CAMPAIGNS = int(os.environ.get("CAMPAIGNS", "40"))
"""A third of a minute of a processor each; `200` is what the published figures rest on."""
LOOSER = 1.25
"""Goal: so many times the half widths of the whole moving sweep."""
SYMBOLS = ("F_ce", "K", "B_c", "B_r")


@dataclass(frozen=True)
class Compared:
    """A campaign whose trials were chosen, next to the whole sweep of the same scatter."""

    seed: int
    trials: int
    whole: int
    reached: bool
    why: str
    wider: list[float]
    """Reported half widths over those of the whole sweep."""
    scores: dict[str, list[float]]
    """By symbol how far values are off, in half widths, in the campaign whose trials were chosen."""
    scores_whole: dict[str, list[float]]
    """The same in the whole sweep."""


def compared(seed: int) -> Compared:
    """A campaign of this seed."""
    by = scatter(seed)
    order = grid(WHOLE)
    goals = (Goal(SWEEP, LOOSER, True),)
    whole = known_after(cells_of(plan(WHOLE)), goals, [run_of(order, 10_000 + seed, by, Muscle(), WHOLE)], None)
    assert whole is not None
    found = chosen(goals, seed, by, WHOLE)
    return Compared(
        seed, len(found.done), len(order), found.stop.reached, found.stop.why, wider(found.known, whole),
        scores(found.known, by, len(found.done)), scores(whole, by, len(order)),
    )  # fmt: skip


def wider(known: Known, whole: Known) -> list[float]:
    """Reported half widths of the chosen trials over those of the whole sweep, of values that both have."""
    return [
        one.parts.combined / other.parts.combined
        for name, other in whole.reported.items()
        if (one := known.reported.get(name)) is not None
        and one.value is not None
        and other.value is not None
        and one.parts.combined
        and other.parts.combined
    ]


def scores(known: Known, by: Scatter, trials: int) -> dict[str, list[float]]:
    """Distances from what the muscle had at some time of the campaign, in half widths."""
    found: dict[str, list[float]] = {symbol: [] for symbol in SYMBOLS}
    for (symbol, P), e in known.reported.items():
        half = e.parts.combined
        if symbol not in LINES or e.value is None or half is None:
            continue
        line = float(LINES[symbol](np.array([P]))[0])
        ends = sorted((line, line / (1 + by.drift * trials / 100) if symbol != "F_ce" else line))
        found[symbol].append(max(ends[0] - e.value, e.value - ends[1], 0.0) / half)
    return found


def spread(scored: Sequence[dict[str, list[float]]], symbol: str) -> float:
    """Real over promised spread: root mean square of the scores, as 1.96 of them are a standard deviation."""
    every = [score for one in scored for score in one.get(symbol, ())]
    return 1.96 * float(np.sqrt(np.mean(np.square(every)))) if every else float("nan")


@pytest.mark.study
def test_intervals_of_chosen_trials_hold_what_they_promise() -> None:
    """The table also says how many trials were saved; that is no promise (docs/next-trial.md)."""
    with ProcessPoolExecutor(cpu_count()) as executor:
        every = list(executor.map(compared, range(CAMPAIGNS), chunksize=2))
    summary(every)
    assert all(one.trials <= 2 * len(WHOLE.cells) for one in every)
    for symbol in ("F_ce", "K"):
        assert spread([one.scores for one in every], symbol) <= 1.10


def summary(every: Sequence[Compared]) -> None:
    """Print the table."""
    reached = [one for one in every if one.reached]
    saved = [1 - one.trials / one.whole for one in reached]
    if saved:
        print(f"{len(reached)} of {len(every)} reached; saved {np.percentile(saved, [10, 50, 90]).round(3)}")
    for symbol in SYMBOLS:
        real = spread([one.scores for one in reached], symbol)
        print(
            f"{symbol:5} real over promised {real:.2f}, whole sweep {spread([o.scores_whole for o in every], symbol):.2f}"
        )
    for one in every:
        if not one.reached:
            print(one.seed, one.trials, one.why[:150])


CALM = Scatter(6.0, 0.002)
GOALS = (Goal("K", 0.04, True), Goal("F_ce", 0.025, True))


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    """A campaign with a goal that takes some dozen trials."""
    return chosen(GOALS, 3, CALM, SMALL)


@pytest.mark.study
def test_a_goal_is_reached_and_holds(campaign: Campaign) -> None:
    assert campaign.stop.reached, campaign.stop.why
    for (symbol, P), goal in zip(campaign.known.outlook.names, campaign.known.aim.goal, strict=True):
        e = campaign.known.reported[symbol, P]
        assert e.value is not None
        assert e.parts.combined is not None
        assert e.parts.combined <= goal
        assert abs(e.value - LINES[symbol](np.array([P]))[0]) <= goal
    others = [cell for cell, _, reference in campaign.done if not reference]
    assert max(others.count(cell) for cell in others) <= MOST_IN_CELL
    assert {cell % 3 for cell, _, _ in campaign.done} == {0, 1, 2}
    assert {cell // 3 for cell, _, _ in campaign.done} == {0, 1, 2, 3}
    assert [number for number, (_, _, reference) in enumerate(campaign.done) if reference][:2] == [0, 8]


@pytest.mark.study
def test_the_same_record_gives_the_same_choices(campaign: Campaign) -> None:
    assert chosen(GOALS, 3, CALM, SMALL).done == campaign.done


@pytest.mark.study
def test_a_wrong_form_stops_it_and_nothing_is_promised() -> None:
    bent = chosen(GOALS, 4, CALM, SMALL, Muscle(bend=0.2))
    assert not bent.stop.reached
    assert bent.stop.why.startswith("nothing is promised"), bent.stop.why


def plan_of(cells: Sequence[tuple[float, float]]) -> dict[str, object]:
    """A plan of one trial in each cell."""
    trials: list[dict[str, object]] = []
    steps: list[dict[str, object]] = []
    for index, (load, P) in enumerate(cells):
        trials.append(
            {"index": index, "point": {"load": load, "mass": 1.0, "pressure": P}, "repeat": 0, "reference": False}
        )
        steps.append({"step": "record", "trial": index, "on": True})
        for level in np.arange(P, -1.0, -1e5):
            steps += [{"step": "set", "output": "pressure", "value": float(level)}, {"step": "hold", "duration": 2.5}]
        steps.append({"step": "record", "trial": index, "on": False})
    return {"name": "plan", "trials": trials, "steps": steps, "settings": {}}


def test_a_goal_is_not_called_out_of_reach_by_an_assumed_scatter() -> None:
    """One trial in each cell: K "has 5.1 %" and was out of reach of 0.6 %, which further trials came near."""

    def scattered(name: str, values: Array, chance: np.random.Generator) -> Array:
        """The muscle pulls by half a percent more or less in each trial."""
        return values + 1.5e3 * chance.standard_normal() if name == "pressure" else values

    run = sensors.recorded(read_as=scattered)
    found = Chooser(plan_of(sensors.CELLS), None, (Goal("K", 0.006, relative=True),)).propose([run], 4)
    assert (found.why, found.beyond, len(found.steps)) == ("", (), 4)


def test_what_no_trial_narrows_is_out_of_reach() -> None:
    """0.34 N of F_c are a backlash that nothing declares: 0.1 N was promised after some trials."""
    run = joined.day(0, friction=14.0)
    found = Chooser(plan_of(joined.CELLS), None, (Goal("F_c", 0.1, relative=False),)).propose([run], 4)
    assert (found.why, len(found.beyond)) == ("out of reach", 1)


def test_a_pressure_without_a_trial_is_predicted_with_the_scatter_that_was_fitted() -> None:
    """An assumed scatter of 2 % made "14 % to 18 %" of what came out at 0.3 %."""
    run, goals = sensors.recorded(), (Goal("K", 0.02, relative=True),)
    plan, known = plan_of(sensors.CELLS), [trial for trial in run.trials if trial.point["pressure"] != 3e5]
    found = Chooser(plan, None, goals).propose([replace(run, trials=tuple(known))], 4)
    assert found.steps
    assert all("first trial" in text for text, _ in found.lines)
    added = {found.cells[step.choice.cell].trials[0] for step in found.steps}
    done = known + [trial for trial in run.trials if trial.index in added]
    after = known_after(cells_of(plan), goals, [replace(run, trials=tuple(done))], None)
    assert after is not None
    came = max(e.parts.combined / (0.02 * e.value) for (symbol, _), e in after.reported.items() if symbol == "K")
    assert found.steps[-1].worst / 3 < came < 1.5 * found.steps[-1].worst
