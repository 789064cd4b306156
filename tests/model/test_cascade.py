"""A chain of muscles against paper 1's printed polynomials, closed forms, and the single muscle."""

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from pmabench.model.cascade import PlantMuscle, PrintedMuscle, Step, simulate
from pmabench.model.library import MODELS
from pmabench.model.muscle import body_radius, held_force, outline, quadratic
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.regulator import constant

ON_OFF = [Step(0.0, 6e5), Step(10.0, 0.0)]


def later(steps, delay):
    return [Step(step.at + delay, step.pressure) for step in steps]


def test_three_muscles_a_second_apart_give_the_digests_numbers():
    t = np.array([1, 2, 3, 5, 10.5, 12, 15, 20])
    course = simulate([PrintedMuscle(later(ON_OFF, i)) for i in range(3)], t)
    one = float(MODELS["dmsp-40-305-contraction"].evaluate({"load": 0.0})["displacement"])
    expected = [0.94017, 1.93659, 2.93638, 2.99977, 2.72608, 1.80514, 0.26450, 0.01077]
    np.testing.assert_allclose(course.displacement / one, expected, atol=0.6e-5)


@pytest.mark.parametrize(("fce_at", "reached"), [("x0", 76.3), ("xmax", 42.4)])
def test_one_printed_muscle_is_the_single_muscle(fce_at, reached):
    t = np.linspace(0, 20, 401)
    x = simulate([PrintedMuscle(ON_OFF, 5.0, fce_at)], t).displacement
    up, down = (t < 10), (t >= 10)
    top = float(MODELS["dmsp-40-305-contraction"].evaluate({"fce_at": fce_at})["displacement"])
    assert 1e3 * top == pytest.approx(reached, abs=0.05)
    c = {key: float(value) for key, value in MODELS["dmsp-40-305"].evaluate({}).items()}
    K, D_c, D_r = c["stiffness"], c["damping_contract"], c["damping_relax"]
    rising = {"time": t[up], "force_ce": K * top, "stiffness": K, "damping": D_c}
    np.testing.assert_allclose(x[up], MODELS["step-response"].evaluate(rising)["displacement"], rtol=1e-12)
    start = top * -math.expm1(-10 * K / D_c)
    falling = {"time": t[down] - 10, "displacement_start": start, "stiffness": K, "damping": D_r}
    np.testing.assert_allclose(x[down], MODELS["release-response"].evaluate(falling)["displacement"], rtol=1e-12)


@pytest.mark.parametrize("kind", ["ideal", "bench"])
def test_one_plant_in_a_chain_is_the_plant_alone(kind):
    setup, t = preset("paper0", kind), np.linspace(0, 6, 601)
    chain = PlantMuscle(setup.free(58.86, 0.5), [Step(0.5, 3e5), Step(3.0, 1e5)])
    alone = Plant(setup.muscle, setup.regulator, force=58.86, mass=0.5)
    alone.command((*constant(0.0, 0.0), *constant(0.5, 3e5), *constant(3.0, 1e5)))
    course, motion = simulate([chain], t), alone.advance(6.0, t)
    assert (course.displacement == motion.x).all()
    assert (course.P[0] == motion.P).all()
    assert course.displacement.max() > 0.03


def test_each_muscle_has_its_own_model_pressure_and_delay():
    t = np.linspace(0, 8, 801)
    setup = preset("paper0", "ideal")

    def muscles():
        return (
            PrintedMuscle([Step(0.2, 3e5), Step(4.0, 5e5)], 50.0),
            PlantMuscle(setup.free(50.0), [Step(1.0, 4e5)]),
        )

    together = simulate(muscles(), t)
    apart = [simulate([muscle], t) for muscle in muscles()]
    np.testing.assert_array_equal(together.displacement, apart[0].displacement + apart[1].displacement)
    np.testing.assert_array_equal(together.force_ce_sum, apart[0].force_ce + apart[1].force_ce)


