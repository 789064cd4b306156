"""An identified muscle in time against closed forms and against another integration of the same equations.

The muscle is written out here: straight over contraction and pressure, with two stops, two lags and damping.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import BSpline

from pmabench.model.driven import Actuator
from pmabench.model.identified.muscle import SCHEMA, IdentifiedMuscle, Splines
from pmabench.model.identified.plant import IdentifiedDrivenPlant, IdentifiedPlant, Path, force_along, free_run
from pmabench.model.regulator import Regulator, constant, sine

P_KNOTS, X_KNOTS = (0.0, 100e3, 600e3), (0.0, 5e-3, 20e-3, 60e-3)
STIFF, PER_PRESSURE = 20e3, 2.5e-3
"""K [N/m] and dF/dP [N/Pa] of the straight surface."""


def straight(knots):
    """Weights of the cubic splines over `knots` whose sum is the value itself: their Greville places."""
    every = [knots[0]] * 3 + list(knots) + [knots[-1]] * 3
    return np.array([np.mean(every[i + 1 : i + 4]) for i in range(len(knots) + 2)])


def muscle(stops=(), pressure_stops=(), creep=(), damping=(1500.0, 1000.0)):
    """F = 2.5 P - 20 x [kPa, mm, N] with stops (half width, N) and creep (time constant, share)."""
    P, x = straight(P_KNOTS), straight(X_KNOTS)

    def weights(pairs):
        sizes, values = zip(*pairs, strict=True) if pairs else ((1.0,), (0.0,))
        return {"sizes": list(sizes), "low": list(values), "high": list(values)}

    contracting, relaxing = damping
    return IdentifiedMuscle.of({
        "schema": SCHEMA, "name": "straight", "pressure_knots": list(P_KNOTS), "contraction_knots": list(X_KNOTS),
        "heights": (PER_PRESSURE * P[:, None] - STIFF * x[None, :]).tolist(), "stops_x": weights(stops),
        "stops_P": weights(pressure_stops), "creep_x": weights(creep), "creep_P": weights(()),
        "B_c": [contracting, contracting], "B_r": [relaxing, relaxing], "fast": 0.0, "settled": 0.0,
    })  # fmt: skip


@pytest.mark.parametrize("at", [-1e-3, 0.0, 1.2e-3, 5e-3, 17e-3, 60e-3, 64e-3])
def test_splines_are_those_of_scipy_and_go_on_as_straight_lines(at):
    splines = Splines(X_KNOTS)
    every = np.array([X_KNOTS[0]] * 3 + list(X_KNOTS) + [X_KNOTS[-1]] * 3)
    theirs = BSpline(every, np.eye(splines.size), 3)
    inside = float(np.clip(at, X_KNOTS[0], X_KNOTS[-1]))
    wanted = theirs(inside) + (at - inside) * theirs.derivative()(inside)
    assert splines.functions(at) == pytest.approx(wanted, abs=1e-12)


def test_a_slow_loop_has_the_width_and_area_of_its_stops():
    """A stop of half width r and weight w over a stroke of +- A > 2 r: width 2 w at the centre, area 4 w (A - r)."""
    stops = ((1e-3, 10.0), (4e-3, 20.0))
    one = muscle(stops)
    assert one.gap(300e3, 10e-3) == pytest.approx(60.0)
    assert one.gap(300e3, 5e-3) == pytest.approx(2 * 10 + 2 * 20 * (5 - 4) / 4)
    path, places = Path(one, 300e3, 20e-3), 20e-3 + 10e-3 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    F = np.array([path.go(1.0, 300e3, x) for x in places])[2000:]
    x = places[2000:]
    assert np.trapezoid(F, x) == pytest.approx(-sum(4 * w * (10e-3 - r) for r, w in stops), rel=1e-3)


def test_a_held_contraction_creeps_with_its_time_constants():
    """After a step of x that is held, the force rises by K c x (1 - exp(-t / T))."""
    path = Path(muscle(creep=((2.0, 0.05),)), 300e3)
    first = path.go(1e-9, 300e3, 10e-3)
    for t in (1.0, 2.0, 5.0):
        here = path.copy().go(t, 300e3, 10e-3)
        assert here - first == pytest.approx(STIFF * 0.05 * 10e-3 * (1 - np.exp(-t / 2.0)), rel=1e-6)


def theirs(t, P_of, load, mass, stops, pressure_stops, creep, damping, h=2e-4):
    """The same muscle by Euler steps, of the speed first, each 12 times shorter than those of the plant."""
    (radii, weights), (sizes, held), (T, share) = (np.array(pairs).T for pairs in (stops, pressure_stops, creep))
    S, Q, L = np.zeros(len(radii)), np.clip(P_of(0.0) / sizes - 1.0, -1.0, 1.0), np.zeros(len(T))
    x = v = 0.0
    found = []
    times = np.arange(0.0, t[-1] + h, h)
    pressures = P_of(times)
    for P, P_next in pairwise(pressures):
        found.append(x)
        F = PER_PRESSURE * P - STIFF * x + STIFF * (share @ L) - weights @ S - held @ Q
        v += h * (F - (damping[0] if v > 0 else damping[1]) * v - load) / mass
        if x + h * v < 0:
            v = -x / h
        S = np.clip(S + h * v / radii, -1.0, 1.0)
        Q = np.clip(Q + (P_next - P) / sizes, -1.0, 1.0)
        L = L + h * (x - L) / T
        x += h * v
    return np.interp(t, times[:-1], found)


def test_a_load_moves_as_another_integration_says():
    stops, held = ((1e-3, 10.0), (4e-3, 20.0)), ((20e3, 8.0),)
    creep, damping = ((0.5, 0.02), (5.0, 0.03)), (1500.0, 900.0)
    t = np.arange(0.0, 3.0, 2e-3)

    def P_of(now):
        return 250e3 + 150e3 * np.sin(2 * np.pi * 0.4 * now - 1.2) + 40e3 * np.sin(2 * np.pi * 1.3 * now)

    reference = theirs(t, P_of, 200.0, 20.0, stops, held, creep, damping)
    one = muscle(stops, held, creep, damping)
    x, F = free_run(one, t, P_of(t), 200.0, 20.0)
    assert np.abs(x - reference).max() < 20e-6
    assert np.ptp(reference) > 15e-3
    assert F.mean() == pytest.approx(200.0, abs=5.0)


def test_a_plant_comes_to_where_the_force_is_the_load_and_stays_on_its_support():
    plant = IdentifiedPlant(muscle(), Regulator(dead_time=0.02, lag=0.1), force=250.0, mass=25.0)
    plant.command(constant(0.0, 300e3))
    seen = plant.advance(6.0, np.array([0.1, 6.0]))
    assert seen.x[1] == pytest.approx((2.5e-3 * 300e3 - 250.0) / STIFF, rel=1e-6)
    assert seen.F[1] == pytest.approx(250.0, abs=1e-3)
    plant.command(constant(6.0, 50e3))
    down = plant.advance(12.0, np.array([12.0]))
    assert down.x[0] == 0.0
    assert down.F[0] == pytest.approx(125.0, abs=0.1)


def test_a_driven_end_feels_surface_stops_and_damping():
    """At the centre of a sine, contracting: F = F_s - w - B_c A omega."""
    plant = IdentifiedDrivenPlant(muscle(((0.5e-3, 15.0),)), Regulator(dead_time=0.0), Actuator(), position=20e-3)
    plant.command(constant(0.0, 300e3))
    plant.move(sine(0.0, 20e-3, 10e-3, 0.5, 3))
    (F,) = plant.advance(6.0, np.array([4.0])).F
    assert pytest.approx(2.5e-3 * 300e3 - STIFF * 20e-3 - 15.0 - 1500 * 10e-3 * np.pi, abs=0.5) == F


def test_rows_that_come_later_change_nothing_before():
    one = muscle(((1e-3, 10.0),), ((20e3, 8.0),), ((2.0, 0.05),))
    t = np.linspace(0, 10, 501)
    P, x = 300e3 + 50e3 * np.sin(t), 15e-3 + 8e-3 * np.sin(0.7 * t)
    v = np.gradient(x, t)
    assert force_along(one, t[:200], P[:200], x[:200], v[:200]) == pytest.approx(force_along(one, t, P, x, v)[:200])


@pytest.mark.parametrize(
    ("change", "words"),
    [({"schema": "pmabench.identified-muscle/9"}, "this version reads"), ({"heights": [[1.0]]}, "not as many"),
     ({"pressure_knots": [0.0, 0.0]}, "must rise"),
     ({"stops_x": {"sizes": [0.0], "low": [1.0], "high": [1.0]}}, "sizes above 0")],
)  # fmt: skip
def test_what_is_damaged_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        IdentifiedMuscle.of({**muscle().to_dict(), **change})


RADII, SHARES, HEIGHTS = np.array([0.2, 0.8, 2.5, 8.0]), np.array([0.2, 0.3, 0.3, 0.2]), (5.0, 0.05)
RHO, HELD, TIMES = np.array([20.0, 100.0]), 18.0 * np.array([0.4, 0.6]), np.array([0.5, 1.58, 5.0, 15.8, 50.0, 158.0])
"""The reference muscle of the page on real muscles, with kPa, mm, N and s."""


def of_the_page(x, P):
    kappa = x / 2.5
    return (244.7 - 0.1115 * P) * np.exp(-0.334 * kappa) - 0.0830 * kappa * P + 2.650 * P - 249.4


def page_muscle():
    """Its surface as splines with a knot each 2 mm; all else as printed."""
    axes = [Splines((0.0, 300e3, 600e3)), Splines(tuple(2e-3 * k for k in range(-2, 33)))]
    places = [np.linspace(axis.low, axis.high, 4 * axis.size) for axis in axes]
    over_P, over_x = (np.array([axis.functions(u) for u in at]) for axis, at in zip(axes, places, strict=True))
    wanted = of_the_page(1e3 * places[1][None, :], 1e-3 * places[0][:, None])
    heights = np.linalg.pinv(over_P) @ wanted @ np.linalg.pinv(over_x).T

    def weights(sizes, low, high):
        return {"sizes": list(sizes), "low": list(low), "high": list(high)}

    creep = np.full(6, 0.004)
    return IdentifiedMuscle.of({
        "schema": SCHEMA, "name": "page", "pressure_knots": axes[0].knots, "contraction_knots": axes[1].knots,
        "heights": heights.tolist(), "stops_x": weights(1e-3 * RADII, 5.0 * SHARES, 35.0 * SHARES),
        "stops_P": weights(1e3 * RHO, HELD, HELD), "creep_x": weights(TIMES, creep, creep),
        "creep_P": weights([1.0], [0.0], [0.0]), "B_c": [1000.0, 2200.0], "B_r": [700.0, 1600.0], "fast": 0.0,
        "settled": 0.0,
    })  # fmt: skip


def stepped(P, h, load, mass, x_of=None):
    """Contraction [mm], and force [N], of the page's equations in steps of h [s] under pressures P [kPa].

    A load [N] of a mass [kg] on the free end, which cannot go below 0; or where the free end is driven, along x_of.
    """
    x = v = 0.0
    S, Q, crept, before = np.zeros(4), -RHO, np.zeros(6), float(P[0])
    Q, places, forces = np.clip(Q + before, -RHO, RHO), [], []
    for row, now in enumerate(P.tolist()):
        Q = np.clip(Q + now - before, -RHO, RHO)
        F = of_the_page(x - crept.sum(), now) - (HEIGHTS[0] + HEIGHTS[1] * now) * float(SHARES @ (S / RADII))
        F -= float(HELD @ (Q / RHO))
        places.append(x)
        to = v
        if x_of is not None:
            to = (x_of[min(row + 1, len(x_of) - 1)] - x) / h
        B = 1.0 + 0.002 * now if to > 0 else 0.7 + 0.0015 * now
        forces.append(F - B * to)
        v = to if x_of is not None else (v + 1e3 * h * (F - load) / mass) / (1 + 1e3 * h * B / mass)
        if x + h * v < 0 and x_of is None:
            v = -x / h
        x, S = x + h * v, np.clip(S + h * v, -RADII, RADII)
        crept, before = crept + (0.004 * x - crept) * (1 - np.exp(-h / TIMES)), now
    return np.array(places), np.array(forces)


def test_the_muscle_of_the_page_moves_a_load_as_its_equations_say():
    """Turns within turns, over 48 mm: half the step of the equations here is off by half as much, 4 um at 0.2 ms."""
    t = np.arange(0.0, 10.0, 4e-4)
    P = np.minimum(t / 0.5, 1) * (330 + 110 * np.sin(1.3 * t) + 40 * np.sin(4.1 * t))
    wanted, _ = stepped(P, 4e-4, 200.0, 20.6)
    x, F = free_run(page_muscle(), t[::5], 1e3 * P[::5], 200.0, 20.6)
    assert np.ptp(wanted) > 40
    assert np.abs(1e3 * x - wanted[::5]).max() < 0.02
    assert F[-1000:].mean() == pytest.approx(200.0, abs=5.0)


def test_the_force_of_the_page_s_driven_muscle_is_that_of_its_equations():
    t = np.arange(0.0, 20.0, 5e-3)
    P = 300 + 150 * np.sin(0.5 * t)
    x = 18 * (1 - np.cos(0.7 * t)) + 2 * (1 - np.cos(3.0 * t))
    _, wanted = stepped(P, 5e-3, 0.0, 1.0, x)
    F = force_along(page_muscle(), t, 1e3 * P, 1e-3 * x, 1e-3 * np.gradient(x, t))
    off = (F - np.maximum(wanted, 0.0))[wanted > 20]
    assert np.abs(off[100:-1]).max() < 0.2
