"""A run that goes on does each trial that is left, in order, once, with what it needs before it (R7)."""

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import InvalidFile
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.resume import remaining, sources
from pmabench.protocol.plan import Ask, Follow, Ramp, Record, Seek, Set
from pmabench.session import ensure
from tests.engine.benches import mounted

BENCHES = {
    "contraction-relaxation": ("mock", "mas-20-250-paper0"),
    "static-load": ("mock", "mas-20-250-paper0"),
    "ultimate-gain": ("mock", "mas-20-250-paper0"),
    "ultimate-gain-relay": ("mock", "mas-20-250-paper0"),
    "positioning-pi": ("mock", "mas-20-250-paper0"),
    "sinusoidal-displacement": ("mock-actuator", "mas-20-250-paper0"),
    "isobaric-ramp": ("mock-actuator", "mas-20-250-paper0"),
    "closed-volume": ("mock-daerden-closed", "daerden-20-200"),
    "isometric-pressurisation": ("mock-contractor", "contractor-30"),
    "free-contraction": ("mock-contractor-free", "contractor-30"),
    "arm-angle": ("mock-arm", "arm-30"),
}
EXAMPLES = settings(max_examples=12)


@cache
def plan_of(kind):
    return prepare(kind, *BENCHES[kind]).plan


def begun(steps):
    return [step.trial for step in steps if isinstance(step, Record) and step.on and step.trial is not None]


def ended(steps):
    """The trials whose end is reached."""
    found, inside = [], None
    for step in steps:
        if isinstance(step, Record):
            if not step.on and inside is not None:
                found.append(inside)
            inside = step.trial if step.on else None
    return found


@pytest.mark.parametrize("kind", BENCHES)
@EXAMPLES
@given(data=st.data())
def test_each_trial_that_is_left_is_there_once_in_order(kind, data):
    plan = plan_of(kind)
    indices = begun(plan.steps)
    done = data.draw(st.sets(st.sampled_from(indices)))
    assert begun(remaining(plan, done)) == [index for index in indices if index not in done]


@pytest.mark.parametrize("kind", BENCHES)
@EXAMPLES
@given(data=st.data())
def test_cut_anywhere_and_gone_on_with_until_done_each_trial_is_finished_once_in_order(kind, data):
    plan = plan_of(kind)
    finished: list[int] = []
    steps = plan.steps
    for cut in [*data.draw(st.lists(st.floats(0.0, 1.0), max_size=6)), 1.0]:
        finished += ended(steps[: round(cut * len(steps))])
        steps = remaining(plan, set(finished))
    assert finished == begun(plan.steps)
    assert begun(steps) == []


@pytest.mark.parametrize("kind", BENCHES)
def test_nothing_done_is_the_whole_plan(kind):
    assert remaining(plan_of(kind), set()) == plan_of(kind).steps


@pytest.mark.parametrize("kind", BENCHES)
@EXAMPLES
@given(data=st.data())
def test_each_trial_has_the_load_that_it_has_in_the_plan(kind, data):
    plan = plan_of(kind)

    def loads(steps):
        load, found = None, {}
        for step in steps:
            if isinstance(step, Ask):
                load = step.load
            if isinstance(step, Record) and step.on and step.trial is not None:
                found[step.trial] = load
        return found

    done = data.draw(st.sets(st.sampled_from(begun(plan.steps))))
    left = loads(remaining(plan, done))
    assert left == {trial: load for trial, load in loads(plan.steps).items() if trial not in done}


@pytest.mark.parametrize("kind", BENCHES)
@EXAMPLES
@given(data=st.data())
def test_the_specimen_is_prepared_before_the_first_trial_and_no_ramp_jumps(kind, data):
    plan = plan_of(kind)
    done = data.draw(st.sets(st.sampled_from(begun(plan.steps)), max_size=len(begun(plan.steps)) - 1))
    steps = remaining(plan, done)
    if begun(steps):
        before = steps[: next(n for n, step in enumerate(steps) if isinstance(step, Record))]
        assert sum(step.phase == "precondition" for step in before) == sum(
            step.phase == "precondition" for step in plan.steps
        )
    where: dict[str, float | None] = {"displacement": 0.0, "pressure": 0.0}
    for step in steps:
        if isinstance(step, Ramp):
            known = where[step.output]
            assert known is None or step.origin == pytest.approx(known), f"{step} where it stands at {known}"
            where[step.output] = step.to
        elif isinstance(step, Set):
            where[step.output] = step.value
        elif isinstance(step, Seek):
            where[step.output] = None
        elif isinstance(step, Follow):
            where[step.output] = step.mean


def test_a_session_is_said_to_be_none_to_go_on_with(tmp_path):
    session = ensure(mounted("mock-session"), ConfirmedBeforehand(), tmp_path / "runs").in_session["run"]
    with pytest.raises(InvalidFile, match="of kind session without trials: .* run the protocol again"):
        sources(tmp_path / "runs" / session)
