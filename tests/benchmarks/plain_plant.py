"""The plant of `paper0-air` as anyone would build it: one system of six equations for LSODA; knows nothing of ours.

States: contraction x, its rate v, bristle z of the friction (LuGre, with the straight fall from F_s to F_c), pressure P
in the muscle, regulator's pressure u and its rate. `odeint` is restarted at every command and load, and runs through
rest too. It stands for "the plant alone" where our own plant would be compared with itself.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.integrate import odeint

BRISTLE, BRISTLE_DAMPING = 1e6, 2e3
"""Of the friction before it slides [N/m, N.s/m]: stuck, the muscle gives by 10 um at most."""
SUPPORT, SUPPORT_DAMPING = 1e8, 1e5
"""Of what carries the load at no contraction [N/m, N.s/m]."""
RTOL = 1e-6
SCALE = np.array([1.0, 0.01, 1.0, 1.5e-7, 1.5e-7, 1.5e-8])
"""What each state is multiplied by, so that one tolerance fits all: 1 um is worth 7 Pa."""


def plain(setup, events, end, rate):
    """Contraction [m] at `rate` [Hz] up to `end` [s]; `events` are (moment [s], "command" or "load", values)."""
    muscle, air, regulator = setup.muscle, setup.air, setup.regulator
    f_ce, stiffness, B_c, B_r = (curve.function() for curve in (muscle.F_ce, muscle.K, muscle.B_c, muscle.B_r))
    F_s, F_c, slope = muscle.friction.F_s, muscle.friction.F_c, muscle.friction.slope
    w, zeta = 2 * math.pi * regulator.natural_frequency, regulator.damping_ratio
    size, braid, long = muscle.sizes
    length, k, room = muscle.length, air.polytropic, air.atmosphere
    fill, vent = (k * air.rT * flow for flow in (air.fill, air.vent))
    x_, v_, z_, P_, u_, r_ = SCALE.tolist()

    def rates(y, t, wave, force, mass):
        x, v, z, P, u, r = y[0] / x_, y[1] / v_, y[2] / z_, y[3] / P_, y[4] / u_, y[5] / r_
        speed = abs(v)
        slip = v - speed * BRISTLE * z / max(F_c, F_s - slope * speed)
        friction = BRISTLE * z + BRISTLE_DAMPING * slip
        support = max(0.0, -SUPPORT * x - SUPPORT_DAMPING * v) if x < 0 else 0.0
        pull = f_ce(P) - stiffness(P) * x - (B_c if v > 0 else B_r)(P) * v - friction
        left = 1 - max(x, 0.0) / length
        shape = long * left * left
        V = size * left * (braid - shape)
        flow = (fill if u > P else vent) * (u - P) - k * (P + room) * size / length * (3 * shape - braid) * v
        aim = wave.level + wave.slope * (t - wave.start)
        return (
            v * x_, (pull - force + support) / mass * v_, slip * z_,
            flow / V * P_, r * u_, (w * w * (aim - u) - 2 * zeta * w * r) * r_,
        )  # fmt: skip

    late = regulator.dead_time
    waves = [one._replace(start=one.start + late) for _, name, given in events if name == "command" for one in given[0]]
    loads = [(moment, given) for moment, name, given in events if name == "load"]
    edges = sorted({0.0, end, *(wave.start for wave in waves if wave.start < end), *(t for t, _ in loads if t < end)})
    state, parts = np.zeros(6), []
    for begin, stop in pairwise(edges):
        while waves[1:] and waves[1].start <= begin:
            waves.pop(0)
        while loads[1:] and loads[1][0] <= begin:
            loads.pop(0)
        wave = waves[0] if waves[0].start <= begin else waves[0]._replace(level=0.0, slope=0.0)
        load = loads[0][1] if loads[0][0] <= begin else (0.0, 2.0)
        due = np.arange(math.ceil(begin * rate - 1e-6), math.ceil(stop * rate - 1e-6)) / rate - begin
        wave = wave._replace(start=wave.start - begin)
        later = due[(due > 1e-6) & (due < stop - begin - 1e-6)]
        times = np.concatenate(([0.0], later, [stop - begin]))
        y = odeint(rates, state, times, args=(wave, *load), rtol=RTOL, atol=RTOL * 1e-2, mxstep=100000)
        state = y[-1]
        parts.append(y[np.searchsorted(times, due - 1e-6), 0])
    return np.concatenate(parts)
