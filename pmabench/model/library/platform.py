"""A platform tilted by three muscles about a joint with two axes: pose, moments and stiffness.

It turns by phi about the x axis, which is fixed to the base, then by psi about its own y axis. The muscles are anchored
on a circle at 90, 210 and 330 deg and hang vertically while it is level. Paper 3 prints the chain of computations but
no dimensions: all numbers are assumed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, BRAID_ANGLE, DEG, MM
from pmabench.model.library.daerden import ALPHA, ASSUMED, B1, B2, DIAMETER, LENGTH, A, rubber_force, section_factor
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse

FAMILY = "platform"
SOURCE = "paper 3 names the chain; geometry and numbers are assumed"
BY_HAND = "computed from the equations, by another program"
STEEPEST = 24 * DEG
"""Angle of the mechanical stops [rad]."""
LEAST, MOST = -0.03, 0.20
G = 9.81
AROUND = (90 * DEG, 210 * DEG, 330 * DEG)
"""Angular positions of the muscles on the circle [rad]."""
PHI = Parameter("phi", "phi", "angle", 0.0, "about the x axis", -STEEPEST, STEEPEST, "the platform is on its stop",
                ASSUMED)  # fmt: skip
PSI = Parameter("psi", "psi", "angle", 0.0, "about its own y axis", -STEEPEST, STEEPEST, "the platform is on its stop",
                ASSUMED)  # fmt: skip
CIRCLE = Parameter("circle", "r", "length", 55 * MM, "radius of the circle of anchors", 0.0, 1.0, "no platform",
                   ASSUMED, above=True)  # fmt: skip
LEVEL = Parameter("preload", "e0", "ratio", 0.10, "contraction of all three while it is level", LEAST, MOST,
                  "paper 3 measured -3 to 20 %", ASSUMED)  # fmt: skip
MASS = Parameter("mass", "m", "mass", 2.0, "of the platform", 0.0, 1e3, "", ASSUMED)
HEIGHT = Parameter("height", "z", "length", 50 * MM, "of its centre of mass above the joint", -1.0, 1.0, "", ASSUMED)
MUSCLE = (DIAMETER, BRAID_ANGLE, ALPHA, A, B1, B2)


class Pose(NamedTuple):
    """Geometry of the three muscles at an attitude; the muscle is the first axis of all arrays."""

    length: Array
    """Lengths [m]."""
    arms: Array
    """Derivatives of the length with respect to phi and psi [m/rad], axes (muscle, angle, ...)."""
    bends: Array
    """Second derivatives: phi phi, phi psi, psi psi [m/rad2], axes (muscle, 3, ...)."""


def pose(phi: Array, psi: Array, circle: Array, height: Array) -> Pose:
    """Lengths and lever arms from angles [rad], radius of the circle and distance of the anchors while level [m]."""
    phi, psi, circle, height = np.broadcast_arrays(phi, psi, circle, height)
    sin, cos, turned, level = np.sin(phi), np.cos(phi), np.sin(psi), np.cos(psi)
    lengths, arms, bends = [], [], []
    for g in AROUND:
        ax, ay, none = circle * math.cos(g), circle * math.sin(g), np.zeros_like(circle)
        v = np.array([ax * (level - 1), ay * (cos - 1) + ax * turned * sin, ay * sin - ax * turned * cos + height])
        first = (
            np.array([none, -ay * sin + ax * turned * cos, ay * cos + ax * turned * sin]),
            np.array([-ax * turned, ax * level * sin, -ax * level * cos]),
        )
        second = (
            np.array([none, -ay * cos - ax * turned * sin, -ay * sin + ax * turned * cos]),
            np.array([none, ax * level * cos, ax * level * sin]),
            np.array([-ax * level, -ax * turned * sin, ax * turned * cos]),
        )
        length = np.sqrt((v * v).sum(axis=0))
        arm = [(v * d).sum(axis=0) / length for d in first]
        pairs = ((0, 0), (0, 1), (1, 1))
        bend = [((v * d).sum(axis=0) + (first[i] * first[j]).sum(axis=0)) / length - arm[i] * arm[j] / length
                for d, (i, j) in zip(second, pairs, strict=True)]  # fmt: skip
        lengths.append(length)
        arms.append(arm)
        bends.append(bend)
    return Pose(np.array(lengths), np.array(arms), np.array(bends))


def gravity(phi: Array, psi: Array, mass: Array, height: Array) -> Array:
    """Moment of the weight about phi and psi [N.m], axes (angle, ...); angles [rad], `mass` [kg], `height` [m]."""
    moment: Array = mass * G * height * np.array([np.sin(phi) * np.cos(psi), np.cos(phi) * np.sin(psi)])
    return moment


def allocation(moment: Array, arms: Array) -> tuple[Array, Array]:
    """Smallest forces [N] of three muscles for a moment, and forces without one: F = first + k second.

    `moment`: J^T F [N.m], axes (angle, ...); `arms`: J [m/rad], axes (muscle, angle, ...).
    """
    a, b = arms[:, 0], arms[:, 1]
    free = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    free = free / free.sum(axis=0)
    aa, ab, bb = (a * a).sum(axis=0), (a * b).sum(axis=0), (b * b).sum(axis=0)
    det = aa * bb - ab * ab
    first, second = (bb * moment[0] - ab * moment[1]) / det, (aa * moment[1] - ab * moment[0]) / det
    return a * first + b * second, free


def _contraction(length: Array, free: Array, phi: Array) -> Array:
    eps = 1 - length / free
    refuse("phi", "a muscle would be outside -3 to 20 % of contraction, where it is known",
           (eps < LEAST - 1e-9) | (eps > MOST + 1e-9), np.broadcast_to(phi, eps.shape))  # fmt: skip
    return eps


@described(
    "platform-moment", FAMILY, "Moments and stiffness of a platform at three pressures",
    equation=(
        "Q = -J^T F + m g z (sin phi cos psi, cos phi sin psi);  F_i = max(0, S P_i + F_e), as in daerden-force",
        "K = -dQ/d(phi, psi), isobaric",
    ),
    source=SOURCE,
    parameters=(
        PHI, PSI,
        *(Parameter(f"pressure_{i}", f"P{i}", "pressure", 2.5 * BAR, f"gauge pressure of muscle {i}", 0.0, 1e6)
          for i in (1, 2, 3)),
        CIRCLE, LEVEL, LENGTH, *MUSCLE, MASS, HEIGHT,
    ),
    outputs=(
        Output("moment_phi", "Q_phi", "torque", "of muscles and weight about phi"),
        Output("moment_psi", "Q_psi", "torque", "of muscles and weight about psi"),
        Output("stiffness_phi", "K_phi", "torsional stiffness", "-dQ_phi/dphi"),
        Output("stiffness_psi", "K_psi", "torsional stiffness", "-dQ_psi/dpsi"),
    ),
    references=(
        Reference("stiffness_psi", "-0.981", "N.m/rad", 1.0, "by hand: slack muscles leave -2 9.81 0.05",
                  {f"pressure_{i}": 0.0 for i in (1, 2, 3)}),
        *(Reference(output, printed, "N.m/rad", 1.0, BY_HAND, {f"pressure_{i}": P * BAR for i in (1, 2, 3)})
        for P, printed in ((1.0, "12.10"), (2.0, "33.70"), (2.5, "44.50"), (4.0, "76.90"))
        for output in ("stiffness_phi", "stiffness_psi")),
    ),
    notes=("Level, the muscles are slack below 0.446 bar and hold nothing: a vented platform falls to a stop.",),
)  # fmt: skip
def platform_moment(
    phi: Array, psi: Array, pressure_1: Array, pressure_2: Array, pressure_3: Array, circle: Array, preload: Array,
    length: Array, diameter: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array, mass: Array,
    height: Array,
) -> Values:  # fmt: skip
    """Q [N.m] and K [N.m/rad] from phi and psi [rad], P_i [Pa gauge], r, l0 and z [m], e0 [1], the muscle, m [kg]."""
    lengths, arms, bends = pose(phi, psi, circle, (1 - preload) * length)
    eps = _contraction(lengths, length, phi)
    P = np.array(np.broadcast_arrays(pressure_1, pressure_2, pressure_3, lengths[0])[:3])

    def pull(at: Array) -> Array:
        return np.asarray(section_factor(at, diameter, braid_angle, alpha) * P + rubber_force(at, A, B1, B2))

    force = np.maximum(0.0, pull(eps))
    h = 1e-6
    rise = np.where(force > 0, -(pull(eps + h) - pull(eps - h)) / (2 * h * length), 0.0)
    weight = gravity(phi, psi, mass, height)
    level = mass * G * height * np.cos(phi) * np.cos(psi)
    return {
        "moment_phi": -(arms[:, 0] * force).sum(axis=0) + weight[0],
        "moment_psi": -(arms[:, 1] * force).sum(axis=0) + weight[1],
        "stiffness_phi": (rise * arms[:, 0] ** 2 + force * bends[:, 0]).sum(axis=0) - level,
        "stiffness_psi": (rise * arms[:, 1] ** 2 + force * bends[:, 2]).sum(axis=0) - level,
    }
