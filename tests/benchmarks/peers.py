"""The straight form of a muscle by other fitting programs: scipy's `curve_fit`, lmfit and `mujoco.sysid`; SI.

    F = F_ce(P) - K(P) x - B(P) x' - F_c sign(x')

For the first two F_ce and K are polygons over pressure, B a straight line for each direction; in MuJoCo it is an actuator
whose gain and bias are straight lines in length and velocity, so that coefficients are straight lines over pressure and B
has one value for both directions. Intervals are what each program says: 1.96 standard errors. Imports nothing of pmabench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import lmfit
import mujoco
import numpy as np
from mujoco import rollout, sysid
from numpy.typing import NDArray
from scipy.optimize import curve_fit

Array = NDArray[np.float64]
NORMAL = 1.96
LEAST = 1e-6
"""Size of a column, over the median of all, below which it is left out."""
ITERATIONS = 6
"""Of `mujoco.sysid`: from the fourth on the sum of squares fell by less than 1e-4 of itself."""


@dataclass(frozen=True)
class Rows:
    """Pressure [Pa], contraction [m], its rate [m/s] and force [N]; shape (n,)."""

    P: Array
    x: Array
    v: Array
    F: Array


@dataclass(frozen=True)
class Fitted:
    """What a program made of rows."""

    force: Callable[[Rows], Array]
    """Force [N] that it predicts."""
    value: Callable[[Array], tuple[float, float]]
    """A linear combination of the unknowns and its half width."""
    row: Callable[[str, float], Array]
    """What the unknowns are to be multiplied by for K, F_ce, B_c or B_r at a pressure [Pa]."""


def straight(P: Array, x: Array, v: Array, knots: Array) -> Array:
    """Columns of the straight form, shape (n, 2 len(knots) + 5)."""
    hats, ends = (_hats(P, one) for one in (knots, knots[[0, -1]]))
    up, down = np.maximum(v, 0.0)[:, None], np.minimum(v, 0.0)[:, None]
    return np.hstack([hats, -hats * x[:, None], -ends * up, -ends * down, -np.sign(v)[:, None]])


def _hats(P: Array, knots: Array) -> Array:
    return np.column_stack([np.interp(P, knots, one) for one in np.eye(len(knots))])


def straight_row(knots: Array) -> Callable[[str, float], Array]:
    """`Fitted.row` of `straight`."""

    def row(symbol: str, P: float) -> Array:
        parts = {"F_ce": knots, "K": knots, "B_c": knots[[0, -1]], "B_r": knots[[0, -1]]}
        at = np.array([P])
        return np.concatenate([*(_hats(at, of)[0] * (name == symbol) for name, of in parts.items()), [0.0]])

    return row


def by_curve_fit(A: Array, F: Array) -> tuple[Array, Array]:
    """Weights of columns and their covariance, by `scipy.optimize.curve_fit`."""

    def solve(A: Array) -> tuple[Array, Array]:
        start = np.zeros(A.shape[1])
        return curve_fit(lambda _, *w: A @ np.array(w), np.arange(len(F)), F, start, jac=lambda _, *w: A)

    return _scaled(A, solve)


def by_lmfit(A: Array, F: Array) -> tuple[Array, Array]:
    """The same by `lmfit.minimize` (Levenberg-Marquardt), one named parameter for each column."""

    def solve(A: Array) -> tuple[Array, Array]:
        parameters = lmfit.Parameters()
        for n in range(A.shape[1]):
            parameters.add(f"w{n}", value=0.0)

        def left(parameters: lmfit.Parameters) -> Array:
            return A @ np.array(list(parameters.valuesdict().values())) - F

        done = lmfit.minimize(left, parameters, Dfun=lambda _: A)
        found = np.array([parameter.value for parameter in done.params.values()])
        return found, done.covar if done.errorbars else np.full((len(found), len(found)), np.nan)

    return _scaled(A, solve)


def _scaled(A: Array, solve: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
    """Columns of equal size, without those that hardly any row has: their weight is 0, their covariance unknown."""
    size = np.sqrt(np.mean(A**2, axis=0))
    used = size > LEAST * np.median(size)
    weights, covariance = np.zeros(len(size)), np.full((len(size), len(size)), np.nan)
    weights[used], covariance[np.ix_(used, used)] = solve(A[:, used] / size[used])
    size[~used] = 1.0
    return weights / size, covariance / np.outer(size, size)


def half_width(row: Array, covariance: Array) -> float:
    """Of a combination of weights, 95 %; nan where a weight in it is not known."""
    used = row != 0
    variance = row[used] @ covariance[np.ix_(used, used)] @ row[used]
    return NORMAL * float(np.sqrt(max(variance, 0.0))) if np.isfinite(variance) else np.nan


def linear(
    solve: Callable[[Array, Array], tuple[Array, Array]], columns: Callable[[Rows], Array], rows: Rows,
    row: Callable[[str, float], Array],
) -> Fitted:  # fmt: skip
    """A fit that is linear in its unknowns."""
    weights, covariance = solve(columns(rows), rows.F)
    return Fitted(lambda other: columns(other) @ weights, _valued(weights, covariance), row)


def _valued(weights: Array, covariance: Array) -> Callable[[Array], tuple[float, float]]:
    return lambda row: (float(row @ weights), half_width(row, covariance))


# -- MuJoCo --------------------------------------------------------------------------------------------------------

UNITS = np.array([100.0, 1e-3, 1e4, 0.1, 1e3, 1e-2, 10.0])
"""What the unknowns are counted in: of F_ce [N], [N/Pa], K [N/m], [N/m/Pa], B [N s/m], [N s/m/Pa], F_c [N]."""
START = np.array([0.0, 2.0, 1.0, 0.2, 2.0, 0.1, 1.0])
LIMITS = (np.array([-5.0, 0.0, -2.0, -1.0, 0.0, -0.5, 0.0]), np.array([5.0, 5.0, 10.0, 2.0, 10.0, 2.0, 10.0]))
MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.80665" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="0 0 1" limited="true" range="0 1" frictionloss="1"/>
      <geom type="sphere" size="0.01" mass="{mass}" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <general name="muscle" joint="x" gaintype="affine" biastype="affine" gainprm="0 0 0" biasprm="0 0 0"/>
  </actuator>
  <sensor><jointpos joint="x"/></sensor>
</mujoco>
"""


