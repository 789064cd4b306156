"""Predictions of a dry run against 12 trials of a muscle that no straight line describes: stroke, force, duration."""

import pytest
from click.testing import CliRunner

from pmabench.cli.dry_run import muscle_of, simulate
from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan

SWEEP = [
    ("sweep.repeat.count", "1"),
    ("sweep.matrix.load", "[11 kg, 26 kg, 41 kg]"),
    ("sweep.matrix.pressure", "[350 kPa, 400 kPa, 450 kPa, 500 kPa]"),
]
SPECIMEN = "dmsp-20-250-real"
CAMPAIGN = ("real-muscle-ramps", "real-muscle-pressurisation", "real-muscle-sines")
EARLIER, TYPE = 0.05, 0.2
"""Most by which a prediction may be off: from an earlier analysis, and what is stated of a type."""


@pytest.fixture(scope="module")
def trials():
    """What the trials come to on the simulated muscle with hysteresis and creep, by loads and pressures."""
    made = prepare("contraction-relaxation", "mock-real", SPECIMEN, SWEEP)
    done = simulate(made.plan, made.mounted, None)
    assert done["status"] == "finished", done["why"]
    assert len(done["predicted"]) == 12
    return done["predicted"]


def compare(trials, bench, given, most):
    rig = prepare("contraction-relaxation", bench, SPECIMEN, SWEEP)
    muscle = muscle_of(rig.mounted, given)
    predicted = simulate(rig.plan, rig.mounted, muscle)["predicted"]
    for true, said in zip(trials, predicted, strict=True):
        assert said["point"] == true["point"]
        assert said["duration"] == pytest.approx(true["duration"], rel=most)
        for channel in ("displacement", "force"):
            assert said["highest"][channel] == pytest.approx(true["highest"][channel], rel=most), (said, true)
    return muscle


def test_a_type_predicts_within_what_it_states(trials):
    muscle = compare(trials, "labjack", None, TYPE)
    assert "type DMSP-20 of the library" in muscle.source
    assert "+-20 %" in muscle.source


@pytest.mark.study
@pytest.mark.parametrize("bench", ["ni", "serial", "wires", "alicat"])
def test_the_same_on_every_rig(trials, bench):
    compare(trials, bench, None, TYPE)


@pytest.mark.study
def test_an_earlier_analysis_predicts_within_5_percent(trials, tmp_path, monkeypatch):
    """A surface of three slow tests, of which none hung a weight on the muscle."""
    monkeypatch.chdir(tmp_path)
    for protocol in CAMPAIGN:
        made = prepare(protocol, "mock-real-actuator", SPECIMEN, [])
        assert run_plan(made.plan, made.mounted, ConfirmedBeforehand(), out=tmp_path / "runs").status == "finished"
    runs = sorted(str(path) for path in (tmp_path / "runs").iterdir())
    done = CliRunner().invoke(main, ["process", *runs, "--form", "surface"])
    assert done.exit_code == 0, done.output
    (folder,) = (tmp_path / "analyses").iterdir()
    muscle = compare(trials, "labjack", folder, EARLIER)
    assert muscle.source.startswith("SIMULATED analysis")


@pytest.mark.study
def test_coefficients_of_an_earlier_analysis_predict_within_5_percent(tmp_path, monkeypatch):
    """The same of a straight muscle, by F_ce, K, B_c and B_r over pressure."""
    monkeypatch.chdir(tmp_path)
    made = prepare(
        "contraction-relaxation",
        "mock",
        "mas-20-250-paper0",
        [*SWEEP[:1], ("sweep.matrix.load", "[6 kg, 11 kg, 21 kg, 26 kg]")],
    )
    assert run_plan(made.plan, made.mounted, ConfirmedBeforehand(), out=tmp_path / "runs").status == "finished"
    (run,) = (tmp_path / "runs").iterdir()
    CliRunner().invoke(main, ["process", str(run)])
    (folder,) = (tmp_path / "analyses").iterdir()
    true = simulate(made.plan, made.mounted, None)["predicted"]
    said = simulate(made.plan, made.mounted, muscle_of(made.mounted, folder))["predicted"]
    for one, other in zip(true, said, strict=True):
        if one["highest"]["displacement"] > 5e-3:
            for channel in ("displacement", "force"):
                assert other["highest"][channel] == pytest.approx(one["highest"][channel], rel=EARLIER)
