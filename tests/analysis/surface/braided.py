"""A muscle of braid and rubber after published forms, written for these tests: surface, stops, chain of creep.

Knows nothing of the code that it judges; SI. The surface is a form after Sarosi with six constants fitted to a maker's
table of a 20 mm muscle of 250 mm; friction is a row of Maxwell slip elements, creep a chain of Kelvin elements.
"""

import numpy as np

RADII, SHARES = np.array([0.2e-3, 0.8e-3, 2.5e-3, 8e-3]), np.array([0.2, 0.3, 0.3, 0.2])
RADII_P, SHARES_P = np.array([20e3, 100e3]), np.array([0.4, 0.6])
TIMES = np.array([0.5, 1.58, 5.0, 15.8, 50.0, 158.0])
FULL = 1518.4


def surface(x, P):
    kappa, kPa = x / 2.5e-3, P / 1e3
    return (244.7 - 0.1115 * kPa) * np.exp(-0.334 * kappa) - 0.0830 * kappa * kPa + 2.650 * kPa - 249.4


def stiffness(x, P):
    kappa, kPa = x / 2.5e-3, P / 1e3
    return (0.334 * (244.7 - 0.1115 * kPa) * np.exp(-0.334 * kappa) + 0.0830 * kPa) / 2.5e-3


def half_gap(P):
    return 5.0 + 0.05 * P / 1e3


class Braided:
    """A muscle that remembers: `drive` it along one trial after the other."""

    def __init__(self, *, hysteresis=True, creep=True, viscous=True):
        self.hysteresis, self.creep, self.viscous = hysteresis, creep, viscous
        self.slip, self.slip_P = np.zeros(4), -RADII_P.copy()
        self.crept = np.zeros(6)
        self.x, self.P = 0.0, 0.0

    def drive(self, t, x, P):
        """Force [N] at the times of a trial; between trials the muscle goes straight there within 5 s."""
        self._go(np.linspace(self.x, x[0], 101), np.linspace(self.P, P[0], 101), np.full(101, 0.05))
        return self._go(x, P, np.diff(t, prepend=t[0] - (t[1] - t[0])), np.gradient(x, t))

    def _go(self, x, P, steps, v=0.0):
        slip, slip_P, crept = np.empty((len(x), 4)), np.empty((len(x), 2)), np.empty((len(x), 6))
        ways, ways_P = np.diff(x, prepend=self.x), np.diff(P, prepend=self.P)
        decays = np.exp(-steps[:, None] / TIMES)
        for i in range(len(x)):
            self.slip = np.minimum(RADII, np.maximum(-RADII, self.slip + ways[i]))
            self.slip_P = np.minimum(RADII_P, np.maximum(-RADII_P, self.slip_P + ways_P[i]))
            self.crept = decays[i] * self.crept + (1 - decays[i]) * 0.004 * x[i]
            slip[i], slip_P[i], crept[i] = self.slip, self.slip_P, self.crept
        self.x, self.P = float(x[-1]), float(P[-1])
        F = surface(x - self.creep * crept.sum(axis=1), P)
        F -= self.hysteresis * (half_gap(P) * (slip / RADII @ SHARES) + 18.0 * (slip_P / RADII_P @ SHARES_P))
        B = np.where(np.asarray(v) > 0, 1000 + 2.0 * P / 1e3, 700 + 1.5 * P / 1e3)
        return F - self.viscous * B * v