def muscle_model(mass: float, step: float) -> mujoco.MjModel:
    """A weight [kg] that hangs from an actuator and lies on a support, in steps of `step` [s]."""
    return mujoco.MjModel.from_xml_string(MODEL.format(mass=mass, step=step))


def put(model: mujoco.MjModel, unknowns: Array) -> None:
    """Set the actuator and the friction to unknowns in `UNITS`."""
    F0, F1, K0, K1, B0, B1, friction = unknowns * UNITS
    model.actuator_gainprm[0, :3] = F1, -K1, -B1
    model.actuator_biasprm[0, :3] = F0, -K0, -B0
    model.dof_frictionloss[0] = friction


def parameters() -> sysid.ParameterDict:
    """The unknowns as one parameter of `mujoco.sysid`."""
    return sysid.ParameterDict({"muscle": sysid.Parameter("muscle", START, *LIMITS)})


def optimized(residual: Callable[[Array], Array]) -> Fitted:
    """The unknowns for which `residual` of them is least, by `mujoco.sysid`, with its own covariance."""

    def several(unknowns: Array, _: object) -> tuple[list[Array], None, None]:
        if unknowns.ndim == 1:
            return [residual(unknowns)], None, None
        return [np.column_stack([residual(one) for one in unknowns.T])], None, None

    found, result = sysid.optimize(parameters(), several, optimizer="mujoco", verbose=False, max_iters=ITERATIONS)
    unknowns = found.as_vector()
    left = residual(unknowns)
    covariance = left @ left / (len(left) - len(unknowns)) * np.linalg.pinv(result.jac.T @ result.jac)
    weights, covariance = unknowns * UNITS, covariance * np.outer(UNITS, UNITS)

    def columns(rows: Rows) -> Array:
        one = np.ones_like(rows.P)
        return np.column_stack([one, rows.P, -rows.x, -rows.P * rows.x, -rows.v, -rows.P * rows.v, -np.sign(rows.v)])

    def row(symbol: str, P: float) -> Array:
        at = np.zeros(len(UNITS))
        start = 2 * ("F_ce", "K", "B_c", "B_r").index(symbol.replace("B_r", "B_c"))
        at[start : start + 2] = 1.0, P
        return at

    return Fitted(lambda rows: columns(rows) @ weights, _valued(weights, covariance), row)


def by_sysid_hanging(masses: Sequence[float], P: Sequence[Array], x: Sequence[Array], step: float) -> Fitted:
    """Weights that hang: the simulated contraction over a whole trial against the recorded one."""
    models = [muscle_model(mass, step) for mass in masses]
    data = mujoco.MjData(models[0])
    states = []
    for model in models:
        mujoco.mj_resetData(model, data)
        state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states.append(state)
    commands, recorded = np.array(P)[:, :-1, None], np.array(x)[:, 1:]

    def residual(unknowns: Array) -> Array:
        for model in models:
            put(model, unknowns)
        _, sensors = rollout.rollout(models, data, np.array(states), commands)
        return 1e3 * np.asarray(sensors[:, :, 0] - recorded).ravel()

    return optimized(residual)


def by_sysid_driven(rows: Rows) -> Fitted:
    """A driven end: the force of the actuator at each recorded place, with the friction by the sense of motion."""
    model = muscle_model(1.0, 2e-3)
    data = mujoco.MjData(model)

    def residual(unknowns: Array) -> Array:
        put(model, unknowns)
        force = np.empty_like(rows.F)
        for n, (P, x, v) in enumerate(zip(rows.P.tolist(), rows.x.tolist(), rows.v.tolist(), strict=True)):
            data.qpos[0], data.qvel[0], data.ctrl[0] = x, v, P
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            force[n] = data.actuator_force[0]
        return 0.1 * (force - unknowns[-1] * UNITS[-1] * np.sign(rows.v) - rows.F)

    return optimized(residual)
