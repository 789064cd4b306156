"""Positioning and validation compile: gains from every source, the model carried by the plan, faults with their places."""

from __future__ import annotations

import json
from math import atan, pi, prod, sqrt
from pathlib import Path

import pytest
from scipy.optimize import brentq

from pmabench.base.errors import InvalidFile
from pmabench.protocol.plan import Plan, Seek, Set
from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis, Estimate
from tests.protocol.test_compile import plan

GAINS = "controller.gains"


def loops(compiled: Plan) -> list[Seek]:
    return [step for step in compiled.steps if isinstance(step, Seek)]


def refused(*settings: tuple[str, str], protocol: str = "positioning-pi") -> str:
    with pytest.raises(InvalidFile) as caught:
        plan(protocol, *settings)
    return str(caught.value)


def ultimate(folder: Path, *points: tuple[float, float, float], kind: str = "ultimate-gain") -> Path:
    """An analysis folder with K_u [Pa/m] and T_u [s] at set-points [m]."""
    estimates = [
        Estimate(symbol, value, unit, quantity, "gain-steps", {"setpoint": x, "load": 0.0})
        for x, K_u, T_u in points
        for symbol, value, unit, quantity in (("K_u", K_u, "Pa/m", "gain"), ("T_u", T_u, "s", "time"))
    ]
    return write_analysis(Analysis(kind, ("r",), True, tuple(estimates)), folder)


def test_eleven_set_points_as_in_paper_0_each_from_rest():
    compiled = plan("positioning-pi")
    assert [seek.parameters["setpoint"] for seek in loops(compiled)] == pytest.approx(
        [i / 1e3 for i in range(10, 61, 5)]
    )
    assert {(seek.low, seek.high, seek.parameters["start"]) for seek in loops(compiled)} == {(0.0, 6e5, 0.0)}
    after = [compiled.steps[i + 2] for i, step in enumerate(compiled.steps) if isinstance(step, Seek)]
    assert all(isinstance(step, Set) and step.value == 0.0 for step in after)
    assert json.loads(compiled.to_json())["settings"]["model"]["friction"]["F_s"] == 10.0


def test_the_table_of_paper_0_makes_its_gains_and_never_the_printed_slips():
    """0.45 x 7.1 bar/cm = 31.95 kPa/mm and 9 s / 1.2 = 7.5 s; printed are 2.195 and 3."""
    for form, gains in (
        ("P", {"K_p": 35.5e6}),
        ("PI", {"K_p": 31.95e6, "T_i": 7.5}),
        ("PID", {"K_p": 42.6e6, "T_i": 4.5, "T_d": 1.125}),
    ):
        compiled = plan("positioning-pi", ("controller.form", form), (GAINS, "{K_u: 7.1 bar/cm, T_u: 9 s}"))
        for seek in loops(compiled):
            assert {name: seek.parameters[name] for name in gains} == pytest.approx(gains)
            assert not {"K_p", "T_i", "T_d"} & (set(seek.parameters) - set(gains))
            assert seek.parameters["K_p"] != pytest.approx(21.95e6)
            assert seek.parameters.get("T_i") != pytest.approx(3.0)


def test_a_schedule_is_joined_by_straight_lines():
    rows = "[{setpoint: 10 mm, K_p: 20 kPa/mm, T_i: 0.2 s}, {setpoint: 60 mm, K_p: 70 kPa/mm, T_i: 0.3 s}]"
    found = loops(plan("positioning-pi", (GAINS, rows)))
    assert [seek.parameters["K_p"] / 1e6 for seek in found] == pytest.approx([20 + 5 * i for i in range(11)])
    assert [seek.parameters["T_i"] for seek in found] == pytest.approx([0.2 + 0.01 * i for i in range(11)])


