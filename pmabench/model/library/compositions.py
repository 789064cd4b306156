"""Compositions of muscles: in parallel, in series, one after another in time; and the loop seen by a controller."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, BRAID_ANGLE, CONTRACTION, DEG, MM, PRESSURE, RADIUS, braid_factors
from pmabench.model.library.braid import braid_force as force_of
from pmabench.model.library.coefficients import DMSP_PRESSURE, DMSP_SHAPE, dmsp_40_305, dmsp_40_305_contraction
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse
from pmabench.model.loop import Loop, ultimate
from pmabench.model.muscle import held_force

FAMILY = "composition"
COUNT = Parameter("count", "N", "count", 3.0, "number of muscles", 1.0, 1000.0, "a whole number of at least 1")
LENGTH = Parameter("length", "L0", "length", 300 * MM, "nominal length of one", 0.0, above=True)


def _whole(count: Array) -> None:
    refuse("count", "a whole number is expected", count != np.round(count), count)


@described(
    "parallel", FAMILY, "Equal muscles side by side",
    equation=("F = N f(eps) at the same eps; f as in tondu-lopez with k = 1",),
    source="paper 2",
    parameters=(COUNT, PRESSURE, CONTRACTION, RADIUS, BRAID_ANGLE),
    outputs=(Output("force", "F", "force", "force of all"), Output("force_one", "f", "force", "force of one")),
    references=(Reference("force", "3863.1", "N", 1.0, "by hand: 3 pi 1e-4 5e5 (13.79673 - 5.59891)"),),
    notes=("Paper 2 calls the number K; K is stiffness here.",),
)  # fmt: skip
def parallel(count: Array, pressure: Array, contraction: Array, radius: Array, braid_angle: Array) -> Values:
    """F and f [N] from N [1], P [Pa gauge], eps [1], r0 [m], theta0 [rad]."""
    _whole(count)
    one = force_of(pressure, contraction, radius, braid_angle, np.ones(()))[0]
    return {"force": count * one, "force_one": one + 0 * count}


@described(
    "series", FAMILY, "Equal muscles end to end",
    equation=("F = f(eps): one common force;  x = N L0 eps;  L = N L0 (1 - eps)",),
    source="paper 2",
    parameters=(COUNT, PRESSURE, CONTRACTION, RADIUS, BRAID_ANGLE, LENGTH),
    outputs=(
        Output("force", "F", "force", "force of the chain, that of one"),
        Output("displacement", "x", "length", "contraction of the chain"),
        Output("length", "L", "length", "length of the chain"),
    ),
    references=(
        Reference("displacement", "60", "mm", MM, "two of 300 mm or one of 600 mm at 10 %",
                  {"count": 2.0, "contraction": 0.1}),
        Reference("force", "1287.7", "N", 1.0, "by hand: pi 1e-4 5e5 (13.79673 - 5.59891)"),
    ),
    notes=("A chain pulls no more than one muscle; paper 2's \"force divided by the number of sections\" is wrong.",),
)  # fmt: skip
def series(
    count: Array, pressure: Array, contraction: Array, radius: Array, braid_angle: Array, length: Array
) -> Values:
    """F [N], x and L [m] from N [1], P [Pa gauge], eps [1], r0 [m], theta0 [rad], L0 [m]."""
    _whole(count)
    force = force_of(pressure, contraction, radius, braid_angle, np.ones(()))[0]
    whole = count * length
    return {"force": force + 0 * whole, "displacement": whole * contraction, "length": whole * (1 - contraction)}


def _section(number: int, radius: float, angle: float, length: float) -> tuple[Parameter, ...]:
    """Inputs of one of two sections."""
    return (
        Parameter(f"pressure_{number}", f"P{number}", "pressure", 3 * BAR, "gauge pressure", 0.0, above=True),
        Parameter(f"radius_{number}", f"r{number}", "length", radius, "radius at eps = 0", 0.0, above=True),
        Parameter(
            f"braid_angle_{number}", f"theta{number}", "angle", angle, "braid angle at eps = 0", 0.0,
            BRAID_ANGLE.high, BRAID_ANGLE.reason, above=True,
        ),
        Parameter(f"length_{number}", f"L{number}", "length", length, "nominal length", 0.0, above=True),
    )  # fmt: skip


@described(
    "series-pair", FAMILY, "Two unlike muscles end to end: one force, each its own contraction",
    equation=(
        "f_1(eps_1) = f_2(eps_2) = F;  L1 eps_1 + L2 eps_2 = x;  f as in tondu-lopez with k = 1",
        "eps_i(F) = 1 - sqrt((F / (pi r_i^2 P_i) + b_i) / a_i)",
    ),
    source="paper 2, with the force balance that it leaves out",
    parameters=(
        Parameter("displacement", "x", "length", 80 * MM, "contraction of both together", 0.0),
        *_section(1, 10 * MM, 25 * DEG, 300 * MM), *_section(2, 8 * MM, 22 * DEG, 300 * MM),
    ),
    outputs=(
        Output("force", "F", "force", "common force"),
        Output("contraction_1", "eps_1", "ratio", "contraction of the first"),
        Output("contraction_2", "eps_2", "ratio", "contraction of the second"),
    ),
    references=(
        Reference("force", "525.57", "N", 1.0, "equal sections at 10 %: tondu-lopez, by hand",
                  {"displacement": 60 * MM, "radius_2": 10 * MM, "braid_angle_2": 25 * DEG}),
    ),
    notes=("Equal contraction holds only for equal r0, theta0 and P; paper 2 claims it for all.",),
)  # fmt: skip
def series_pair(displacement: Array, *sections: Array) -> Values:
    """F [N], eps_1 and eps_2 [1] from x [m] and of each section P_i [Pa gauge], r_i [m], theta_i [rad], L_i [m]."""
    force, first, second = np.vectorize(_balance, otypes=[float] * 3)(displacement, *sections)
    return {"force": force, "contraction_1": first, "contraction_2": second}


def _balance(
    x: float, P1: float, r1: float, t1: float, L1: float, P2: float, r2: float, t2: float, L2: float
) -> tuple[float, float, float]:
    """Common force [N] and both contractions [1]."""
    sections = []
    for P, r, theta in ((P1, r1, t1), (P2, r2, t2)):
        a, b = (float(factor) for factor in braid_factors(np.asarray(theta)))
        sections.append((math.pi * r * r * P, a, b))

    def contractions(force: float) -> list[float]:
        return [1 - math.sqrt((force / size + b) / a) for size, a, b in sections]

    def together(force: float) -> float:
        first, second = contractions(force)
        return L1 * first + L2 * second - x

    most = min(size * (a - b) for size, a, b in sections)
    refuse("displacement", "it is more than both can contract", together(0.0) < -1e-12, x)
    refuse("displacement", "the weaker section would be stretched beyond its length", together(most) > 1e-12, x)
    low, high = together(0.0), together(most)
    force = 0.0 if low <= 0 else most if high >= 0 else float(brentq(together, 0.0, most, xtol=1e-12))
    first, second = contractions(force)
    return force, first, second


@described(
    "cascade", FAMILY, "DMSP-40-305 end to end, switched on and off one after another",
    equation=(
        "muscle i at P + (i - 1) P_step, on from (i - 1) delay to (i - 1) delay + hold",
        "on: x_i = x_max (1 - exp(-t / tau_c)), off: falling with tau_r;  x = sum of x_i",
        "x_max as in dmsp-40-305-contraction, tau_c and tau_r as in dmsp-40-305, each at the muscle's pressure",
        "force F of the chain held at x: sum of min(max((F_ce - F) / S, 0), L0) = x, F >= 0",
    ),
    source="paper 1, cascade simulation: open loop, horizontal, no friction, no interaction",
    parameters=(
        Parameter("time", "t", "time", 3.0, "since the first is switched on", 0.0),
        Parameter("count", "N", "count", 3.0, "number of muscles", 1.0, 100.0, "a whole number of 1 to 100"),
        DMSP_PRESSURE,
        Parameter("pressure_step", "P_step", "pressure", 0.0, "pressure from one to the next", -INF),
        Parameter("delay", "", "time", 1.0, "from one to the next", 0.0, INF, "", "printed"),
        Parameter("hold", "", "time", 10.0, "each is on for this time", 0.0),
        Parameter("load", "L", "force", 0.0, "load", 0.0),
        Parameter("fce_at", "", "", "x0", "where F_ce is taken", choices=("x0", "xmax")),
    ),
    outputs=(
        Output("sum", "", "count", "contraction of the chain, each muscle in units of its x_max"),
        Output("displacement", "x", "length", "contraction of the chain"),
        Output("force_ce_sum", "", "force", "sum of F_ce, paper 1's total F_ce: a sum of coefficients, no force"),
        Output("force_ce", "F_ce", "force", "F_ce of the chain: that of its strongest muscle"),
        Output("force", "F", "force", "force with which the chain pulls if it is held where it is"),
    ),
    references=(
        Reference("sum", "0.94017", "", 1.0, "computed from the printed polynomials", {"time": 1.0}),
        Reference("sum", "1.93659", "", 1.0, "the same", {"time": 2.0}),
        Reference("sum", "2.93638", "", 1.0, "the same"),
        Reference("sum", "2.99977", "", 1.0, "the same", {"time": 5.0}),
        Reference("sum", "2.72608", "", 1.0, "the same", {"time": 10.5}),
        Reference("sum", "1.80514", "", 1.0, "the same", {"time": 12.0}),
        Reference("sum", "0.26450", "", 1.0, "the same", {"time": 15.0}),
        Reference("sum", "0.01077", "", 1.0, "the same", {"time": 20.0}),
        Reference("force_ce", "5312", "N", 1.0, "885.4 N/bar at 6 bar: that of one muscle"),
        Reference("force_ce_sum", "15937", "N", 1.0, "by hand: three times 5312.24 N"),
        Reference("force_ce_sum", "5312", "N", 1.0, "by hand: the first alone is on", {"time": 0.5}),
        Reference("force_ce_sum", "10624", "N", 1.0, "by hand: the first is off again", {"time": 10.5}),
    ),
    notes=(
        "Displacements add; the force of a chain is that of one muscle. Paper 1's total F_ce is a sum of coefficients.",
        "Muscles of other kinds, with steps and delays of their own: pmabench model cascade.",
    ),
)  # fmt: skip
def cascade(
    time: Array, count: Array, pressure: Array, pressure_step: Array, delay: Array, hold: Array, load: Array,
    fce_at: str,
) -> Values:  # fmt: skip
    """Sums [1, m, N] and forces [N] from t [s], N [1], P and P_step [Pa gauge], delay and hold [s], L [N]."""
    inputs = (time, count, pressure, pressure_step, delay, hold, load)
    time, count, pressure, pressure_step, delay, hold, load = np.broadcast_arrays(*inputs)
    _whole(count)
    shape, most = time.shape, int(np.max(count))
    ratio, x, F_ce, S = (np.zeros((most, *shape)) for _ in range(4))
    for index in range(most):
        there = index < count
        own = np.where(there, pressure + index * pressure_step, pressure)
        tau = dmsp_40_305(own, "polynomial")
        radius, length, angle = map(np.asarray, DMSP_SHAPE)
        muscle = dmsp_40_305_contraction(own, load, radius, length, angle, fce_at)
        since = time - index * delay
        risen = -np.expm1(-np.clip(since, 0, hold) / tau["tau_contract"])
        ratio[index] = there * risen * np.exp(-np.maximum(since - hold, 0) / tau["tau_relax"])
        x[index], S[index] = ratio[index] * muscle["displacement"], muscle["stiffness"]
        F_ce[index] = there * (since >= 0) * (since < hold) * muscle["force_ce"]
    total = x.sum(axis=0)
    force = held_force(F_ce.reshape(most, -1), S.reshape(most, -1), np.full(most, DMSP_SHAPE[1]), total.ravel())
    return {
        "sum": ratio.sum(axis=0), "displacement": total, "force_ce_sum": F_ce.sum(axis=0),
        "force_ce": F_ce.max(axis=0), "force": force.reshape(shape),
    }  # fmt: skip


@described(
    "ultimate-gain", "loop", "Ultimate gain and period of a proportional loop with dead time and two lags",
    equation=(
        "w L + atan(w T_1) + atan(w T_2) = pi;  K_u k_g = sqrt(1 + (w T_1)^2) sqrt(1 + (w T_2)^2);  T_u = 2 pi / w",
        "L = dead time + half a sample period (hold)",
    ),
    source="Ziegler and Nichols 1942; the check on paper 0's tuning",
    parameters=(
        Parameter("dead_time", "L", "time", 0.04, "dead time", 0.0, above=True),
        Parameter("lag_regulator", "T_1", "time", 0.22, "lag of the regulator", 0.0),
        Parameter("lag_muscle", "T_2", "time", 0.25, "B / K of the muscle", 0.0),
        Parameter("sample_period", "T_s", "time", 0.0, "sample period of the loop", 0.0),
    ),
    outputs=(
        Output("loop_gain", "K_u k_g", "count", "ultimate gain times the plant's gain"),
        Output("period", "T_u", "time", "ultimate period"),
    ),
    references=(
        Reference("loop_gain", "12.427", "", 1.0, "computed from the equations"),
        Reference("period", "0.4361", "s", 1.0, "the same"),
        Reference("loop_gain", "9.464", "", 1.0, "the same", {"lag_regulator": 0.0955}),
        Reference("period", "0.3426", "s", 1.0, "the same", {"lag_regulator": 0.0955}),
        Reference("loop_gain", "9.003", "", 1.0, "the same", {"lag_muscle": 0.11}),
        Reference("period", "0.3503", "s", 1.0, "the same", {"lag_muscle": 0.11}),
        Reference("loop_gain", "18.785", "", 1.0, "the same", {"lag_muscle": 0.50}),
        Reference("period", "0.4989", "s", 1.0, "the same", {"lag_muscle": 0.50}),
    ),
    notes=(
        "Paper 0's T_c = 9 s cannot come from a linear loop of this kind: it would take 2 to 4 s of dead time.",
        "Paper 0 prints PI gains 2.195 and 3; its own table makes 3.195 and 7.5 s of K_c = 7.1, T_c = 9 s: see tune.",
    ),
)  # fmt: skip
def ultimate_gain(dead_time: Array, lag_regulator: Array, lag_muscle: Array, sample_period: Array) -> Values:
    """K_u k_g [1] and T_u [s] from L, T_1, T_2 and T_s [s]."""

    def found(L: float, *lags: float) -> tuple[float, float]:
        pair = ultimate(Loop(1.0, L, tuple(lag for lag in lags if lag > 0)))
        return pair.gain, pair.period

    try:
        gain, period = np.vectorize(found, otypes=[float] * 2)(dead_time + sample_period / 2, lag_regulator, lag_muscle)
    except ValueError:
        refuse("dead_time", "it is too short to matter next to the lags: two lags alone never oscillate")
        raise
    return {"loop_gain": gain, "period": period}
