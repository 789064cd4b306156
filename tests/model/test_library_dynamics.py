"""Chamber and compositions of the library against another simulation, tables of the papers and closed forms."""

import math

import numpy as np
import pytest

from pmabench.model.library import MODELS, OutsideDomain


def value(name, output, **given):
    return MODELS[name].evaluate(given)[output]


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
