"""A run that goes on begins with the reference trial, marked, in no fit; what it says of drift is told (R7)."""

from pathlib import Path

import pytest

from pmabench.base.errors import Interrupted
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.resume import continue_run, remaining, with_reference
from pmabench.engine.run import run_plan
from pmabench.kinds.contraction_relaxation.reduction import reduce
from pmabench.protocol.plan import Ask, Record
from pmabench.store.catalogue import catalogue
from pmabench.store.chain import open_chain

PROTOCOL = """
schema: pmabench.protocol/1
kind: contraction-relaxation
name: with a reference trial
source: none
needs: {free_end: weights}
sample_rate: 500 Hz
record: [pressure, displacement, force]
prepare:
  precondition: {cycles: 1, pressure: 300 kPa, hold: 1 s}
sweep:
  matrix:
    load: [6 kg, 11 kg]
    pressure: [200 kPa, 300 kPa]
  repeat: {count: 2, as: blocks}
reference_trial: {load: 6 kg, pressure: 250 kPa, every: 4}
trial:
  contract: {hold: 3 s}
  relax: {by: 100 kPa, hold: 1 s, then: 0 kPa, hold_at_end: 3 s}
"""
REFERENCES = (0, 5, 10)
TRIALS = 11


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("protocol") / "reference.yaml"
    path.write_text(PROTOCOL)
    made = prepare(str(path), "mock", "mas-20-250-paper0")
    assert tuple(trial.index for trial in made.plan.trials if trial.reference) == REFERENCES
    assert len(made.plan.trials) == TRIALS
    return made


def run(made, out, on=None, until=None):
    """A run, or one that goes on after `on`; the trial `until` is begun and not ended."""

    def progress(where):
        if until is not None and where.trial == until:
            raise Interrupted("the test", 130)

    before = None if on is None else continue_run(on, made.plan, made.mounted, made.protocol_text)
    return run_plan(
        made.plan, made.mounted, ConfirmedBeforehand(), out=out, protocol_text=made.protocol_text, continues=before,
        progress=progress,
    ).folder  # fmt: skip


@pytest.fixture(scope="module")
def chain(made, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs")
    first = run(made, out, until=3)
    second = run(made, out, on=first, until=7)
    third = run(made, out, on=second)
    return open_chain(third)


def test_each_new_start_does_the_reference_trial_first_and_each_planned_trial_once(chain):
    begun = [[(trial.index, trial.again, trial.status) for trial in run.trials] for run in chain]
    assert begun[0] == [*((index, False, "finished") for index in range(3)), (3, False, "interrupted")]
    assert begun[1] == [
        (TRIALS, True, "finished"),
        *((index, False, "finished") for index in range(3, 7)),
        (7, False, "interrupted"),
    ]
    assert begun[2] == [(TRIALS + 1, True, "finished"), *((index, False, "finished") for index in range(7, TRIALS))]
    for run in chain[1:]:
        assert (run.trials[0].point, run.trials[0].reference) == (chain[0].trials[0].point, True)


def test_it_is_counted_as_none_of_the_plan(chain):
    rows = catalogue(Path(chain[0].path).parent)
    assert sorted((row.trials_before, row.trials_finished, row.trials_planned) for row in rows) == [
        (0, 3, TRIALS), (3, 4, TRIALS), (7, 4, TRIALS),
    ]  # fmt: skip


def test_it_is_in_no_fit_and_compared_with_the_first(chain):
    analysis = reduce(chain)
    assert analysis.facts["trials_used"] == TRIALS
    left_out = {one.trial for one in analysis.dropped if "reference trial" in one.reason}
    assert left_out == {run.trials[0].name for run in chain[1:]}
    reported = [one for one in analysis.findings if "done again when the run went on" in one.text]
    assert [one.level for one in reported] == ["note", "note"]
    assert all(run.trials[0].name in one.text for run, one in zip(chain[1:], reported, strict=True))


def test_the_load_of_the_reference_trial_is_on_and_then_that_of_the_next(made):
    loads, on = [], None
    done = set(range(4))  # the next has 11 kg
    steps, again = with_reference(made.plan, remaining(made.plan, done), TRIALS)
    for step in steps:
        if isinstance(step, Ask):
            on = step.load
        if isinstance(step, Record) and step.on:
            loads.append((step.trial, on[0]))
    points = {trial.index: trial.point["load"] for trial in (*made.plan.trials, again)}
    assert loads == [(index, points[index]) for index in (TRIALS, *range(4, TRIALS))]


def test_a_reference_trial_that_comes_next_anyway_is_not_done_twice(made):
    for next_one in REFERENCES:
        left = remaining(made.plan, set(range(next_one)))
        assert with_reference(made.plan, left, TRIALS) == (left, None)
