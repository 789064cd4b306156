"""The muscle of paper 3 on its shipped benches: what a run records, and what stops it."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import read_stream

STROKE = (
    ("sweep.repeat.count", "1"),
    ("sweep.matrix.pressure", "[500 kPa]"),
    ("trial.mean", "17 mm"),
    ("trial.amplitude", "22 mm"),
)


def stroke(folder, bench, frequency, **options):
    """A sine over almost the whole stroke at 5 bar, on a plant that may be otherwise than its bench file says."""
    settings = [*STROKE, ("sweep.matrix.frequency", f"[{frequency} Hz]")]
    prepared = prepare("sinusoidal-displacement", bench, "daerden-20-200", settings)
    devices = tuple(replace(d, options={**d.options, **options}) for d in prepared.mounted.bench.devices)
    mounted = replace(prepared.mounted, bench=replace(prepared.mounted.bench, devices=devices))
    return run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=folder)


def test_the_loop_of_an_exact_regulator_is_60_newtons_wide(tmp_path):
    outcome = stroke(tmp_path, "mock-daerden-ideal", 1.0)
    assert outcome.status == "finished", outcome.why
    data = read_stream(outcome.folder)
    x, F = data["displacement"].to_numpy() / 0.2, data["force"].to_numpy()
    contracts, eps, branches = np.gradient(x) > 0, np.linspace(0.02, 0.15, 14), []
    for way in (contracts, ~contracts):
        order = np.argsort(x[way])
        branches.append(np.interp(eps, x[way][order], F[way][order]))
    np.testing.assert_allclose(branches[1] - branches[0], 60.0, atol=5.0)


def test_a_regulator_that_moves_air_is_worse_expanding(tmp_path):
    outcome = stroke(tmp_path, "mock-daerden", 1.0)
    assert outcome.status == "finished", outcome.why
    data = read_stream(outcome.folder)
    error = data["pressure"].to_numpy() - 5e5
    contracts = np.gradient(data["displacement_command"].to_numpy()) > 0
    assert error[contracts].min() == pytest.approx(-25e3, abs=3e3)
    assert error[~contracts].max() == pytest.approx(57e3, abs=4e3)


def test_3_hz_over_the_stroke_at_5_bar_is_refused(tmp_path):
    """The air in the muscle would come to 7 bar, above what it bears."""
    with pytest.raises(InvalidFile, match="pushes the air together to 69. kPa"):
        stroke(tmp_path, "mock-daerden", 3.0)


@pytest.mark.parametrize(("frequency", "slow_vent"), [(2.0, 2.0), (1.0, 20.0)])
def test_a_clogged_silencer_makes_too_much_of_what_is_allowed_and_the_trip_stops_it(tmp_path, frequency, slow_vent):
    outcome = stroke(tmp_path, "mock-daerden", frequency, slow_vent=slow_vent)
    assert (outcome.status, outcome.exit_code) == ("tripped", 5)
    assert outcome.why.startswith("pressure 6")
    assert outcome.extremes["pressure"][1] < 700e3


def test_the_same_with_an_exact_regulator_runs_through(tmp_path):
    """It is the air that stops the other one, not the motion."""
    outcome = stroke(tmp_path, "mock-daerden-ideal", 3.0)
    assert outcome.status == "finished", outcome.why
