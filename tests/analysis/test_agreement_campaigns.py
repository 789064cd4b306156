"""Tests of one specimen processed together: those of one simulated muscle agree, a built-in contradiction is refused.

The motion is that of shipped protocols on shipped benches, recorded once; a campaign of another seed has noise put on
its channels. A contradiction is put into the record of one test alone, which then says something else than the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmabench.kinds.reduce import compared, reduce_runs, verdicts
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import RunData
from tests.analysis.driven_runs import recorded
from tests.analysis.simulate import LOADS, contraction_run, rig, static_run

NOISE = {"displacement": 2e-6, "force": 0.3, "pressure": 500.0}
SHORT: dict[str, tuple[tuple[str, str], ...]] = {
    "sinusoidal-displacement": (
        ("sweep.matrix.frequency", "[0.5 Hz, 1 Hz, 3 Hz]"),
        ("trial.at_least", "4 s"),
        ("trial.mean", "5 mm"),
    ),
    "isobaric-ramp": (("sweep.matrix.pressure", "[200 kPa, 300 kPa, 400 kPa]"), ("trial.cycles", "3")),
    "isometric-pressurisation": (("sweep.repeat.count", "2"),),
    "step-displacement": (
        ("prepare.precondition.cycles", "0"),
        ("sweep.matrix.pressure", "[300 kPa]"),
        ("sweep.matrix.step", "[3 mm, 6 mm]"),
        ("sweep.matrix.speed", "[20 mm/s]"),
        ("trial.cycles", "3"),
        ("trial.hold", "0.6 s"),
    ),
}
"""Protocol -> what is made shorter; about 5 mm the stroke of the sines holds x = 0, where they give F_ce."""
BENCHES = [("mock-actuator", "mas-20-250-paper0"), ("mock-contractor", "contractor-30")]


@pytest.fixture(scope="module", params=BENCHES, ids=[bench for bench, _ in BENCHES])
def driven(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[RunData]:
    """Sines, isobaric ramps, isometric tests and steps of one muscle; the isometric tests once more as an old file."""
    bench, specimen = request.param
    out = tmp_path_factory.mktemp(bench)
    runs = [recorded(out, protocol, bench, specimen, *settings) for protocol, settings in SHORT.items()]
    return [*runs, replace(runs[2], kind="isometric", id=f"{runs[2].id}-old")]


@pytest.fixture(scope="module")
def right(driven: list[RunData]) -> list[Analysis]:
    """The analysis of each run, without their comparison."""
    return reduce_runs(driven)[:-1]


def changed(run: RunData, channel: str, gain: float = 1.0, noise: float = 0.0, seed: int = 0) -> RunData:
    chance = np.random.default_rng([seed, len(run.id), len(channel)])
    trials = []
    for trial in run.trials:
        values = trial.channels[channel] * gain + noise * chance.standard_normal(len(trial.t))
        trials.append(replace(trial, channels={**trial.channels, channel: values}))
    return replace(run, trials=tuple(trials))


def again(runs: Sequence[RunData], seed: int) -> list[RunData]:
    """The same motions with noise of another seed on every channel."""
    found = list(runs)
    for number in range(len(found)):
        for channel, size in NOISE.items():
            if channel in found[number].trials[0].channels:
                found[number] = changed(found[number], channel, noise=size, seed=1000 * seed + number)
    return found


def agreement_of(runs: Sequence[RunData]) -> Analysis:
    (found,) = [analysis for analysis in reduce_runs(runs) if analysis.kind == "agreement"]
    return found


def of_weights(seed: int) -> list[RunData]:
    """Static load and contraction of plant 5.1, whose sines and ramps mock-actuator records."""
    bench = rig("paper0", uncertainty=True)
    cells = [(load, P) for load in LOADS[1:6:2] for P in (2e5, 3e5, 4e5)]
    return [static_run(bench, LOADS[::4], repeats=2, seed=seed), contraction_run(bench, cells, seed=seed)]


def test_driven_tests_of_one_muscle_are_compared_and_agree(right: list[Analysis]) -> None:
    found = compared(right)
    assert found is not None
    titles = {e.method for e in found.estimates}
    pairs = ["sine against isobaric", "sine against isometric", "isobaric against isometric"]
    pairs += [f"{one} against recorded isometric" for one in ("sine", "isobaric", "isometric")]
    pairs += ["isobaric against step of displacement, steps of two sizes"]
    assert titles >= set(pairs)
    assert any("step of displacement, after stretching" in finding.text for finding in found.findings)
    assert {e.symbol for e in found.estimates} >= {"K", "B", "F_c", "F"}
    assert found.refusals == ()
    assert not any(finding.level == "doubt" for finding in found.findings)


@pytest.mark.parametrize(
    ("kind", "channel", "gain"),
    [(2, "force", 1.05), (0, "force", 0.95), (3, "force", 0.9), (4, "force", 1.1)],
)
def test_a_test_that_contradicts_the_others_is_refused(
    driven: list[RunData], right: list[Analysis], kind: int, channel: str, gain: float
) -> None:
    """A cell that has another gain in one of the tests, and nobody knows it."""
    wrong = changed(driven[kind], channel, gain)
    analyses = [*right[:kind], *reduce_runs([wrong]), *right[kind + 1 :]]
    found = compared(analyses)
    assert found is not None
    assert found.refusals
    assert any(finding.level == "doubt" for finding in found.findings)
    runs = [*driven[:kind], wrong, *driven[kind + 1 :]]
    assert set(found.refusals) <= set(verdicts(runs, [*analyses, found]))
    word = ("sine", "isobaric", "isometric", "step of displacement", "recorded isometric")[kind]
    assert all(f"{word} " in refusal and "disagree" in refusal for refusal in found.refusals)
    of_form = [refusal for refusal in found.refusals if refusal.split()[0] in ("F_ce", "F", "K")]
    assert of_form
    assert all("(isobaric-ramp) measures the curve itself" in refusal for refusal in of_form)


def test_a_displacement_of_another_gain_is_found_by_its_command_and_contradicts_nothing(
    driven: list[RunData], right: list[Analysis]
) -> None:
    """The test itself shows it, so its intervals hold what the right sensor gives."""
    (found,) = reduce_runs([changed(driven[1], "displacement", 1.06)])
    assert any("+6.0% of the way that the drive was sent" in finding.text for finding in found.findings)
    K = [e for e in found.estimates if e.symbol == "K" and e.value is not None]
    true = {(e.method, tuple(e.at.items())): e.value for e in right[1].estimates if e.symbol == "K"}
    assert K
    for e in K:
        assert abs(e.value - (true[e.method, tuple(e.at.items())] or e.value)) < e.parts.combined


def test_an_agreeing_campaign_raises_no_alarm(driven: list[RunData]) -> None:
    assert agreement_of(again(driven, 1)).refusals == ()


def test_all_kinds_of_tests_of_one_muscle_agree(tmp_path: Path) -> None:
    """Static load and contraction with weights, sines with a driven end: 0 refusals, friction at rest above F_c."""
    sines = recorded(
        tmp_path, "sinusoidal-displacement", "mock-actuator", "mas-20-250-paper0", *SHORT["sinusoidal-displacement"]
    )
    weights = [replace(run, manifest=sines.manifest) for run in of_weights(3)]
    found = agreement_of([*weights, sines])
    assert found.refusals == ()
    titles = {e.method for e in found.estimates}
    assert titles == {"static load against contraction", "static load against sine", "contraction against sine"}
    rest = [f.text for f in found.findings if f.text.startswith("F_c, static load") and "friction at rest" in f.text]
    assert len(rest) == 2
    assert all("they measure different things" in text for text in rest)


@pytest.mark.study
def test_agreeing_campaigns_raise_an_alarm_in_one_of_a_hundred_at_most(driven: list[RunData]) -> None:
    alarms = {seed for seed in range(100, 150) if agreement_of(again(driven, seed)).refusals}
    print(f"agreeing driven campaigns with a refusal: {len(alarms)} of 50")
    assert not alarms


@pytest.mark.study
def test_agreeing_campaigns_with_weights_raise_an_alarm_in_one_of_a_hundred_at_most(tmp_path: Path) -> None:
    """Static load, contraction, and the free length against the pressures at which a held muscle begins to pull."""
    specimen = "mas-20-250-paper0"
    pressures = ("sweep.matrix.pressure", "{start: 40 kPa, stop: 360 kPa, step: 20 kPa}")
    free = recorded(tmp_path, "free-contraction", "mock-ideal", specimen, pressures, ("sweep.repeat.count", "2"))
    held = recorded(tmp_path, "isometric-pressurisation", "mock-actuator-ideal", specimen, ("sweep.repeat.count", "2"))
    alarms = set()
    for seed in range(100, 150):
        weights = [replace(run, manifest=free.manifest) for run in of_weights(seed)]
        found = agreement_of([*weights, *again([free, held], seed)])
        assert "isometric against free contraction" in {e.method for e in found.estimates}
        alarms |= {seed} if found.refusals else set()
    print(f"agreeing campaigns of weights, free and held muscles with a refusal: {len(alarms)} of 50")
    assert not alarms
