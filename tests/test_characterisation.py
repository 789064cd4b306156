"""The claims, end to end: protocol file, plan, engine, run folder, reduction, against the truth of the simulated muscle.

Truth: reference plants 5.1 (paper0) and 5.2 (serres2009), in kPa, N, N/mm, N.s/mm; written out here, not imported.
"""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.reader import open_run

PRESSURES = [150, 200, 250, 300, 350, 400, 450, 500]
TRUTH = {
    "paper0": {
        "F_ce": lambda P: 1.08 * P - 49.0,
        "K": lambda P: 5.6 + 1.0e-3 * P + 9.7e-6 * P * P,
        "B_c": lambda P: 1.2 + 1.6e-3 * P,
        "B_r": lambda P: 1.1 + 3.4e-3 * P,
    },
    "serres2009": {
        "F_ce": lambda P: 2.91 * P + 44.6,
        "K": lambda P: 32.7 - 0.0321 * P if P <= 314 else 17 + 0.0179 * P,
        "B_c": lambda P: 2.90,
        "B_r": lambda P: 1.57 if P <= 372 else 0.311 + 0.00338 * P,
    },
}
SI = {"F_ce": 1.0, "K": 1e3, "B_c": 1e3, "B_r": 1e3}


def analysed(folder, protocol, bench, specimen="mas-20-250-paper0", settings=(), **options):
    """Run a shipped protocol on a shipped bench and reduce the run."""
    prepared = prepare(protocol, bench, specimen, settings)
    mounted = prepared.mounted
    devices = tuple(replace(d, options={**d.options, **options}) for d in mounted.bench.devices)
    mounted = replace(mounted, bench=replace(mounted.bench, devices=devices))
    outcome = run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=Path(folder))
    assert outcome.status == "finished", outcome.why
    (analysis,) = reduce_runs([open_run(outcome.folder)])
    return analysis


def value_at(analysis, symbol, pressure, method="measured-pressure"):
    for e in analysis.estimates:
        if (e.symbol, e.method, e.coordinate) == (symbol, method, "") and e.at == {"pressure": pressure * 1e3}:
            return e
    raise AssertionError(f"no {symbol} at {pressure} kPa")


def line(analysis, symbol, method="measured-pressure"):
    curve = next(c for c in analysis.curves if (c.symbol, c.form, c.method) == (symbol, "line", method))
    return [term.value for term in curve.terms]


def assert_within(analysis, plant, symbol, relative, whole=None):
    """Each identified value within `relative` of the truth (of `whole`, where given); at least six pressures."""
    identified = 0
    for P in PRESSURES:
        e = value_at(analysis, symbol, P)
        if e.value is None:
            assert "not identifiable" in e.note
            continue
        identified += 1
        true = TRUTH[plant][symbol](P) * SI[symbol]
        assert abs(e.value - true) <= relative * (whole or true), f"{symbol} at {P} kPa: {e.value} for {true}"
        assert e.ci95 is not None
        assert e.ci95[1] - e.ci95[0] < 0.2 * true, "an interval that says nothing"
    assert identified >= 6


@pytest.fixture(scope="module")
def ideal(tmp_path_factory):
    return analysed(
        tmp_path_factory.mktemp("ideal"), "contraction-relaxation", "mock-ideal", settings=[("sweep.repeat.count", "1")]
    )


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return analysed(
        tmp_path_factory.mktemp("bench"), "contraction-relaxation", "mock", settings=[("sweep.repeat.count", "1")]
    )


@pytest.mark.slow
def test_a_regulator_that_has_to_move_air_does_not_bias_what_is_fitted_with_the_measured_pressure(tmp_path):
    """Second order and chamber: the coefficients of `mock`, in the tolerances of `mock`."""
    found = analysed(tmp_path, "contraction-relaxation", "mock-air", settings=[("sweep.repeat.count", "1")])
    assert_within(found, "paper0", "K", 0.01)
    assert_within(found, "paper0", "B_c", 0.02)
    assert_within(found, "paper0", "B_r", 0.02)
    assert_within(found, "paper0", "F_ce", 0.02, whole=491.0)
    assert found.facts["cells_used"] in {42, 43}
    friction = [e for e in found.estimates if e.symbol == "F_c" and e.method == "measured-pressure"]
    assert friction[0].value == pytest.approx(6.0, rel=0.05)


