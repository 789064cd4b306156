"""Regulators, chamber, friction, loads and compositions of the library against integration, plants and closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lti, step

from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.library import MODELS, OutsideDomain
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.regulator import Regulated, Regulator, constant, sine
from tests.model.hysteresis_path import hysteresis_path


def value(name, output, **given):
    return MODELS[name].evaluate(given)[output]


# -- regulators --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("start", "target"), [(1e5, 4e5), (4e5, 1e5)])
def test_first_order_is_the_regulator_of_the_simulated_bench(start, target):
    t = np.linspace(0, 1, 201)
    supply = Regulated(Regulator(dead_time=0.04, lag=0.1, vent_ratio=1.5), start, 0.0)
    supply.command(constant(0.0, target))
    given = {"start": start, "target": target, "lag": 0.1, "vent_ratio": 1.5, "dead_time": 0.04}
    found = value("regulator-first-order", "pressure", time=t, **given)
    np.testing.assert_allclose(found, supply.values(t)[0], rtol=1e-9)


def test_a_regulator_without_lag_steps_after_its_dead_time():
    found = value("regulator-first-order", "pressure", time=[0.0, 0.03, 0.05], lag=0.0, dead_time=0.04)
    assert found.tolist() == [0, 0, 3e5]


@pytest.mark.parametrize("zeta", [0.05, 0.5, 0.99999, 1.0, 1.00001, 3.0])
def test_second_order_is_the_step_of_its_transfer_function(zeta):
    w = 2 * math.pi * 4
    t = np.linspace(0, 1, 401)
    _, expected = step(lti([w * w], [1, 2 * zeta * w, w * w]), T=t)
    found = value("regulator-second-order", "pressure", time=t, target=1e5, damping_ratio=zeta)
    np.testing.assert_allclose(found, 1e5 * expected, atol=2)
    if zeta in (0.05, 0.5):
        beyond = value("regulator-second-order", "overshoot", damping_ratio=zeta)
        assert found.max() / 1e5 - 1 == pytest.approx(float(beyond), abs=2e-3)


@pytest.mark.parametrize(("start", "target", "rate"), [(0.0, 4e5, 8e5), (4e5, 1e5, 5e5), (2e5, 2.5e5, 8e5)])
def test_a_limited_rate_is_what_integration_gives(start, target, rate):
    lag, t = 0.15, np.linspace(0, 2, 401)

    def slope(_t, P):
        return np.clip((target - P) / lag, -5e5, 8e5)

    solved = solve_ivp(slope, (0, 2), [start], t_eval=t, rtol=1e-9, atol=1e-3, max_step=0.002)
    given = {"start": start, "target": target, "lag": lag, "rate_fill": 8e5, "rate_vent": 5e5}
    found = value("regulator-rate-limited", "pressure", time=t, **given)
    np.testing.assert_allclose(found, solved.y[0], atol=20)
    assert np.abs(np.diff(found) / np.diff(t)).max() <= rate * (1 + 1e-9)


def test_a_limited_flow_is_what_the_chamber_gives():
    t = np.linspace(0, 0.6, 301)
    given = {"conductance_fill": 1e-8, "flow_fill": 5e-4, "polytropic": 1.1, "volume": 80e-6, "temperature": 300.0}

    def slope(_t, P):
        flow = min(1e-8 * (3e5 - P[0]), 5e-4)
        rate = value(
            "chamber-rate", "pressure_rate", pressure=P[0], volume=80e-6, inflow=flow, polytropic=1.1, temperature=300.0
        )
        return [float(rate)]

    solved = solve_ivp(slope, (0, 0.6), [0.0], t_eval=t, rtol=1e-8, atol=1e-2, max_step=0.005)
    found = value("regulator-flow-limited", "pressure", time=t, target=3e5, **given)
    np.testing.assert_allclose(found, solved.y[0], atol=30)


@pytest.mark.parametrize("ease", [1.2, 0.95, 0.8, 0.65, 0.55, 0.5, 0.2])
def test_the_gain_of_a_limited_sine_is_that_of_a_limiter_in_time(ease):
    A, f = 2e5, 2.0
    R, steps = ease * A * 2 * math.pi * f, 4000
    h, y, wave = 1 / f / steps, 0.0, []
    for k in range(8 * steps):
        wanted = A * math.sin(2 * math.pi * f * (k + 1) * h)
        y += min(max(wanted - y, -R * h), R * h)
        wave.append(y)
    theta = 2 * math.pi * np.arange(1, steps + 1) / steps
    harmonic = 2j / steps * np.sum(np.array(wave[-steps:]) * np.exp(-1j * theta)) / A
    found = MODELS["regulator-sine"].evaluate({"amplitude": A, "frequency": f, "rate": R})
    assert float(found["gain"]) == pytest.approx(abs(harmonic), abs=1e-3)
    assert float(found["phase"]) == pytest.approx(np.angle(harmonic), abs=2e-3)


def test_a_large_sine_is_followed_worse_than_a_small_one():
    gains = value("regulator-sine", "gain", amplitude=np.linspace(0.1e5, 5e5, 50), frequency=5.0)
    assert (np.diff(gains) <= 1e-9).all()
    assert gains[0] == 1
    assert gains[-1] < 0.25


# -- chamber -----------------------------------------------------------------------------------------------------


def test_a_closed_driven_chamber_keeps_p_v_to_the_k():
    found = MODELS["driven-chamber"].evaluate(
        {"time": np.linspace(0, 20, 401), "conductance_fill": 0.0, "conductance_vent": 0.0}
    )
    constant_ = (found["pressure"] + 101325) * found["volume"] ** 1.2
    assert np.ptp(constant_) / constant_[0] < 1e-4
    closed = value(
        "closed-chamber", "pressure", pressure_start=5e5, volume_start=found["volume"][0], volume=found["volume"]
    )
    np.testing.assert_allclose(closed, found["pressure"], atol=50)


@pytest.mark.parametrize(
    ("frequency", "low", "high", "digit"), [(0.1, -2.8, 5.6, 0.06), (1.0, -26, 60, 0.6), (3.0, -72, 200, 3)]
)
def test_the_pressure_errors_of_the_driven_muscle(frequency, low, high, digit):
    """Against another simulation of the same equations: lowest and highest error [kPa]."""
    t = np.linspace(0, 6 / frequency, 6001)
    found = MODELS["driven-chamber"].evaluate({"time": t, "frequency": frequency})
    error = found["pressure_error"][t > 3 / frequency] / 1e3
    assert error.min() == pytest.approx(low, abs=digit)
    assert error.max() == pytest.approx(high, abs=digit)
    speed = np.gradient(found["contraction"], t)[t > 3 / frequency]
    assert speed[error.argmin()] > 0
    assert speed[error.argmax()] < 0


def test_volume_that_gives_way_to_pressure_makes_the_chamber_slower():
    V, V_P, P = 62.832e-6, 5e-11, 5e5
    stiff = 1.2 * (P + 101325) / V
    plain, soft = (value("chamber-rate", "pressure_rate", volume_compliance=item) for item in (0.0, V_P))
    assert float(soft) == pytest.approx(float(plain) / (1 + stiff * V_P))


def test_times_may_come_in_any_order():
    sorted_, mixed = (value("driven-chamber", "pressure", time=t) for t in ([0.0, 2.0, 5.0], [5.0, 0.0, 2.0]))
    assert mixed.tolist() == sorted_[[2, 0, 1]].tolist()


# -- friction and hysteresis -------------------------------------------------------------------------------------


def test_friction_never_drives():
    v, drive = np.meshgrid(np.linspace(-5e-3, 5e-3, 41), np.linspace(-30, 30, 61))
    f = value("coulomb-stiction", "friction", speed=v, drive=drive)
    assert (f * v >= 0).all()
    still = v == 0
    assert (np.abs(f[still]) <= np.abs(drive[still]) + 1e-12).all()
    assert np.abs(f).max() == 10
    with pytest.raises(OutsideDomain, match="above static"):
        value("coulomb-stiction", "friction", kinetic=11.0)


def test_hysteresis_knows_no_rate_and_settles_into_its_loop():
    def around(samples):
        theta = np.linspace(0, 6 * math.pi, 6 * samples + 1)
        eps = 0.085 - 0.115 * np.cos(theta)
        return eps, hysteresis_path(eps, 30.0, 0.006)

    eps, force = around(500)
    _, coarse = around(50)
    np.testing.assert_allclose(coarse, force[::10], atol=1e-9)
    last = slice(-1001, None)
    loop = MODELS["hysteresis-loop"].evaluate({"contraction": np.clip(eps[last], -0.03, 0.2)})
    expected = np.where(np.arange(1001) <= 500, loop["contracting"], loop["expanding"])
    np.testing.assert_allclose(force[last], expected, atol=1e-6)
    middle = value("hysteresis-loop", "gap", contraction=0.085)
    assert float(middle) == pytest.approx(60, abs=0.01)


def test_a_small_loop_is_narrower_and_contracting_is_the_lower_branch():
    small = MODELS["hysteresis-loop"].evaluate(
        {"contraction": 0.1, "contraction_low": 0.099, "contraction_high": 0.101}
    )
    assert 0 < float(small["gap"]) < 1
    eps = np.linspace(-0.03, 0.2, 24)
    loop = MODELS["hysteresis-loop"].evaluate({"contraction": eps})
    assert (loop["contracting"][1:-1] < loop["expanding"][1:-1]).all()
    branch = value("hysteresis-branch", "force", contraction=eps[1:], reversal=-0.03, force_start=30.0)
    np.testing.assert_allclose(branch, loop["contracting"][1:], atol=1e-6)
    with pytest.raises(OutsideDomain, match="between the turns"):
        value("hysteresis-loop", "gap", contraction=0.3)


# -- loads -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("load", "kpa"), [(0.0, 300), (58.86, 300), (300.0, 300), (10.0, 600)])
def test_a_muscle_at_rest_between_its_stops_is_the_plant_at_rest(load, kpa):
    setup = preset("paper0", "ideal")
    plant = Plant(setup.muscle, setup.regulator, force=load, mass=0.5)
    plant.command(constant(0.0, kpa * 1e3))
    plant.advance(20.0)
    x, P, F = plant.reading()
    given = {"force_ce": setup.muscle.F_ce(P), "stiffness": setup.muscle.K(P), "load": load, "stop": 0.05}
    found = MODELS["end-stops"].evaluate(given | {"stop": setup.muscle.stop})
    assert float(found["displacement"]) == pytest.approx(x, abs=1e-7)
    assert float(found["force"]) == pytest.approx(F, abs=1e-3)
    held = MODELS["end-stops"].evaluate(given | {"stop": 0.01})
    assert float(held["force"]) == pytest.approx(
        max(min(given["force_ce"], load), given["force_ce"] - given["stiffness"] * 0.01)
    )


def test_a_spring_holds_the_muscle_where_both_forces_agree():
    x, F = (float(value("load-spring", output, rate=3e3, preload=40.0)) for output in ("displacement", "force"))
    muscle = value("three-element", "force", displacement=x)
    assert float(muscle) == pytest.approx(F)
    assert pytest.approx(40 + 3e3 * x) == F
    assert float(value("load-spring", "force", preload=300.0)) == 275


def test_an_imposed_sine_meets_the_force_of_the_driven_plant():
    setup = preset("paper0", "ideal")
    plant = DrivenPlant(setup.muscle, setup.regulator, Actuator(), pressure=300e3, position=0.02)
    plant.move(sine(0.0, 0.02, 0.01, 0.5, 4))
    t = np.linspace(0.001, 3.9, 391)
    motion = plant.advance(4.0, t)
    F_ce, K = setup.muscle.F_ce(300e3), setup.muscle.K(300e3)
    speed = 0.01 * math.pi * np.cos(math.pi * t)
    for way, B in ((1, setup.muscle.B_c(300e3)), (-1, setup.muscle.B_r(300e3))):
        rows = (way * speed > 1e-4).nonzero()[0]
        found = MODELS["load-imposed"].evaluate(
            {"time": t[rows], "force_ce": F_ce, "stiffness": K, "damping": B, "kinetic": 0.0}
        )
        np.testing.assert_allclose(found["displacement"], motion.x[rows], atol=1e-9)
        np.testing.assert_allclose(found["force"], motion.F[rows], atol=1e-5)


# -- compositions ------------------------------------------------------------------------------------------------


def test_two_of_30_cm_end_to_end_are_one_of_60_cm():
    P, eps = 3e5, 0.1
    two = MODELS["series"].evaluate({"count": 2, "length": 0.3, "pressure": P, "contraction": eps})
    one = MODELS["series"].evaluate({"count": 1, "length": 0.6, "pressure": P, "contraction": eps})
    assert {key: float(item) for key, item in two.items()} == pytest.approx(
        {key: float(item) for key, item in one.items()}
    )
    assert float(two["force"]) == pytest.approx(float(value("tondu-lopez", "force", pressure=P, contraction=eps)))
    with pytest.raises(OutsideDomain, match="whole number"):
        value("series", "force", count=2.5)


@pytest.mark.parametrize("x", [0.06, 0.08, 0.15, 0.2])
def test_unlike_sections_pull_with_one_force(x):
    found = MODELS["series-pair"].evaluate({"displacement": x, "pressure_2": 4e5})
    first, second = (float(found[f"contraction_{i}"]) for i in (1, 2))
    assert 0.3 * (first + second) == pytest.approx(x, abs=1e-12)
    assert abs(first - second) > 0.005, "equal contraction would be the claim of paper 2"
    forces = [
        float(value("tondu-lopez", "force", pressure=P, contraction=eps, radius=r, braid_angle=math.radians(angle)))
        for P, eps, r, angle in ((3e5, first, 0.010, 25), (4e5, second, 0.008, 22))
    ]
    assert forces == pytest.approx([float(found["force"])] * 2, rel=1e-9)


def test_unlike_lengths_count_with_their_own_contraction():
    found = MODELS["series-pair"].evaluate({"length_1": 0.2, "length_2": 0.4, "displacement": 0.08})
    assert 0.2 * found["contraction_1"] + 0.4 * found["contraction_2"] == pytest.approx(0.08, abs=1e-12)


@pytest.mark.parametrize(("x", "reason"), [(0.0, "stretched"), (0.3, "more than both")])
def test_sections_that_cannot_balance_are_refused(x, reason):
    with pytest.raises(OutsideDomain, match=reason):
        value("series-pair", "force", displacement=x)


def test_a_cascade_of_one_is_a_single_muscle_up_and_down():
    t = np.linspace(0, 10, 201)
    x = MODELS["cascade"].evaluate({"time": t, "count": 1, "hold": 4.0, "pressure": 3e5, "load": 5.0})["displacement"]
    coefficients = MODELS["dmsp-40-305"].evaluate({"pressure": 3e5})
    K, D_c, D_r = (float(coefficients[key]) for key in ("stiffness", "damping_contract", "damping_relax"))
    top = value("dmsp-40-305-contraction", "displacement", pressure=3e5, load=5.0)
    up = value("step-response", "displacement", time=t, force_ce=float(top) * K, stiffness=K, damping=D_c)
    np.testing.assert_allclose(x[t <= 4], up[t <= 4], rtol=1e-12)
    start = float(x[t == 4][0])
    down = value(
        "release-response", "displacement", time=t[t >= 4] - 4, displacement_start=start, stiffness=K, damping=D_r
    )
    np.testing.assert_allclose(x[t >= 4], down, rtol=1e-12)


def test_a_cascade_adds_its_muscles_one_delay_apart():
    t = np.linspace(0, 30, 301)
    one = value("cascade", "sum", time=t, count=1)
    five = value("cascade", "sum", time=t, count=5)
    shifted = sum(np.where(t >= i, np.interp(t - i, t, one), 0) for i in range(5))
    np.testing.assert_allclose(five, shifted, atol=1e-9)


def test_muscles_of_a_cascade_have_pressures_of_their_own():
    given = {"time": 100.0, "count": 3, "delay": 0.0, "hold": 1e3, "pressure": 2e5, "pressure_step": 1e5, "load": 5.0}
    found = MODELS["cascade"].evaluate(given)
    each = [0.0570, 0.0659, 0.0709]  # at 2, 3, 4 bar: the digest's table for F_ce at x = 0, 5 N
    assert float(found["sum"]) == pytest.approx(3)
    assert float(found["displacement"]) == pytest.approx(sum(each), abs=2e-4)
    assert float(found["force_ce"]) == pytest.approx(4 * 885.4, abs=1)
    assert float(found["force_ce_sum"]) == pytest.approx(9 * 885.4, abs=2)
    assert float(found["force"]) == pytest.approx(5.0, abs=1e-6)
    with pytest.raises(OutsideDomain, match="1 to 6 bar"):
        value("cascade", "sum", count=3, pressure=5e5, pressure_step=1e5)


@pytest.mark.parametrize("time", [0.2, 1.0, 2.5, 9.9])
def test_the_force_of_a_chain_is_that_of_one_muscle(time):
    one, four = (MODELS["cascade"].evaluate({"time": time, "count": n, "delay": 0.0}) for n in (1, 4))
    assert float(four["displacement"]) == pytest.approx(4 * float(one["displacement"]), rel=1e-12)
    assert float(four["force"]) == pytest.approx(float(one["force"]), rel=1e-9)
    assert float(one["force"]) == pytest.approx(5312.24 - 69590 * float(one["displacement"]), abs=0.5)
    assert float(four["force_ce_sum"]) == pytest.approx(4 * float(four["force_ce"]))


def test_the_hold_of_a_sampled_loop_is_half_a_period_of_dead_time():
    sampled = value("ultimate-gain", "period", dead_time=0.04, sample_period=0.02)
    assert float(sampled) == pytest.approx(float(value("ultimate-gain", "period", dead_time=0.05)))


def test_a_loop_without_dead_time_is_refused():
    with pytest.raises(OutsideDomain):
        value("ultimate-gain", "period", dead_time=0.0)


def test_what_cannot_be_solved_is_refused_not_returned():
    with pytest.raises(OutsideDomain, match="never oscillate"):
        value("ultimate-gain", "period", dead_time=1e-18)
    with pytest.raises(OutsideDomain, match="too fast"):
        value("driven-chamber", "pressure", frequency=3.0, conductance_vent=1e4, length=1e-8, alpha=3.56)