def test_gains_of_an_analysis_are_scheduled_over_its_set_points(tmp_path):
    folder = ultimate(tmp_path / "ultimate-gain", (0.01, 40e6, 0.36), (0.06, 200e6, 0.36))
    found = loops(plan("positioning-pi", (GAINS, str(tmp_path))))  # the folder around it is as good
    assert found[0].parameters["K_p"] == pytest.approx(18e6)
    assert found[-1].parameters["K_p"] == pytest.approx(90e6)
    assert found[5].parameters["K_p"] == pytest.approx(54e6)
    assert found[5].parameters["T_i"] == pytest.approx(0.3)
    other = plan("positioning-pi", (GAINS, str(folder)), ("controller.rule", "Tyreus-Luyben"))
    assert loops(other)[0].parameters["K_p"] == pytest.approx(12.5e6)


def test_gains_of_one_set_point_are_used_at_all(tmp_path):
    folder = ultimate(tmp_path, (0.03, 60e6, 0.36))
    compiled = plan("positioning-pi", (GAINS, str(folder)))
    assert {seek.parameters["K_p"] for seek in loops(compiled)} == {27e6}


SIMC = ("controller.rule", "SIMC")


def theory(x: float, load: float, mass: float) -> tuple[float, float, list[float]]:
    """k_g [m/Pa], dead time [s] and lags [s] of plant 5.1 at x [m], behind 40 ms, 95.5 ms and half a sample."""
    P = brentq(lambda p: 1.08e-3 * p - 49 - load - (5600 + 1e-3 * p + 9.7e-9 * p * p) * x, 5e4, 6e5)
    K, B = 5600 + 1e-3 * P + 9.7e-9 * P * P, 0.5 * (1200 + 1.6e-3 * P + 1100 + 3.4e-3 * P)
    root = (B * B - 4 * mass * K) ** 0.5
    lags = [(B + root) / (2 * K), 0.0955, (B - root) / (2 * K)]
    return (1.08e-3 - (1e-3 + 2 * 9.7e-9 * P) * x) / K, 0.041, sorted(lags, reverse=True)


def skogestad_pi(k_g: float, theta: float, lags: list[float]) -> tuple[float, float]:
    """The half rule and SIMC's PI settings with tau_c = theta (Skogestad 2003, equations 10, 23 and 24)."""
    first, second, *rest = lags
    tau, theta = first + second / 2, theta + second / 2 + sum(rest)
    return tau / (2 * k_g * theta), min(tau, 8 * theta)


def test_simc_takes_its_settings_from_the_model_of_the_plan_at_each_set_point():
    model = ("model", "{coefficients: paper0 ideal, regulator: {dead_time: 40 ms, lag: 95.5 ms}}")
    seeks = loops(plan("positioning-pi", model, (GAINS, "model"), SIMC))
    assert len(seeks) == 11
    for seek in seeks:
        K_p, T_i = skogestad_pi(*theory(seek.parameters["setpoint"], 0.0, 2.0))
        assert (seek.parameters["K_p"], seek.parameters["T_i"]) == pytest.approx((K_p, T_i), rel=1e-3)
    assert seeks[-1].parameters["K_p"] > 2 * seeks[0].parameters["K_p"]


def test_other_rules_take_k_u_and_t_u_of_the_model():
    model = ("model", "{coefficients: paper0 ideal, regulator: {dead_time: 40 ms, lag: 95.5 ms}}")
    for seek in loops(plan("positioning-pi", model, (GAINS, "model"))):
        k_g, dead, lags = theory(seek.parameters["setpoint"], 0.0, 2.0)
        w = brentq(lambda w: w * dead + sum(atan(w * T) for T in lags) - pi, 1.0, 100.0)  # noqa: B023
        K_u = prod(sqrt(1 + (w * T) ** 2) for T in lags) / k_g
        assert seek.parameters["K_p"] == pytest.approx(0.45 * K_u, rel=1e-3)
        assert seek.parameters["T_i"] == pytest.approx(2 * pi / w / 1.2, rel=1e-3)


