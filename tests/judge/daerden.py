"""Driven sines of the static part of plant 5.5, the modified Daerden muscle: the force is a formula of the contraction.

F = S(eps) P + A eps (eps - B1)/(eps + B2), S = pi/4 D0^2 (3 (1 - eps)^alpha/tan^2 theta0 - 1/sin^2 theta0); nearly
without damping, with a constant friction where one is asked for.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial

DIAMETER, LENGTH, ANGLE, ALPHA = 20e-3, 200e-3, np.radians(25.0), 2.6
A, B1, B2 = 800.0, 0.22, 0.04
DAMPING = 50.0
"""[N s/m]"""
RATE = 500.0
PLAN = ((0.2, 3), (0.5, 4), (1.0, 6))
"""Frequency [Hz] and cycles."""
NOISE = {"pressure": 500.0, "displacement": 2e-6, "force": 0.3}


def force(x: Array | float, P: float) -> Array:
    """Force [N] at a contraction [m] and a gauge pressure [Pa]."""
    eps = np.asarray(x) / LENGTH
    section = np.pi / 4 * DIAMETER**2 * (3 * (1 - eps) ** ALPHA / np.tan(ANGLE) ** 2 - 1 / np.sin(ANGLE) ** 2)
    return np.asarray(section * P + A * eps * (eps - B1) / (eps + B2))


def stiffness(x: float, P: float) -> float:
    """-dF/dx [N/m], differentiated by hand."""
    eps = x / LENGTH
    braid = -np.pi / 4 * DIAMETER**2 * 3 * ALPHA * (1 - eps) ** (ALPHA - 1) / np.tan(ANGLE) ** 2 * P
    rubber = A * ((2 * eps - B1) * (eps + B2) - eps * (eps - B1)) / (eps + B2) ** 2
    return float(-(braid + rubber) / LENGTH)


def campaign(
    P: float, mean: float, amplitude: float, seed: int, friction: float = 0.0, repeats: int = 2
) -> list[Trial]:
    """Sines of one mean and amplitude [m] at a pressure [Pa]; chance is drawn from the seed."""
    chance = np.random.default_rng([seed, round(P), round(1e6 * mean), round(1e6 * amplitude)])
    trials, since = [], 0.0
    for repeat in range(repeats):
        for frequency, cycles in PLAN:
            t = np.arange(round(cycles / frequency * RATE)) / RATE
            turn = 2 * np.pi * frequency * t
            x, v = mean + amplitude * np.sin(turn), 2 * np.pi * frequency * amplitude * np.cos(turn)
            pull = force(x, P) - DAMPING * v - friction * np.sign(v)
            read = {
                name: one + NOISE[name] * chance.standard_normal(len(t))
                for name, one in (("pressure", np.full(len(t), P)), ("displacement", x), ("force", pull))
            }
            point = {
                "pressure": P,
                "frequency": frequency,
                "mean": mean,
                "amplitude": amplitude,
                "cycles": float(cycles),
            }
            trials.append(
                Trial(point, repeat, since + t, read, (Ramp(since, "displacement", mean, mean, "sine", 0.0),))
            )
            since += float(t[-1]) + 5.0
    return trials