@pytest.mark.slow
def test_ideal_returns_the_truth(ideal):
    assert_within(ideal, "paper0", "K", 0.005)
    assert_within(ideal, "paper0", "B_c", 0.01)
    assert_within(ideal, "paper0", "B_r", 0.01)
    intercept, slope = line(ideal, "F_ce")
    assert slope * 1e3 == pytest.approx(1.08, rel=0.01)
    assert intercept == pytest.approx(-49.0, abs=1.0)


@pytest.mark.slow
def test_dead_time_is_40_ms_on_ideal(ideal):
    found = [
        e.value
        for e in ideal.estimates
        if e.symbol == "t_d" and "command-to-motion" in (e.coordinate, *e.method.split())
    ]
    assert found
    for value in found:
        assert value == pytest.approx(0.040, abs=0.002)


@pytest.mark.slow
def test_44_of_88_cells_are_used_on_ideal_and_each_other_one_has_its_reason(ideal):
    assert len(ideal.dropped) == 44
    assert all(d.reason for d in ideal.dropped)
    assert ideal.facts["cells_used"] == 44


@pytest.mark.slow
def test_bench_is_within_its_tolerances(bench):
    assert_within(bench, "paper0", "K", 0.01)
    assert_within(bench, "paper0", "B_c", 0.02)
    assert_within(bench, "paper0", "B_r", 0.02)
    assert_within(bench, "paper0", "F_ce", 0.02, whole=491.0)
    assert bench.facts["cells_used"] in {42, 43}
    assert len(bench.dropped) == 88 - bench.facts["cells_used"]
    assert any("step-exponential against measured-pressure" in f.text for f in bench.findings)


@pytest.mark.slow
def test_serres2009_is_within_its_tolerances(tmp_path):
    found = analysed(
        tmp_path, "contraction-relaxation", "mock-serres2009", "mas-20-250-serres2009",
        [("sweep.repeat.count", "1"), ("sweep.matrix.load", "[6 kg, 16 kg, 26 kg, 36 kg, 46 kg, 56 kg]")],
    )  # fmt: skip
    assert_within(found, "serres2009", "K", 0.01)
    assert_within(found, "serres2009", "B_c", 0.02)
    assert_within(found, "serres2009", "B_r", 0.10)
    assert_within(found, "serres2009", "F_ce", 0.02, whole=2.91 * 500 + 44.6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mock-ideal", "mock"])
def test_static_load_gives_the_line_from_both_sides(tmp_path, name):
    found = analysed(tmp_path, "static-load", name, settings=[("sweep.repeat.count", "1")])
    intercept, slope = line(found, "F_ce", "static-mean")
    for P in PRESSURES:
        true = 1.08 * P - 49
        assert abs(intercept + slope * P * 1e3 - true) <= 0.01 * true + (2.5 if name == "mock" else 1.0)
    if name == "mock":
        half = next(e for e in found.estimates if e.symbol == "F_f" and not e.at)
        assert 6.0 <= half.value <= 10.0
        assert {"static-lift", "static-set-down"} <= {e.method for e in found.estimates}, (
            "one-sided values stand beside"
        )


@pytest.mark.slow
def test_paper_0s_own_order_finds_the_set_down_only(tmp_path):
    found = analysed(
        tmp_path, "static-load-hands-at-pressure", "mock-hands-at-pressure", settings=[("sweep.repeat.count", "1")]
    )
    assert found.estimates
    assert any("one direction only" in f.text for f in found.findings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "K_off", "B_off", "F_c"), [("mock-actuator-ideal", 0.005, 0.02, 0.0), ("mock-actuator", 0.01, 0.05, 6.0)]
)
def test_sines_give_stiffness_damping_and_friction(tmp_path, name, K_off, B_off, F_c):
    found = analysed(tmp_path, "sinusoidal-displacement", name, settings=[("sweep.repeat.count", "1")])

    def pooled(symbol, method):
        return next(
            e.value for e in found.estimates if (e.symbol, e.method) == (symbol, method) and "frequency" not in e.at
        )

    B = (TRUTH["paper0"]["B_c"](300) + TRUTH["paper0"]["B_r"](300)) / 2 * 1e3
    assert pooled("K", "sine-harmonic") == pytest.approx(TRUTH["paper0"]["K"](300) * 1e3, rel=K_off)
    assert pooled("B", "sine-harmonic") == pytest.approx(B, rel=B_off)
    assert pooled("F_c", "sine-harmonic") == pytest.approx(F_c, abs=0.6)
    width = next(e.value for e in found.estimates if e.symbol == "H" and e.at["frequency"] == 0)
    assert width == pytest.approx(2 * F_c, abs=1.0)
    if F_c == 0:
        for e in found.estimates:
            if e.symbol == "W":
                closed = math.pi * B * 2 * math.pi * e.at["frequency"] * 0.005**2
                assert e.value == pytest.approx(closed, rel=0.01)


