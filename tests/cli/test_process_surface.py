"""`pmabench process RUN... --form surface`: slow tests of one muscle together, from its runs to a stored analysis.

The muscle of the mock bench is a published surface with hysteresis and creep; its closed form is written out here.
"""

import json
from math import exp, hypot, log10
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run
from tests.test_real_bench import ran

PROTOCOLS = ("real-muscle-ramps", "real-muscle-pressurisation", "real-muscle-sines")


CREPT = sum(0.004 * (1 - exp(-5.0 / T)) for T in (0.5, 1.58, 5.0, 15.8, 50.0, 158.0))
"""Share of a contraction that has crept 5 s after it was reached."""


def force(x, P):
    """F [N] of the surface 5 s after the muscle came to x [m] and P [Pa]."""
    kappa, kPa = (1 - CREPT) * x / 2.5e-3, P / 1e3
    return (244.7 - 0.1115 * kPa) * exp(-0.334 * kappa) - 0.0830 * kappa * kPa + 2.650 * kPa - 249.4


def stiffness(x, P):
    """Minus its slope [N/m]."""
    kappa, kPa = (1 - CREPT) * x / 2.5e-3, P / 1e3
    return (1 - CREPT) * (0.334 * (244.7 - 0.1115 * kPa) * exp(-0.334 * kappa) + 0.0830 * kPa) / 2.5e-3


def reaches(amplitude):
    """What each of the muscle's stops comes to in a loop of +- amplitude [m], and how far it then slides [m]."""
    return [(w, min(1.0, max(amplitude / r - 1, 0.0)), max(amplitude - r, 0.0)) for w, r in STOPS]