def test_simc_of_an_analysis_takes_its_loop(tmp_path):
    k_g, dead, lags = 2e-7, 0.041, [0.27, 0.095]
    folder = ultimate(tmp_path / "u", (0.03, 60e6, 0.36))
    assert "SIMC needs the dead time and the lags" in refused((GAINS, str(folder)), SIMC)
    reported = json.loads((folder / "analysis.json").read_text())
    reported["facts"]["loops"] = [{"at": {"setpoint": 0.03, "load": 0.0}, "gain": k_g, "dead_time": dead, "lags": lags}]
    (folder / "analysis.json").write_text(json.dumps(reported))
    (one, *_) = loops(plan("positioning-pi", (GAINS, str(folder)), SIMC))
    assert (one.parameters["K_p"], one.parameters["T_i"]) == pytest.approx(skogestad_pi(k_g, dead, lags))


@pytest.mark.parametrize(
    ("settings", "reported"),
    [
        ([SIMC], "these gains are taken as they stand"),
        ([SIMC, (GAINS, "{K_u: 60 kPa/mm, T_u: 0.35 s}")], "SIMC needs the dead time and the lags of the loop"),
        ([SIMC, (GAINS, "model"), ("controller.form", "P")], "SIMC has no rule for a P controller"),
        ([(GAINS, "model"), ("model", "{coefficients: specimen}")], "tells no dead time and no lag of the regulator"),
        ([(GAINS, "model"), ("model", "{coefficients: paper0-air bench}")], "makes no loop of lags alone"),
        ([(GAINS, "model"), ("controller.output", "[0 kPa, 200 kPa]")], "no pressure from 0 to 200 kPa holds 30 mm under 0 N"),
    ],
)  # fmt: skip
def test_what_a_rule_needs_and_is_not_known_is_reported(settings, reported):
    message = refused(*settings)
    assert reported in message
    assert "--set" in message or ".yaml:" in message