def test_steps_between_pressures_rise_with_the_new_and_fall_with_the_old_time_constant():
    t = np.linspace(0, 30, 3001)
    muscle = PrintedMuscle([Step(0.0, 3e5), Step(10.0, 6e5), Step(20.0, 2e5)], 0.0)
    x = simulate([muscle], t).displacement
    rest = {P: float(MODELS["dmsp-40-305-contraction"].evaluate({"pressure": P, "load": 0.0})["displacement"])
            for P in (3e5, 6e5, 2e5)}  # fmt: skip
    tau = {(P, way): float(MODELS["dmsp-40-305"].evaluate({"pressure": P})[f"tau_{way}"])
           for P in (3e5, 6e5) for way in ("contract", "relax")}  # fmt: skip
    up = rest[6e5] + (x[1000] - rest[6e5]) * np.exp(-(t[1000:2000] - 10) / tau[6e5, "contract"])
    down = rest[2e5] + (x[2000] - rest[2e5]) * np.exp(-(t[2000:] - 20) / tau[6e5, "relax"])
    np.testing.assert_allclose(x[1000:2000], up, atol=1e-12)
    np.testing.assert_allclose(x[2000:], down, atol=1e-12)


def test_a_load_that_is_not_lifted_stays_where_it_is():
    course = simulate([PrintedMuscle([Step(0.0, 1e5)], 900.0, "xmax")], np.linspace(0, 5, 51))  # 1 bar: 885 N
    assert (course.displacement == 0).all()


@pytest.mark.parametrize("pressure", [0.5e5, 0.99e5, 6.01e5])
def test_printed_muscles_are_refused_outside_1_to_6_bar(pressure):
    with pytest.raises(ValueError, match="1 to 6 bar"):
        PrintedMuscle([Step(0.0, pressure)])


def test_block_by_block_it_is_the_same_course():
    t = np.linspace(0, 12, 1201)
    setup = preset("paper0", "bench")

    def members():
        return [PrintedMuscle(ON_OFF, 58.86), PlantMuscle(setup.free(58.86), ON_OFF)]

    whole, parts = simulate(members(), t), members()
    blocks = [simulate(parts, block) for block in np.array_split(t, 60)]
    x = np.concatenate([block.x for block in blocks], axis=1)
    assert (x[0] == whole.x[0]).all()
    np.testing.assert_allclose(x[1], whole.x[1], atol=1e-6)


# -- the force of a chain --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 7])
def test_equal_muscles_pull_like_one(count):
    t = np.linspace(0, 9.9, 100)
    one, many = (simulate([PrintedMuscle(ON_OFF) for _ in range(n)], t) for n in (1, count))
    np.testing.assert_allclose(many.force, one.force, atol=1e-6)
    np.testing.assert_array_equal(many.force_ce, one.force_ce)
    np.testing.assert_allclose(many.force_ce_sum, count * one.force_ce_sum, rtol=1e-12)
    np.testing.assert_allclose(many.displacement, count * one.displacement, rtol=1e-12)
    assert one.force[0] == pytest.approx(5312.24, abs=0.1)


