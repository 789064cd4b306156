"""Runs that are no measurement: dead channels, clocks that stand, points without a name. Each ends with a reason.

The runs are those of the independent simulators, with one thing wrong. Of these most ended in an error of the program.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pmabench.analysis.shared.sound import sound
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.records import Flag, RunData, TrialData
from tests.analysis import judged_forms
from tests.analysis.judged_forms import KINDS

KINDS_TRIED = [
    "closed-volume", "free-contraction", "isometric-pressurisation", "mass-flow", "step-displacement", "recorded-sine",
    "recorded-step", "arm-angle", "positioning", "relaxation", "joint-sweep", "joint-torque", "joint-step",
    "platform-step", "isobaric-line", "open-loop",
]  # fmt: skip
MOST = 6
"""Trials of a run."""
Change = Callable[[TrialData], TrialData]


@cache
def run_of(kind: str) -> RunData:
    """A sound run of the kind."""
    made: list[RunData] = []

    def caught(*given):
        made.append(as_run(*given))
        return made[-1]

    as_run, judged_forms.as_run = judged_forms.as_run, caught
    try:
        KINDS[kind].reduced("clean", 0.0, 1)
    finally:
        judged_forms.as_run = as_run
    return replace(made[0], trials=made[0].trials[:MOST])


def of_channels(change: Callable[[str, np.ndarray], np.ndarray]) -> Change:
    return lambda trial: replace(trial, channels={name: change(name, y.copy()) for name, y in trial.channels.items()})


def only(name: str, value: float) -> Change:
    return of_channels(lambda channel, y: np.full_like(y, value) if channel == name else y)


def without(trial: TrialData, *names: str) -> TrialData:
    return replace(trial, point={name: value for name, value in trial.point.items() if name not in names})


def first_rows(n: int) -> Change:
    return lambda trial: replace(
        trial, t=trial.t[:n], flags=trial.flags[:n], channels={name: y[:n] for name, y in trial.channels.items()}
    )


def tail(_name: str, y: np.ndarray) -> np.ndarray:
    y[3 * len(y) // 4 :] = np.nan
    return y


USELESS: dict[str, tuple[Change, str]] = {
    "no number": (of_channels(lambda _, y: np.full_like(y, np.nan)), ""),
    "one sample": (first_rows(1), "it has only one sample"),
    "no sample": (first_rows(0), "no sample was recorded"),
    "a clock that stands": (lambda trial: replace(trial, t=np.full_like(trial.t, trial.t[0])), "its times do not rise"),
    "a clock that goes back": (lambda trial: replace(trial, t=trial.t[::-1].copy()), "its times do not rise"),
}
"""Nothing can come out: change of each trial, and the begin of the reason."""
ODD: dict[str, Change] = {
    "the end is no number": of_channels(tail),
    "all negated": of_channels(lambda _, y: -y),
    "a thousand times": of_channels(lambda _, y: 1e3 * y),
    "all zero": of_channels(lambda _, y: 0.0 * y),
    "pressure negated": of_channels(lambda name, y: -y if name == "pressure" else y),
    **{f"{name} is no number": only(name, np.nan) for name in ("pressure", "displacement", "force", "angle")},
    **{f"{name} stands": only(name, 1e-3) for name in ("pressure", "force")},
    "one infinite sample": of_channels(lambda _, y: np.where(np.arange(len(y)) == len(y) // 2, np.inf, y)),
    "no point": lambda trial: without(trial, *trial.point),
    "points at 0": lambda trial: replace(trial, point=dict.fromkeys(trial.point, 0.0)),
    "points below 0": lambda trial: replace(trial, point={name: -abs(v) for name, v in trial.point.items()}),
    "no commands": lambda trial: replace(trial, commands=()),
    "two samples": first_rows(2),
}
"""What comes out may be little, but not an error of the program."""


@pytest.mark.parametrize("kind", KINDS_TRIED)
def test_a_run_without_a_measurement_gives_no_value_and_says_why(kind):
    run = run_of(kind)
    for change, reason in USELESS.values():
        (analysis,) = reduce_runs([replace(run, trials=tuple(map(change, run.trials)))])
        assert not [e for e in analysis.estimates if e.value is not None]
        assert {one.trial for one in analysis.dropped} == {trial.name for trial in run.trials}
        assert all(one.reason.startswith(reason) for one in analysis.dropped)


BROKE = [
    ("arm-angle", "all negated"), ("arm-angle", "pressure negated"), ("arm-angle", "points below 0"),
    ("closed-volume", "no point"), ("closed-volume", "pressure is no number"),
    ("isobaric-line", "no commands"), ("isobaric-line", "points at 0"), ("isobaric-line", "force is no number"),
    ("joint-step", "no point"), ("joint-sweep", "one infinite sample"), ("joint-torque", "no point"),
    ("mass-flow", "no point"), ("mass-flow", "pressure stands"), ("platform-step", "the end is no number"),
    ("platform-step", "points at 0"), ("relaxation", "force is no number"),
    ("step-displacement", "one infinite sample"),
]  # fmt: skip
"""Those that ended in an error of the program."""


def ends_with_reasons(kind: str, what: str) -> None:
    """In all trials, and in the first alone."""
    run, change = run_of(kind), ODD[what]
    for trials in (tuple(map(change, run.trials)), (change(run.trials[0]), *run.trials[1:])):
        for analysis in reduce_runs([replace(run, trials=trials)]):
            assert all(one.reason for one in analysis.dropped)
            assert all(e.note for e in analysis.estimates if e.value is None)


@pytest.mark.parametrize(("kind", "what"), BROKE)
def test_runs_that_ended_in_an_error_of_the_program_end_with_reasons(kind, what):
    ends_with_reasons(kind, what)


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS_TRIED)
@pytest.mark.parametrize("what", ODD)
def test_odd_runs_end_with_reasons(kind, what):
    ends_with_reasons(kind, what)


def test_a_sample_without_a_number_is_a_gap_and_a_channel_without_any_is_not_recorded():
    run = run_of("relaxation")
    odd = replace(run.trials[0], channels=run.trials[0].channels | {"supply": np.full(len(run.trials[0].t), np.nan)})
    odd.channels["force"][7] = np.inf
    (found,), dropped = sound([replace(run, trials=(odd, *run.trials[1:]))])
    assert not dropped
    trial = found.trials[0]
    assert "supply" not in trial.channels
    assert np.flatnonzero(trial.flags & Flag.GAP).tolist() == [7]
    assert np.isnan(trial.channels["force"][7])
    assert all(one.channels is other.channels for one, other in zip(found.trials[1:], run.trials[1:], strict=True))
