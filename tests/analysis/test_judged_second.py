"""Contraction and relaxation held against the second simulated muscle, which nobody looks at while a fit is made.

`pytest -s -m study tests/analysis/test_judged_second.py` prints the tables; see `test_judged` for what is judged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from os import cpu_count

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs, verdicts
from pmabench.store.analyses.results import Analysis
from tests.analysis.judged import as_run
from tests.analysis.test_diagnosis import RIGHT
from tests.analysis.test_judged import (
    CLEAN_REFUSED,
    CLEAN_SEEDS,
    FAR,
    Judged,
    accepted,
    compared,
    far,
    named,
    share,
    table,
)
from tests.judge.second.campaign import CASES, campaign, slope, truth

SEEDS = 5
COVERED = 0.90
"""Share of accepted values whose interval holds the truth, of a muscle of other families than the candidates."""
NAMED_RIGHT, NAMED_WRONG = 0.85, 0.02
"""Share of campaigns with one cause that are named right, and of those with a name that is wrong."""
RIGHT = {**RIGHT, "drift": RIGHT["cell-drift"], "real": {"bend", "hysteresis", "creep"}}
"""Cause -> names that are right."""
FAULTY = [case for case in CASES if case[0] != "clean"]


def judged(asked: tuple[str, float, int]) -> Judged:
    """The reduction of a campaign (cause, amount, seed) against its truth."""
    cause, amount, seed = asked
    run = as_run(campaign(cause, amount, seed))
    analyses = reduce_runs([run])
    values, withheld = compared(analyses[0], truth(cause, amount), slope(cause, amount))
    return Judged(cause, amount, seed, tuple(verdicts([run], analyses)), values, withheld, sure(analyses[0]))


def sure(analysis: Analysis) -> tuple[str, ...]:
    """Names of causes, with `undecided` where none of them is called sure."""
    form = analysis.facts["form"]
    names = (*named(analysis), *(["mass"] if form["wrong_weight"] else []))
    alone = all(one["alone"] for one in form["explanations"])
    return names if alone and form["state"] in ("sound", "corrected", "doubtful") else (*names, "undecided")


def names(found: Sequence[Judged]) -> str:
    """By cause and size, what is said and how often."""
    lines = []
    for cause, size in dict.fromkeys((one.cause, one.size) for one in found):
        said = Counter(", ".join(one.named) for one in found if (one.cause, one.size) == (cause, size))
        lines.append(f"{cause:14s}{size:7.3f}  " + "; ".join(f"{many} {what or '-'}" for what, many in said.items()))
    return "\n".join(lines)


def studied(asked: Sequence[tuple[str, float, int]]) -> list[Judged]:
    with ProcessPoolExecutor(cpu_count()) as executor:
        return list(executor.map(judged, asked, chunksize=SEEDS))


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_accepted_values_of_the_second_muscle_are_right_whatever_is_wrong():
    found = studied([(cause, amount, seed) for cause, amount in FAULTY for seed in range(SEEDS)])
    print(f"\n{table(found)}\n{names(found)}")
    assert far(found) == []
    assert share(accepted(found)) >= COVERED
    single = [one for one in found if one.cause not in ("several", "real")]
    right = [set(one.named) - {"undecided"} == RIGHT[one.cause] for one in single]
    wrong = ["undecided" not in one.named and bool(set(one.named) - RIGHT[one.cause]) for one in single]
    print(f"{100 * np.mean(right):.1f} % named right, {100 * np.mean(wrong):.1f} % named wrong")
    assert np.mean(right) >= NAMED_RIGHT
    assert np.mean(wrong) <= NAMED_WRONG


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_clean_campaigns_of_the_second_muscle_stay_accepted():
    found = studied([("clean", 0.0, seed) for seed in range(CLEAN_SEEDS)])
    refused = [one for one in found if one.why or one.withheld]
    print(f"\n{table(found)}", *(f"{one.seed}: {one.why}" for one in refused), sep="\n")
    assert len(refused) <= CLEAN_REFUSED * CLEAN_SEEDS
    assert far(found) == []
    assert share(accepted(found)) >= COVERED


@pytest.mark.slow
def test_a_clean_campaign_of_the_second_muscle_is_accepted_and_right():
    one = judged(("clean", 0.0, 100))
    assert (one.why, one.withheld) == ((), 0)
    assert len(one.values) >= 12
    assert far([one]) == []


@pytest.mark.slow
def test_creep_of_the_second_muscle_is_named_and_its_values_are_printed_and_right():
    one = judged(("creep", 0.04, 100))
    assert set(one.named) == {"creep"}
    assert one.withheld == 0
    assert share(one.values) >= COVERED
    assert one.worst <= FAR


@pytest.mark.slow
def test_hysteresis_of_the_second_muscle_is_named_and_nothing_else_is():
    one = judged(("hysteresis", 20.0, 100))
    assert set(one.named) - {"undecided"} == {"hysteresis"}
    assert far([one]) == []