def test_unlike_muscles_balance():
    """The least energy of the springs at a given total contraction, by an independent program: F is its slope."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        n = int(rng.integers(1, 5))
        F_ce, K, stops = rng.uniform(0, 5000, n), rng.uniform(5e3, 7e4, n), rng.uniform(0.03, 0.1, n)
        x = float(rng.uniform(0.05, 0.9)) * float(np.minimum(F_ce / K, stops).sum())
        force = float(held_force(F_ce[:, None], K[:, None], stops, np.array([x]))[0])
        # maximise the work of F_ce less that of the springs, spring energy as tangents: a linear program
        cuts = np.linspace(0, 1, 400)
        rows, bounds = [], []
        for i in range(n):
            for at in cuts * stops[i]:
                row = np.zeros(2 * n)
                row[i], row[n + i] = K[i] * at, -1.0
                rows.append(row)
                bounds.append(0.5 * K[i] * at * at)
        found = linprog(
            np.concatenate([-F_ce, np.ones(n)]), A_ub=np.array(rows), b_ub=bounds, A_eq=[[1.0] * n + [0.0] * n],
            b_eq=[x], bounds=[(0, stop) for stop in stops] + [(None, None)] * n,
        )  # fmt: skip
        assert force == pytest.approx(
            -found.eqlin.marginals[0], abs=1.01 * float((K * stops).max()) / 399
        )  # the tangents' spacing


def test_a_chain_shorter_than_it_holds_itself_is_slack_and_a_vented_muscle_is_a_rope():
    F_ce, K, stops = np.array([[1000.0], [0.0]]), np.array([[1e4], [1e4]]), np.array([0.1, 0.1])
    assert held_force(F_ce, K, stops, np.array([0.0]))[0] == 1000.0
    assert held_force(F_ce, K, stops, np.array([0.05]))[0] == pytest.approx(500.0, abs=1e-6)
    assert held_force(F_ce, K, stops, np.array([0.15]))[0] == pytest.approx(0.0, abs=1e-6)


# -- the outline -----------------------------------------------------------------------------------------------------


def test_the_bezier_curve_is_that_of_paper_1_with_t_for_t_less_t0():
    P0, P1, P2 = (np.array(p, dtype=float) for p in ((0, 1), (2, 5), (6, 5)))
    found = quadratic(P0, P1, P2, np.array([0.0, 0.25, 1.0]))
    # by hand at t = 1/4: 9/16 P0 + 6/16 P1 + 1/16 P2
    np.testing.assert_allclose(found, [[0, 1], [0.75 + 0.375, 0.5625 + 1.875 + 0.3125], [6, 5]])


@pytest.mark.parametrize("contraction", [0.0, 0.02, 0.1, 0.25, 0.33])
def test_the_outline_is_continuous_and_so_is_its_tangent(contraction):
    line = outline(0.305, contraction, 0.020, math.radians(26.5))
    P0, P1, P2 = line.end
    assert line.length == pytest.approx(0.305 * (1 - contraction))
    assert P0[1] == 0.020
    assert (P2 == [line.body, line.radius]).all()
    assert 2 * line.body < line.length
    if contraction:
        h = 1e-6
        points = quadratic(P0, P1, P2, np.array([0.0, h, 1 - h, 1.0]))
        slope = (points[3] - points[2]) / h
        assert abs(slope[1]) < 1e-5 * abs(slope[0])  # the cylinder runs on without a kink
        assert slope[0] > 0
        entry = (points[1] - points[0]) / h
        np.testing.assert_allclose(entry, 2 * (P1 - P0), rtol=1e-4)  # the end's tangent goes along P0 P1
        x, y = quadratic(P0, P1, P2, np.linspace(0, 1, 200)).T
        assert (np.diff(x) > 0).all()
        assert (np.diff(y) > 0).all()


def test_the_braid_does_not_stretch():
    """Chou and Hannaford: L = b cos(theta), r = b sin(theta) / (2 pi n) with b and n constant."""
    theta0, r0, L0 = math.radians(25), 0.01, 0.25
    b = L0 / math.cos(theta0)
    turns = b * math.sin(theta0) / (2 * math.pi * r0)
    for eps in (0.0, 0.1, 0.3):
        theta = math.acos((1 - eps) * L0 / b)
        assert body_radius(eps, r0, theta0) == pytest.approx(b * math.sin(theta) / (2 * math.pi * turns), rel=1e-12)


def test_ends_of_a_short_thick_muscle_do_not_meet():
    line = outline(0.03, 0.3, 0.02, math.radians(20))
    assert 2 * line.body < line.length
    assert line.end[1][1] == line.end[2][1] == line.radius
