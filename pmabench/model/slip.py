"""A sliding muscle with its load: the equation of motion for LSODA, and one implicit step; knows no rest and no stops.

Both solve M x'' = F_ce(P) - K(P) x - B(P) x' - friction - F_L for motion in one direction: the damping of that
direction and the friction are carried smoothly beyond x' = 0, so that whoever calls can find the turning point.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import odeint

from pmabench.model.curve import Array
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.regulator import Trace

RELATIVE = 1e-6
ABSOLUTE = 1e-9
"""Error tolerances of LSODA, per step, of contraction [m] and speed [m/s]."""
SETTLED_PRESSURE = 1e-3
"""Worth less than 1 nm of contraction [Pa]."""

State = np.ndarray[tuple[int], np.dtype[np.float64]]


def equation(
    muscle: Muscle, trace: Trace, way: int, force: float, mass: float, t: float
) -> Callable[[State, float], State]:
    """Right-hand side (x', x'') over (x [m], v [m/s]) and s = t - trace.start [s], for motion towards `way` (+1, -1).

    `force` F_L [N] and `mass` M [kg] of the load; pressure follows `trace` [Pa], to be used from `t` [s] on: once it
    is within a thousandth of a pascal of its end value it counts as constant.
    """
    f_ce, stiffness = muscle.F_ce.function(), muscle.K.function()
    damping = (muscle.B_c if way > 0 else muscle.B_r).function()
    friction = muscle.friction
    f_s, f_c, slope, knee = friction.F_s, friction.F_c, friction.slope, friction.knee
    start, level, decay, lag = trace.start, trace.level, trace.decay, trace.lag
    result = np.empty(2)
    exp = math.exp

    def steady(y: State, since: float) -> State:
        x, v = y.tolist()
        u = way * v
        resist = f_c if u >= knee else f_s if u <= 0 else f_s - slope * u
        result[0] = v
        result[1] = (pull - K * x - B * v - way * resist) / mass
        return result

    def moving(y: State, since: float) -> State:
        x, v = y.tolist()
        P = level + decay * exp(-since / lag) if settling else trace.value(start + since)
        u = way * v
        resist = f_c if u >= knee else f_s if u <= 0 else f_s - slope * u
        result[0] = v
        result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - way * resist - force) / mass
        return result

    settling = trace.slope == 0 and trace.omega == 0
    if settling and abs(trace.value(t) - level) < SETTLED_PRESSURE:
        pull, K, B = f_ce(level) - force, stiffness(level), damping(level)
        return steady
    return moving


def slide(
    muscle: Muscle, trace: Trace, way: int, load: tuple[float, float], state: tuple[float, float], t: Array
) -> tuple[Array, Array]:
    """Contraction [m] and speed [m/s] at times t [s], from `state` (x, v) at t[0] on; `load` is (F_L [N], M [kg])."""
    y = odeint(
        equation(muscle, trace, way, *load, float(t[0])),
        state,
        t - trace.start,
        rtol=RELATIVE,
        atol=ABSOLUTE,
        mxstep=100000,
    )
    return y[:, 0], y[:, 1]


def glide(
    friction: Friction, h: float, speed: float, drive: float, damping: float, mass: float
) -> tuple[float, float, float]:
    """Slide for at most h [s] under M u' = drive - damping u - friction(u), u >= 0, exactly.

    Inside each of the two straight parts of the friction the solution is an exponential, and so is the moment at which
    it leaves that part: no mass and no damping make it unstable.

    Returns
    -------
    tuple
        Way gone [m], speed at the end [m/s], time left when the speed came to 0 [s] (else 0).
    """
    gone, left = 0.0, h
    knee = friction.knee
    for _ in range(4):
        fast = speed > knee or (speed == knee and drive - friction.F_c >= damping * speed)
        resist, b = (friction.F_c, damping) if fast else (friction.F_s, damping - friction.slope)
        low, high = (knee, math.inf) if fast else (0.0, knee)
        b = b if abs(b) > 1e-9 else 1e-9
        final, rate = (drive - resist) / b, b / mass
        rising = drive - resist > b * speed
        bound = high if rising else low
        duration, crosses = left, False
        if bound != math.inf and final != speed:
            ratio = (bound - final) / (speed - final)
            if ratio > 0:
                arrival = -math.log(ratio) / rate
                if 0 <= arrival < left:
                    duration, crosses = arrival, True
        fade = math.expm1(-rate * duration)
        gone += final * duration - (speed - final) * fade / rate
        speed = bound if crosses else max(0.0, speed + (speed - final) * fade)
        left -= duration
        if not crosses:
            return gone, speed, 0.0
        if speed == 0:
            return gone, 0.0, left
    return gone, speed, 0.0