@pytest.mark.parametrize(
    ("setting", "reported"),
    [
        ((GAINS, "{K_p: 0 kPa/mm, T_i: 1 s}"), "must be above zero"),
        ((GAINS, "{K_p: 20 kPa/mm}"), "a PI controller needs T_i"),
        ((GAINS, "{K_p: 20 kPa/mm, T_i: 1 s, T_d: 1 s}"), "a PI controller has no T_d"),
        ((GAINS, "{K_p: 20 kPa, T_i: 1 s}"), "is no unit of gain"),
        ((GAINS, "{K_u: 0 kPa/mm, T_u: 1 s}"), "must be above zero"),
        ((GAINS, "nowhere"), '"nowhere" is no analysis folder'),
        ((GAINS, "[]"), "at least 1"),
        ((GAINS, "[{setpoint: 20 mm, K_p: 2 kPa/mm, T_i: 1 s}, {setpoint: 10 mm, K_p: 2 kPa/mm, T_i: 1 s}]"), "rise"),
        ((GAINS, "[{setpoint: 20 mm, K_p: 2 kPa/mm, T_i: 1 s}, {setpoint: 60 mm, K_p: 2 kPa/mm, T_i: 1 s}]"), "outside the schedule"),
        (("controller.output", "[0 kPa, 601 kPa]"), "above the limit"),
        (("controller.output", "[300 kPa, 300 kPa]"), "must rise"),
        (("controller.filter", "0"), "greater than or equal to 1"),
        (("controller.tracking", "0 s"), "must be above zero"),
        (("controller.anti_windup", "none"), "back-calculation"),
        (("sweep.matrix.setpoint", "[0 mm]"), "must be above zero"),
        (("sweep.matrix.setpoint", "[71 mm]"), "is above the specimen's limit, 70 mm"),
        (("trial.window", "[10 s, 41 s]"), "inside the hold"),
        (("trial.window", "[10 s, 10 s]"), "must rise"),
        (("trial.hold", "0 s"), "must be above zero"),
        (("trial.band", "0 %"), "must be above zero"),
        (("model.coefficients", "nowhere"), "no analysis folder"),
        (("model.coefficients", "paper0 real"), 'no preset "real"'),
        (("model.friction", "{static: 1 N, kinetic: 6 N}"), "F_c <= F_s"),
        (("model.regulator", "{dead_time: 40 ms, dead_band: 1 kPa}"), "dead band"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_place(setting, reported):
    message = refused(setting)
    assert reported in message
    assert "--set" in message or ".yaml:" in message


def test_an_analysis_without_an_ultimate_gain_is_refused(tmp_path):
    folder = ultimate(tmp_path, (0.03, 60e6, 0.36), kind="static-load")
    file = folder / "analysis.json"
    file.write_text(file.read_text().replace('"K_u"', '"F_ce"'))
    assert "is an analysis of kind static-load and gives no K_u, T_u" in refused((GAINS, str(folder)))


def test_a_damaged_analysis_is_refused(tmp_path):
    folder = ultimate(tmp_path, (0.03, 60e6, 0.36))
    (folder / "analysis.json").write_text('{"schema": "pmabench.analysis/1"')
    assert "is not JSON" in refused((GAINS, str(folder)))


# -- the model that a plan carries -------------------------------------------------------------------------------


def fitted(folder: Path, **change: float | None) -> Path:
    """An analysis of contraction and relaxation with two pressures."""
    table = {"F_ce": (167.0, 275.0), "K": (6188.0, 6773.0), "B_c": (1520.0, 1680.0), "B_r": (1780.0, 2120.0)}
    unit = {"F_ce": ("N", "force"), "K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}
    estimates = [
        Estimate(symbol, change.get(symbol, value), *unit[symbol], "measured-pressure", {"pressure": P})
        for symbol, values in table.items()
        for P, value in zip((2e5, 3e5), values, strict=True)
    ]
    estimates += [
        Estimate("F_c", 6.0, "N", "force", "measured-pressure"),
        Estimate("t_d", 0.04, "s", "time", "onset", coordinate="command-to-pressure"),
        Estimate("tau_P", 0.0955, "s", "time", "regulator-response", coordinate="lag"),
        Estimate("K", 1.0, "N/m", "stiffness", "step-exponential", {"pressure": 2e5}),
    ]
    return write_analysis(Analysis("contraction-relaxation", ("r7",), True, tuple(estimates)), folder)


def test_a_fitted_model_is_carried_as_numbers_with_its_source(tmp_path):
    compiled = plan("validation", ("model.coefficients", str(fitted(tmp_path))))
    reported = json.loads(compiled.to_json())["settings"]["model"]
    assert reported["source"] == "analysis of r7"
    assert reported["domain"] == [2e5, 3e5]
    assert reported["friction"] == {"F_s": 6.0, "F_c": 6.0, "speed": 1e-3}
    assert (reported["regulator"]["dead_time"], reported["regulator"]["lag"]) == (0.04, 0.0955)
    from pmabench.model.presets import Described

    muscle = Described.of(reported).muscle
    assert muscle.K(2.5e5) == pytest.approx(6480.5)
    assert muscle.F_ce(2.5e5) == pytest.approx(221.0)
    assert muscle.F_ce(0.0) == 0.0


def test_a_model_that_lacks_a_coefficient_or_cannot_be_is_refused(tmp_path):
    lacking = fitted(tmp_path / "a", K=None)
    assert "gives no K" in refused(("model.coefficients", str(lacking)), protocol="validation")
    negative = fitted(tmp_path / "b", B_c=-1.0)
    assert "B_c of analysis of r7 is not above zero" in refused(
        ("model.coefficients", str(negative)), protocol="validation"
    )


def test_validation_steps_every_50_kpa_from_rest_at_no_load():
    compiled = plan("validation")
    steps = [step for step in compiled.steps if isinstance(step, Set) and step.phase == "step"]
    assert [step.value for step in steps] == [2e5 + 5e4 * i for i in range(7)]
    assert {trial.point["load"] for trial in compiled.trials} == {0.0}
    assert compiled.settings["window"] == [8.0, 10.0]
    assert "must rise" in refused(("trial.window", "[8 s, 11 s]"), protocol="validation")
    assert "above the limit" in refused(("sweep.matrix.pressure.stop", "700 kPa"), protocol="validation")
