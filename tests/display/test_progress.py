"""How far, and what the plan has left, against plans that can be added up by hand."""

import pytest

from pmabench.display.state import Progress
from pmabench.store.records import Event
from tests.display.recorded import BASELINE, HOLD, LENGTH, plan

POINTS = [(58.86, 3e5)] * 10


def events(*reported):
    return [Event(number, t, kind, data) for number, (t, kind, data) in enumerate(reported)]


def command(t, index, phase, value):
    return t, "command", {"output": "pressure", "type": "set", "phase": phase, "trial": index, "value": value}


def trial(index, start, pace=1.0):
    """The events of one trial that takes `pace` times as long as planned."""
    return [
        (start, "trial-begin", {"trial": index}),
        command(start + pace * BASELINE, index, "contract", 3e5),
        command(start + pace * (BASELINE + HOLD), index, "vent", 0.0),
        (start + pace * LENGTH, "trial-end", {"trial": index, "status": "finished"}),
    ]


def taken(progress, reported):
    for event in events(*reported):
        progress.take(event)
    return progress


@pytest.mark.parametrize("pace", [1.0, 1.5, 0.5])
def test_after_half_of_the_trials_half_of_the_plan_is_left(pace):
    """Whatever the pace was: what is left is said by the plan."""
    reported = [entry for index in range(5) for entry in trial(index, index * pace * LENGTH, pace)]
    data = plan(POINTS) | {"steps": plan(POINTS)["steps"][1:]}
    progress = taken(Progress(data), reported)
    now = 5 * pace * LENGTH
    assert progress.done(now) == pytest.approx(0.5)
    assert progress.left(now) == pytest.approx(5 * LENGTH)


def test_inside_a_trial_time_counts_and_does_not_move_at_its_end():
    progress = taken(Progress(plan(POINTS)), trial(0, 3.0)[:2])
    half, end, late = (progress.done(3.0 + since) for since in (LENGTH / 2, LENGTH, 10 * LENGTH))
    assert half == pytest.approx((3.0 + LENGTH / 2) / (3.0 + 10 * LENGTH))
    assert end == late == pytest.approx((3.0 + LENGTH) / (3.0 + 10 * LENGTH))


def test_the_operators_time_does_not_count():
    def left(hands):
        reported = [(0.0, "prompt", {"phase": "load"}), (hands, "answer", {}), *trial(0, hands + 3.0)]
        return taken(Progress(plan(POINTS)), reported).left(hands + 3.0 + LENGTH)

    assert left(0.0) == left(500.0) == pytest.approx(9 * LENGTH)


def test_while_the_operator_is_asked_nothing_goes_on():
    progress = taken(Progress(plan(POINTS)), [(0.0, "prompt", {"phase": "load"})])
    assert progress.done(1000.0) == 0.0
    assert progress.left(1000.0) == pytest.approx(3.0 + 10 * LENGTH)


def test_in_a_pause_the_time_left_does_not_move():
    data = plan(POINTS) | {"steps": plan(POINTS)["steps"][1:]}
    progress = taken(Progress(data), [*trial(0, 0.0), (LENGTH, "pause", {})])
    before = progress.left(LENGTH)
    assert before == pytest.approx(9 * LENGTH)
    assert progress.left(LENGTH + 600.0) == before
    on = LENGTH + 600.0
    progress = taken(progress, [(on, "goes-on", {}), *trial(1, on)])
    assert progress.left(on + LENGTH) == pytest.approx(8 * LENGTH)


@pytest.mark.parametrize(
    "stop",
    [
        [(10.0, "pause", {}), (110.0, "prompt", {}), (210.0, "answer", {}), (310.0, "goes-on", {})],
        [(10.0, "prompt", {}), (110.0, "prompt", {}), (310.0, "answer", {})],
    ],
)
def test_a_stop_lasts_from_its_beginning_to_its_own_end(stop):
    """The second trial is 2 s old when it begins."""
    progress = taken(Progress(plan(POINTS)), [*trial(0, 0.0), (8.0, "trial-begin", {"trial": 1}), *stop])
    there = 3.0 + LENGTH + (10.0 - 8.0)
    assert progress.done(310.0) == pytest.approx(there / (3.0 + 10 * LENGTH))
    assert progress.done(312.0) == pytest.approx((there + 2.0) / (3.0 + 10 * LENGTH))


def test_a_trial_that_ends_in_a_stop_takes_its_place():
    reported = [(0.0, "trial-begin", {"trial": 0}), (1.0, "prompt", {}), (61.0, "trial-end", {"trial": 0})]
    assert taken(Progress(plan(POINTS)), reported).left(61.0) == pytest.approx(9 * LENGTH)


def test_a_run_that_goes_on_begins_where_the_last_one_ended():
    """Trials 0 to 5 were done before; the reference trial is done again, then the rest."""
    again = [(0.0, "trial-begin", {"trial": 10, "again": True}), (7.0, "trial-end", {"trial": 10})]
    data = plan(POINTS) | {"steps": plan(POINTS)["steps"][1:]}
    progress = taken(Progress(data, before=range(6)), again)
    assert progress.done(7.0) == pytest.approx(0.6)
    progress = taken(progress, [*trial(6, 7.0, 2.0), *trial(7, 7.0 + 2 * LENGTH, 2.0)])
    assert progress.left(7.0 + 4 * LENGTH) == pytest.approx(2 * LENGTH)
    assert progress.done(7.0 + 4 * LENGTH) == pytest.approx(0.8)


def test_a_trial_that_is_begun_again_takes_the_pointer_back():
    reported = [*trial(0, 0.0), *trial(1, 10.0), (20.0, "trial-begin", {"trial": 0})]
    assert taken(Progress(plan(POINTS)), reported).done(20.0) == pytest.approx(3.0 / (3.0 + 10 * LENGTH))


@pytest.mark.parametrize(
    "data", [{}, {"steps": None}, {"steps": [{"step": "later"}]}, {"steps": [{"phase": 1}]}, {"steps": 3}]
)
def test_a_plan_that_cannot_be_read_shows_nothing(data):
    progress = taken(Progress(data), trial(0, 0.0))
    assert (progress.done(1.0), progress.left(1.0)) == (0.0, None)
