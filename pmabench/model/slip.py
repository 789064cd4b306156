"""A sliding muscle with its load: the equation of motion for LSODA, and one implicit step; knows no rest and no stops.

Both solve M x'' = F_ce(P) - K(P) x - B(P) x' - friction - F_L for motion in one direction; the damping of that
direction goes on beyond x' = 0, so that whoever calls can find the turning point. Speeds at which the friction falls
with speed are for `glide` only: nothing grows faster there than a stiff solver's errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import odeint

from pmabench.model.curve import Array
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.regulator import Trace

RELATIVE = 1e-7
ABSOLUTE = 5e-9
TIME = 0.01
"""Error tolerances of LSODA per step, absolute in contraction [m] and in speed times `TIME` [s]."""
SETTLED_PRESSURE = 1e-3
"""Worth less than 1 nm of contraction [Pa]."""

State = np.ndarray[tuple[int], np.dtype[np.float64]]


def equation(
    muscle: Muscle, trace: Trace, way: int, force: float, mass: float, t: float
) -> Callable[[State, float], State]:
    """Right-hand side over (x [m], x' TIME [m]) and s = t - trace.start [s], for motion towards `way` (+1, -1).

    Friction is F_c throughout: only sliding faster than the knee of the friction is meant.
    `force` F_L [N] and `mass` M [kg] of the load; pressure follows `trace` [Pa], to be used from `t` [s] on: once it
    is within a thousandth of a pascal of its end value it counts as constant.
    """
    f_ce, stiffness = muscle.F_ce.function(), muscle.K.function()
    damping = (muscle.B_c if way > 0 else muscle.B_r).function()
    hold = force + way * muscle.friction.F_c
    level, ramp, decay, lag = trace.level, trace.slope, trace.decay, trace.lag
    omega, sin_part, cos_part = trace.omega, trace.sin_part, trace.cos_part
    result = np.empty(2)
    scale = TIME / mass
    exp, sin, cos = math.exp, math.sin, math.cos

    def steady(y: State, since: float) -> State:
        x, w = y.tolist()
        v = w / TIME
        result[0] = v
        result[1] = (pull - K * x - B * v) * scale
        return result

    def moving(y: State, since: float) -> State:
        x, w = y.tolist()
        v = w / TIME
        P = level + ramp * since
        if decay:
            P += decay * exp(-since / lag)
        if omega:
            P += sin_part * sin(omega * since) + cos_part * cos(omega * since)
        result[0] = v
        result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - hold) * scale
        return result

    if trace.settled(t, SETTLED_PRESSURE):
        pull, K, B = f_ce(level) - hold, stiffness(level), damping(level)
        return steady
    return moving


def slide(
    muscle: Muscle, trace: Trace, way: int, load: tuple[float, float], state: tuple[float, float], t: Array
) -> tuple[Array, Array]:
    """Contraction [m] and speed [m/s] at times t [s] by LSODA, from `state` (x, v) at t[0] on; `load` is (F_L, M)."""
    acceleration = equation(muscle, trace, way, *load, float(t[0]))
    start = (state[0], state[1] * TIME)
    y = odeint(acceleration, start, t - trace.start, rtol=RELATIVE, atol=ABSOLUTE, mxstep=100000)
    return y[:, 0], y[:, 1] / TIME


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