STOPS = ((0.2, 0.2e-3), (0.3, 0.8e-3), (0.3, 2.5e-3), (0.2, 8e-3))
TRUTH = {
    "F": lambda pressure, contraction: force(contraction, pressure),
    "K": lambda pressure, contraction: stiffness(contraction, pressure),
    "H": lambda pressure, amplitude: 2 * (5 + 5e-5 * pressure) * sum(w * share for w, share, _ in reaches(amplitude)),
    "W": lambda pressure, amplitude: 4 * (5 + 5e-5 * pressure) * sum(w * way for w, _, way in reaches(amplitude)),
}
"""Of the settled muscle, from its printed constants [SI]."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    out = tmp_path_factory.mktemp("campaign") / "runs"
    for protocol in PROTOCOLS:
        prepared = prepare(protocol, "mock-real-actuator", "dmsp-20-250-real", [])
        outcome = run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=out)
        assert outcome.status == "finished", outcome.why
    return sorted(str(path) for path in out.iterdir())


def process(*arguments):
    return CliRunner().invoke(main, ["process", *arguments])


@pytest.fixture(scope="module")
def together(runs):
    """What `process` makes of all runs."""
    result = process(*runs, "--form", "surface", "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_a_campaign_becomes_one_muscle(runs, together):
    (analysis,) = together["analyses"]
    assert analysis["runs"] == [Path(run).name for run in runs]
    points = {
        symbol: [e for e in analysis["estimates"] if e["symbol"] == symbol and e["value"] is not None]
        for symbol in "FK"
    }
    assert len(points["F"]) >= 12
    assert len(points["K"]) >= 10
    for symbol, truth in (("F", force), ("K", stiffness)):
        inside = 0
        for e in points[symbol]:
            true = truth(e["at"]["contraction"], e["at"]["pressure"])
            inside += e["ci95"][0] <= true <= e["ci95"][1]
            assert abs(e["value"] - true) <= 2 * (e["ci95"][1] - e["value"]), "off by more than twice its half width"
        assert inside >= 0.9 * len(points[symbol])
    assert analysis["facts"]["straight_form_rms"] > 3 * analysis["facts"]["held_out_rms"]
    said = " ".join(finding["text"] for finding in analysis["findings"])
    assert "trials that were left out are predicted to" in said
    assert "by straight lines over contraction to" in said
    (folder,) = together["folders"]
    assert Path(folder).parent.name == f"{Path(runs[0]).name}-surface"
    page = Path(folder).parent / "page.html"
    shown = CliRunner().invoke(main, ["report", folder, "-o", str(page)])
    assert shown.exit_code == 0, shown.output
    assert "Muscle as a surface" in page.read_text()


def test_what_the_scales_may_be_off_is_in_the_intervals(runs, together):
    """By the closed form: gain and zero of the force cell, and the place and the pressure for which a value is given."""
    (analysis,) = together["analyses"]
    channels = open_run(Path(runs[0])).channels
    compared = 0
    for symbol, of, power in (("F", force, 0), ("K", stiffness, -1)):
        for e in analysis["estimates"]:
            if e["symbol"] != symbol or e["value"] is None:
                continue
            x, P = e["at"]["contraction"], e["at"]["pressure"]
            over_x = (of(x + 1e-5, P) - of(x - 1e-5, P)) / 2e-5
            over_P = (of(x, P + 100) - of(x, P - 100)) / 200
            gains = {"force": of(x, P), "displacement": over_x * x + power * of(x, P), "pressure": over_P * P}
            offsets = {"force": 1.0 if symbol == "F" else 0.0, "displacement": over_x, "pressure": over_P}
            terms = [channels[name].gain_uncertainty * by for name, by in gains.items()]
            terms += [channels[name].offset_uncertainty * by for name, by in offsets.items()]
            known = 0.1 if symbol == "F" else 0.3  # the bend of a surface at its edge is known less well
            assert e["parts"]["calibration"] == pytest.approx(hypot(*terms), rel=known), e["at"]
            compared += 1
    assert compared > 20


def test_a_long_hold_shows_the_creep_and_the_stiffness_at_full_length(runs, tmp_path):
    """c_x: 0.4 % of the contraction with each time constant, between 1 and 30 s; K at no contraction and 500 kPa."""
    prepared = prepare("real-muscle-holds", "mock-real-actuator", "dmsp-20-250-real", [])
    outcome = run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path / "holds")
    result = process(*runs, str(outcome.folder), "--form", "surface", "--json", "--out", str(tmp_path / "found"))
    assert result.exit_code == 0, result.output
    (analysis,) = json.loads(result.stdout)["analyses"]
    (creep,) = [e for e in analysis["estimates"] if e["symbol"] == "c_x"]
    true = sum(0.004 * (exp(-1 / T) - exp(-30 / T)) for T in (0.5, 1.58, 5.0, 15.8, 50.0, 158.0)) / log10(30)
    assert creep["ci95"][0] <= true <= creep["ci95"][1]
    assert creep["ci95"][1] - creep["ci95"][0] < 0.4 * true
    K = [e for e in analysis["estimates"] if e["symbol"] == "K"]
    assert all(e["value"] is not None for e in K)
    for e in K:
        at = e["at"]
        assert e["ci95"][0] <= stiffness(at["contraction"], at["pressure"]) <= e["ci95"][1]


@pytest.mark.study
@pytest.mark.parametrize("first_cycle", [0.3, 0.6, 1.0])
def test_a_rested_muscle_whose_first_loops_are_wider(tmp_path, first_cycle):
    """No term of the surface is meant for it: intervals widen or values go, and none is off by more than its own."""
    protocols = (*PROTOCOLS, "real-muscle-holds")
    runs = [str(ran(tmp_path / "runs", one, "mock-real-actuator", [], first_cycle=first_cycle)) for one in protocols]
    result = process(*runs, "--form", "surface", "--json", "--out", str(tmp_path / "found"))
    assert result.exit_code == 0, result.output
    (analysis,) = json.loads(result.stdout)["analyses"]
    seen = 0
    for e in analysis["estimates"]:
        if e["value"] is not None and e["symbol"] in TRUTH:
            low, high = e["ci95"]
            assert low <= TRUTH[e["symbol"]](**e["at"]) <= high, (e["symbol"], e["at"])
            seen += 1
    assert seen >= 40


def test_what_it_does_not_take_is_refused_with_the_reason(runs):
    both = process(*runs, "--form", "surface", "--regulator")
    assert both.exit_code == 2
    assert "and no other option" in both.output
    unknown = process(*runs, "--form", "surfaces")
    assert unknown.exit_code == 2
    assert "did you mean" in unknown.output
    folder = process(str(Path(runs[0]).parent), "--form", "surface")
    assert folder.exit_code == 2
    assert "name run folders" in folder.output
