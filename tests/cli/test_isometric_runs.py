"""Isometric pressurisation end to end on the simulated muscles in virtual time: run, process, report (docs/papers.md)."""

import csv
import json
from pathlib import Path

import pytest

from tests.calls import call

TRUTH = {200e3: (167.0, 6188.0), 300e3: (275.0, 6773.0), 400e3: (383.0, 7552.0), 500e3: (491.0, 8525.0)}
"""Pressure [Pa] -> F_ce [N] and K [N/m] of the muscle of paper 0 (tests/model)."""
BEGINS = 49e3 / 1.08
"""Where its force begins [Pa]."""


def analysed(folder, protocol, bench, specimen, *settings, code=0):
    sets = [part for setting in settings for part in ("--set", setting)]
    call("run", protocol, "--bench", bench, "--specimen", specimen, "--yes", "--out", folder / "runs", *sets)
    (run,) = (folder / "runs").glob("2*")
    call("process", run, code=code)
    (found,) = (folder / "analyses").rglob("analysis.json")
    return run, json.loads(found.read_text())


def values(analysis, symbol, method):
    found = [e for e in analysis["estimates"] if (e["symbol"], e["method"]) == (symbol, method)]
    return {next(iter(e["at"].values()), None): e for e in found}


def test_the_muscle_of_paper_3_gives_its_diameter_angle_and_exponent(tmp_path):
    """Papers digest 5.5: D0 20 mm, theta0 25 deg, alpha 2.6; friction of 30 N that has not quite turned after 4 mm."""
    small = ("sweep.repeat.count=1", "sample_rate=50 Hz")
    _, analysis = analysed(tmp_path, "isometric-pressurisation-paper3", "mock-daerden-ideal", "daerden-20-200", *small,
                           code=6)  # fmt: skip
    bent = [e for e in values(analysis, "F_ce", "isometric-sections").values() if e["withheld"]]
    assert bent, "a line over x does not reach the force of this muscle at x = 0"
    assert all("the force over contraction is bent" in e["note"] for e in bent)
    for symbol, truth in (("D_0", 0.02), ("theta_0", 0.43633231), ("alpha", 2.6)):
        (found,) = values(analysis, symbol, "daerden-section").values()
        assert found["value"] == pytest.approx(truth, rel=1e-3)
    friction = values(analysis, "F_f", "isometric-sides")
    assert all(e["value"] == pytest.approx(29.0, abs=1.5) for e in friction.values())
    for x, e in values(analysis, "c", "isometric-line").items():
        eps = x / 0.2
        assert e["value"] == pytest.approx(800 * eps * (eps - 0.22) / (eps + 0.04), abs=1.5)


@pytest.mark.parametrize("bench", ["mock-actuator-ideal", "mock-actuator"])
def test_the_muscle_of_paper_0_gives_its_dead_band_force_and_stiffness(tmp_path, bench):
    """F_ce = 1.08 P - 49 begins at 45.37 kPa (papers digest 5.1): paper 2's 0.45 bar within 0.02 bar."""
    small = ("sweep.repeat.count=2", "sweep.matrix.contraction=[0 %, 4 %, 8 %, 12 %]", "sample_rate=50 Hz")
    run, analysis = analysed(tmp_path, "isometric-pressurisation", bench, "mas-20-250-paper0", *small)
    for method in ("force-threshold", "isometric-line"):
        found = values(analysis, "p_0", method)[0.0]
        assert found["value"] == pytest.approx(BEGINS, abs=1e3)
        assert found["ci95"][0] - 0.1 <= BEGINS <= found["ci95"][1] + 0.1
        assert found["ci95"][1] - found["ci95"][0] < 8e3
    F_ce, K = (values(analysis, symbol, "isometric-sections") for symbol in ("F_ce", "K"))
    for P, (force, stiffness) in TRUTH.items():
        assert F_ce[P]["value"] == pytest.approx(force, abs=0.3)
        assert K[P]["value"] == pytest.approx(stiffness, rel=2e-3)
    assert any("S(eps) has another form" in f["text"] for f in analysis["findings"])
    if bench == "mock-actuator-ideal":
        report = tmp_path / "report.html"
        call("report", run, "-o", report)
        text = report.read_text()
        assert "Force by pressure, S, over contraction" in text
        assert "blue dots: filling, brown triangles: emptying" in text
        with next((tmp_path / "analyses").rglob("estimates.csv")).open(newline="") as file:
            assert {row["symbol"] for row in csv.DictReader(file)} >= {"m", "c", "H", "p_0", "F_ce", "K"}


def test_the_contractor_of_paper_2_gives_its_dead_band_by_both_rules(tmp_path):
    """Row 30: 0.45 bar within 0.02 bar."""
    small = ("sweep.repeat.count=2", "sweep.matrix.contraction=[0 %, 8 %, 16 %]", "sample_rate=50 Hz")
    _, analysis = analysed(tmp_path, "isometric-pressurisation", "mock-contractor", "contractor-30", *small)
    found = [values(analysis, "p_0", method)[0.0] for method in ("force-threshold", "isometric-line")]
    for e in found:
        assert e["value"] == pytest.approx(45e3, abs=2e3)
        assert e["ci95"][0] <= 45e3 <= e["ci95"][1]
        assert e["ci95"][1] - e["ci95"][0] < 8e3


def test_slopes_that_are_accepted_or_not(tmp_path):
    """K can be accepted: a line fits the muscle of paper 3 badly, so its intervals are wide, or K is withheld."""
    protocol = tmp_path / "narrow.yaml"
    shipped = Path(__file__).resolve().parents[2] / "protocols" / "isometric-pressurisation.yaml"
    protocol.write_text(shipped.read_text() + "\naccept: {K: {relative_interval: 5 %}}\n")
    small = ["--set", "sweep.repeat.count=1", "--set", "sample_rate=50 Hz"]
    call(
        "run", protocol, "--bench", "mock-daerden-ideal", "--specimen", "daerden-20-200", "--yes", "--out",
        tmp_path / "runs", *small,
    )  # fmt: skip
    (run,) = (tmp_path / "runs").glob("2*")
    output = call("process", run, "-v", code=6).output
    assert "K at pressure 500 kPa: interval" in output
    assert "K at pressure 300 kPa" in output