def ultimate(L, lag, tau, k_g):
    """K_u, T_u of omega L + sum atan(omega T_i) = pi, by bisection."""
    low, high = 1.0, 60.0
    for _ in range(80):
        mid = (low + high) / 2
        low, high = (mid, high) if mid * L + math.atan(mid * lag) + math.atan(mid * tau) < math.pi else (low, mid)
    return math.hypot(1, low * lag) * math.hypot(1, low * tau) / k_g, 2 * math.pi / low


@pytest.mark.slow
@pytest.mark.parametrize(("lag", "K_u", "T_u"), [(0.0955, 59.9, 0.355), (0.22, 78.7, 0.451)])
def test_ultimate_gain_agrees_with_the_equation(tmp_path, lag, K_u, T_u):
    k_g = 0.1466e-6
    printed = ultimate(0.043, lag, 0.247, k_g)
    assert printed == pytest.approx((K_u * 1e6, T_u), rel=0.003), "not the equation of the digest's table 5.4"
    gain, period = ultimate(0.040 + 0.002 / 2, lag, 0.247, k_g)
    found = analysed(
        tmp_path, "ultimate-gain", "mock-linear", regulator_lag=lag,
        settings=[("sweep.repeat.count", "1"), ("trial.gain_steps.start", f"{0.8 * K_u:.3g} kPa/mm")],
    )  # fmt: skip
    values = {e.symbol: e.value for e in found.estimates}
    assert values["K_u"] == pytest.approx(gain, rel=0.05)
    assert values["T_u"] == pytest.approx(period, rel=0.03)
    rules = {row["rule"]: row["gains"] for row in found.facts["tuning"]}
    assert rules["Ziegler-Nichols PI"]["K_p"]["value"] == pytest.approx(0.45 * values["K_u"])


@pytest.mark.slow
def test_a_limit_cycle_by_stiction_is_not_called_ultimate(tmp_path):
    found = analysed(tmp_path, "ultimate-gain", "mock", settings=[("sweep.repeat.count", "1")])
    assert all(e.value is None for e in found.estimates if e.symbol in {"K_u", "T_u"})
    assert any("limit cycle" in f.text for f in found.findings)


def test_a_single_trial_shows_nothing_that_it_cannot_know(tmp_path):
    one = [("sweep.matrix.load", "[6 kg]"), ("sweep.matrix.pressure", "[300 kPa]"), ("sweep.repeat.count", "1")]
    found = analysed(tmp_path, "contraction-relaxation", "mock", settings=one)
    K, F_ce = value_at(found, "K", 300), value_at(found, "F_ce", 300)
    if K.value is None:
        assert F_ce.value is None
        assert F_ce.note.startswith("not identifiable")
    else:
        assert K.ci95[0] <= 6773 <= K.ci95[1]
        assert F_ce.ci95[0] <= 275 <= F_ce.ci95[1]
