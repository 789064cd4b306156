"""K_u and T_u from a campaign of contractions against the phase equation of the simulated muscle's own coefficients."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq

from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.reduce import reduce_runs
from pmabench.kinds.ultimate_gain.model_gain import by_model, kink
from pmabench.store.analyses.results import Analysis
from pmabench.store.reader import open_run
from tests.analysis.test_open_loop import paper0
from tests.analysis.test_ultimate_gain import theory

KIND = "contraction-relaxation"
SETTINGS = (
    ("sweep.matrix.load", "[6 kg, 21 kg]"),
    ("sweep.matrix.pressure", "[250 kPa, 300 kPa, 350 kPa, 400 kPa, 450 kPa]"),
    ("sweep.repeat", "{count: 1}"),
    ("trial.contract.hold", "4 s"),
    ("trial.relax", "{by: 100 kPa, hold: 2 s, then: 0 kPa, hold_at_end: 3 s}"),
    ("prepare.precondition.cycles", "0"),
)


def recorded(out: Path, **options: object) -> Path:
    prepared = prepare(KIND, "mock", "mas-20-250-paper0", list(SETTINGS))
    devices = tuple(replace(d, options={**d.options, **options}) for d in prepared.mounted.bench.devices)
    mounted = replace(prepared.mounted, bench=replace(prepared.mounted.bench, devices=devices))
    outcome = run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=out)
    assert outcome.folder is not None, outcome.why
    return outcome.folder


def reduced(folder: Path) -> Analysis:
    (analysis,) = reduce_runs([open_run(folder)], {KIND: {"regulator": True}})
    return analysis


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def analysis(campaign: Path) -> Analysis:
    return reduced(campaign)


def true(x: float, load: float, mass: float, lag: float) -> dict[str, float]:
    """K_u [Pa/m] and T_u [s] of plant 5.1 with dead time 40 ms, half a sample more, and the mean of both dampings."""
    P = float(brentq(lambda p: paper0(p)[0] - load - paper0(p)[1] * x, 5e4, 6e5))
    _, K, B_c, B_r = paper0(P)
    F_slope, K_slope = ((paper0(P + 50)[i] - paper0(P - 50)[i]) / 100 for i in (0, 1))
    B = (B_c + B_r) / 2
    root = (B * B - 4 * mass * K) ** 0.5
    K_u, T_u = theory((F_slope - K_slope * x) / K, 0.041, lag, (B + root) / (2 * K), (B - root) / (2 * K))
    return {"K_u": K_u, "T_u": T_u}


def held(found: Analysis, lag: float, mass: float) -> None:
    assert {e.symbol for e in found.estimates} == {"K_u", "T_u"}
    for e in found.estimates:
        expected = true(e.at["setpoint"], e.at["load"], mass, lag)[e.symbol]
        assert e.value == pytest.approx(expected, rel=0.02)
        assert e.ci95 is not None
        assert e.ci95[0] < expected < e.ci95[1]


@pytest.mark.parametrize("kg", [0.0, 6.0])
def test_the_loop_of_the_bench_comes_back_within_two_percent(analysis: Analysis, kg: float) -> None:
    held(by_model(analysis, [38e-3, 44e-3], kg * 9.80665, kg, 0.002), 0.0955, kg)


def test_without_set_points_it_is_reported_at_the_rests_of_the_campaign(analysis: Analysis) -> None:
    """x = (F_ce - F_L) / K at the inner pressures, as 1.08 * 300 - 49 - 58.84 N over 6.773 N/mm."""
    found = by_model(analysis, [], 58.84, 6.0, 0.002)
    rests = sorted({e.at["setpoint"] for e in found.estimates})
    expected = [(paper0(P)[0] - 58.84) / paper0(P)[1] for P in (300e3, 350e3, 400e3)]
    assert rests == pytest.approx(expected, rel=0.01)
    held(found, 0.0955, 6.0)


def test_a_plant_without_friction_and_lag_has_no_doubt(tmp_path: Path) -> None:
    found = by_model(reduced(recorded(tmp_path, friction=0, regulator_lag=0.05)), [40e-3], 0.0, 0.0, 0.002)
    held(found, 0.05, 0.0)
    assert not [f for f in found.findings if f.level == "doubt"]


def test_friction_is_reported_as_a_doubt(analysis: Analysis) -> None:
    (doubt,) = (f.text for f in by_model(analysis, [40e-3], 0.0, 0.0, 0.0).findings if f.level == "doubt")
    assert "dry friction of 6" in doubt or "dry friction of 5.9" in doubt


def test_wider_intervals_of_coefficients_make_wider_ones_of_the_loop(analysis: Analysis) -> None:
    """dK_u/K_u = -dk_g/k_g: F_ce with independent repeats of 5 N, 50 kPa apart, makes k_g = 0.8 N/kPa over K uncertain by 9 %."""

    def wider(symbol: str, half: float) -> float:
        estimates = tuple(
            replace(e, parts=replace(e.parts, repeats=half)) if e.symbol == symbol and e.at else e
            for e in analysis.estimates
        )
        K_u = by_model(replace(analysis, estimates=estimates), [40e-3], 0.0, 0.0, 0.0).estimates[0]
        assert K_u.value
        assert K_u.parts.repeats is not None
        return K_u.parts.repeats / K_u.value

    assert wider("F_ce", 5.0) == pytest.approx(5.0 * 2**0.5 / 100 / 0.8, rel=0.3)
    assert wider("F_ce", 10.0) == pytest.approx(2 * wider("F_ce", 5.0), rel=0.05)


GRID = [P * 1e3 for P in range(150, 501, 50)]


@pytest.mark.parametrize(("P", "slope"), [(300e3, -32.1), (320e3, 17.9), (325e3, 17.9), (350e3, 17.9)])
def test_a_kink_bounds_what_the_slope_is_off(P: float, slope: float) -> None:
    """K of Serres and others: 32.7 - 0.0321 P up to 314 kPa, 17 + 0.0179 P above [N/mm, kPa]."""
    points = [(at, 32.7e3 - 32.1e-3 * at if at <= 314e3 else 17e3 + 17.9e-3 * at) for at in GRID]
    high, low = np.interp([P + 25e3, P - 25e3], *np.array(points).T)
    taken = (high - low) / 50e3
    assert abs(taken - slope * 1e-3) > 5e-3
    assert abs(taken - slope * 1e-3) <= kink(points, P) * (1 + 1e-9) < 0.05


@pytest.mark.parametrize("P", [200e3, 215e3, 225e3, 350e3, 450e3])
def test_a_parabola_has_no_kink_and_a_line_with_one_none_elsewhere(P: float) -> None:
    assert kink([(at, 5600 + 1e-3 * at + 9.7e-9 * at * at) for at in GRID], P) == pytest.approx(0.0, abs=1e-9)
    if P <= 215e3 or P == 450e3:
        points = [(at, 32.7e3 - 32.1e-3 * at if at <= 314e3 else 17e3 + 17.9e-3 * at) for at in GRID]
        assert kink(points, P) == pytest.approx(0.0, abs=1e-9)


def test_a_kink_is_reported_and_in_the_interval(analysis: Analysis) -> None:
    """K falls by 10 N/mm per MPa up to 350 kPa and rises as much above: the slope at 350 kPa is either."""
    smooth = by_model(analysis, [38e-3], 0.0, 0.0, 0.0)
    bent = tuple(
        replace(e, value=7000.0 + 0.01 * abs(e.at["pressure"] - 350e3)) if e.symbol == "K" and e.at else e
        for e in analysis.estimates
    )
    found = by_model(replace(analysis, estimates=bent), [46e-3], 0.0, 0.0, 0.0)
    assert any("has a kink about" in f.text for f in found.findings)
    assert not any("has a kink about" in f.text for f in smooth.findings)
    shares = [a.estimates[0].parts.method / a.estimates[0].value for a in (smooth, found)]  # type: ignore[operator]
    assert shares[1] > 3 * shares[0]


def refused(analysis: Analysis, *setpoints: float) -> str:
    with pytest.raises(ValueError, match=r".") as error:
        by_model(analysis, setpoints, 0.0, 0.0, 0.0)
    return str(error.value)


def test_what_the_campaign_does_not_show_is_refused_with_the_reason(analysis: Analysis, campaign: Path) -> None:
    assert "no pressure from 250 to 450 kPa holds 200 mm under 0 N" in refused(analysis, 0.2)
    (without,) = reduce_runs([open_run(campaign)])
    assert "no dead time and no lag of the regulator; process the runs with --regulator" in refused(without, 40e-3)
    few = tuple(e for e in analysis.estimates if e.at.get("pressure") not in {300e3, 350e3, 400e3})
    assert "known at 2 pressures together" in refused(replace(analysis, estimates=few), 40e-3)
    bare = tuple(e for e in analysis.estimates if e.symbol != "K")
    assert "gives no K" in refused(replace(analysis, estimates=bare), 40e-3)


def tune(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["tune", *arguments], catch_exceptions=False)
    return result.exit_code, result.output


def test_on_the_command_line(campaign: Path, tmp_path: Path) -> None:
    code, out = tune("--model", str(campaign), "--setpoint", "30 mm", "--load", "6 kg", "--json")
    assert code == 0
    reported = json.loads(out)
    values = {e["symbol"]: e["value"] for e in reported["ultimate"]}
    assert values == pytest.approx(true(30e-3, 6 * 9.80665, 6.0, 0.0955), rel=0.02)
    assert {"SIMC PI", "Ziegler-Nichols PID"} <= {s["rule"] for s in reported["settings"]}
    # an analysis folder gives the same, with the sample period told
    made = CliRunner().invoke(main, ["process", str(campaign), "--regulator", "--out", str(tmp_path), "-q"])
    assert made.exit_code == 0, made.output
    again = ("--analysis", str(tmp_path / KIND), "--setpoint", "30 mm", "--load", "6 kg", "--period", "2 ms", "--json")
    code, out = tune(*again)
    assert code == 0
    assert {e["symbol"]: e["value"] for e in json.loads(out)["ultimate"]} == pytest.approx(values, rel=1e-9)


def test_what_was_typed_wrong_is_reported(campaign: Path) -> None:
    run = str(campaign)
    for arguments, words in (
        (("--model",), "--model takes runs and nothing else"),
        (("--model", "--steps", run), "--steps takes runs and nothing else"),
        (("--model", run, "--ku", "5", "--tu", "3 s"), "--model takes runs and nothing else"),
        (("--model", run, "--setpoint", "20 N"), "--setpoint"),
        (("--model", run, "--load", "6 mm"), "neither a mass nor a force"),
        (("--model", run, "--load", "-6 kg"), "no load of a muscle"),
        (("--ku", "5", "--tu", "3 s", "--setpoint", "30 mm"), "--setpoint, --load and --period are for --model"),
    ):
        code, out = tune(*arguments)
        assert (code, words in out) == (2, True), out
    code, out = tune("--steps", run)
    assert code == 3
    assert "there is --model" in out
