"""A sliding muscle with its load: the equation of motion for LSODA, and one implicit step; knows no rest and no stops.

Both solve M x'' = F_ce(P) - K(P) x - B(P) x' - friction - F_L for motion in one direction; the damping of that
direction goes on beyond x' = 0, so that whoever calls can find the turning point. Speeds at which the friction falls
with speed are for `glide` only: nothing grows faster there than a stiff solver's errors.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import odeint

from pmabench.model.curve import Array
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.regulator import FADED, Trace

RELATIVE = 1e-7
ABSOLUTE = 5e-9
TIME = 0.01
"""Error tolerances of LSODA per step, absolute in contraction [m] and in speed times `TIME` [s]."""
SETTLED_PRESSURE = 1e-3
"""Worth less than 1 nm of contraction [Pa]."""

FARTHEST = 100.0
"""A speed that grows is followed over so many of its time constants at once [1]."""
FELT, APART = 1e-6, 1e-6
"""Least effect of the spring within a step, and least distance of two exponents, both as shares [1]."""
EXACT, SHORTEST = 1e-9, 1e-12
"""A speed is met within this share of itself [1], or of the moment [s]."""

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
    pressure = trace.function() if trace.modes else None
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
        if pressure is not None:
            P = pressure(since)
        else:
            P = level + ramp * since
            if decay:
                P += decay * exp(-since / lag)
            if omega:
                P += sin_part * sin(omega * since) + cos_part * cos(omega * since)
        result[0] = v
        result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - hold) * scale
        return result

    def swinging(y: State, since: float) -> State:
        x, w = y.tolist()
        v = w / TIME
        turn = omega * since
        P = level + (sin_part * sin(turn) + cos_part * cos(turn))
        result[0] = v
        result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - hold) * scale
        return result

    if trace.settled(t, SETTLED_PRESSURE):
        pull, K, B = f_ce(level) - hold, stiffness(level), damping(level)
        return steady
    faded = not decay or t - trace.start > FADED * lag
    return swinging if omega and faded and not ramp and pressure is None else moving


def slide(
    muscle: Muscle, trace: Trace, way: int, load: tuple[float, float], state: tuple[float, float], t: Array
) -> tuple[Array, Array]:
    """Contraction [m] and speed [m/s] at times t [s] by LSODA, from `state` (x, v) at t[0] on; `load` is (F_L, M)."""
    acceleration = equation(muscle, trace, way, *load, float(t[0]))
    start = (state[0], state[1] * TIME)
    y = odeint(acceleration, start, t - trace.start, rtol=RELATIVE, atol=ABSOLUTE, mxstep=100000)
    return y[:, 0], y[:, 1] / TIME


def glide(
    friction: Friction, h: float, speed: float, drive: tuple[float, float], linear: tuple[float, float], mass: float
) -> tuple[float, float, float]:
    """Slide for at most h [s] under M u' = drive - K s - B u - friction(u), s' = u >= 0, exactly.

    `drive` is its value now [N] and its rate [N/s], `linear` are B [N.s/m] and K [N/m]. Inside each of the two straight
    parts of the friction s is a straight line and two exponentials: no mass and no damping make it unstable, and what
    grows is not lost.

    Returns
    -------
    tuple
        Way gone [m], speed at the end [m/s], time left when the speed came to 0 [s] (else 0).
    """
    gone, left, (push, rate), (damping, stiffness) = 0.0, h, drive, linear
    knee = friction.knee
    for _ in range(6):
        if left <= 0:
            break
        fast = speed > knee or (speed == knee and push - friction.F_c >= damping * speed)
        resist, b = (friction.F_c, damping) if fast else (friction.F_s, damping - friction.slope)
        low, high = (knee, math.inf) if fast else (0.0, knee)
        near, far, level, line, A, B = _course(push - resist, rate, b, stiffness, mass, speed, left)
        exp: Callable[[Any], Any] = math.exp if isinstance(far, float) else cmath.exp
        duration = left if far.real * left < FARTHEST else FARTHEST / far.real
        near_end, far_end = A * exp(near * duration), B * exp(far * duration)
        end = (line + near * near_end + far * far_end).real
        bound = high if end > high else low if end < low else None
        if bound is not None and speed == bound:  # it cannot leave this way: it stays on the bound
            return gone + bound * left, bound, 0.0
        if bound is not None:
            begin, off, last, beyond = 0.0, speed - bound, duration, end - bound
            for _ in range(40):  # regula falsi, the end that stays for the second time counting half
                duration = last - beyond * (last - begin) / (beyond - off)
                near_end, far_end = A * exp(near * duration), B * exp(far * duration)
                error = (line + near * near_end + far * far_end).real - bound
                if (error > 0) == (beyond > 0):
                    last, beyond, off = duration, error, 0.5 * off
                else:
                    begin, off, beyond = duration, error, 0.5 * beyond
                if abs(error) < EXACT * (knee + speed) or last - begin < SHORTEST:
                    break
            end = bound
        way = (level + line * duration + near_end + far_end).real
        gone, speed, left = gone + way, end, left - duration
        push += rate * duration - stiffness * way
        if bound == 0:
            return gone, 0.0, max(left, 0.0)
    return gone, speed, 0.0


def _course(
    push: float, rate: float, b: float, stiffness: float, mass: float, speed: float, h: float
) -> tuple[complex, complex, float, float, complex, complex]:
    """S = level + line t + A exp(near t) + B exp(far t) of M s'' = push + rate t - b s' - stiffness s for `h` [s].

    From s = 0, s' = `speed`. Returns near, far [1/s], level [m], line [m/s], A, B [m]. A spring that is too weak to
    be felt within h counts as one that is felt by a millionth, and equal exponents as apart by as much.
    """
    K = max(stiffness, FELT * (abs(b) + mass / h) / h)
    half = 0.5 * b / mass
    square = half * half - K / mass
    root = math.sqrt(square) if square > 0 else cmath.sqrt(square)
    if abs(root) < APART * abs(half):
        root = APART * abs(half)
    far = -half - root if half >= 0 else root - half
    near = K / mass / far
    line = rate / K
    level = (push - b * line) / K
    B = (speed - line + level * near) / (far - near)
    return near, far, level, line, -level - B, B
