"""A platform tilted by three muscles about a joint with two axes: pose, moments and stiffness, pressures, tilt.

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
    "platform-pose", FAMILY, "Lengths and contractions of three muscles under a tilted platform",
    equation=(
        "R = R_x(phi) R_y(psi);  v_i = R a_i - b_i,  b_i = a_i - (0, 0, (1 - e0) l0);  l_i = |v_i|",
        "eps_i = 1 - l_i / l0;  J_i = d l_i / d (phi, psi)",
    ),
    source=SOURCE,
    parameters=(PHI, PSI, CIRCLE, LEVEL, LENGTH),
    outputs=(
        *(Output(f"length_{i}", f"l{i}", "length", f"length of muscle {i}") for i in (1, 2, 3)),
        *(Output(f"contraction_{i}", f"eps_{i}", "ratio", f"contraction of muscle {i}") for i in (1, 2, 3)),
        *(Output(f"arm_{i}_{name}", f"dl{i}/d{name}", "length", f"change of l{i} by a radian of {name}")
          for i in (1, 2, 3) for name in ("phi", "psi")),
    ),
    references=(
        *(Reference(f"length_{i}", printed, "mm", MM, BY_HAND, {"phi": 7 * DEG, "psi": -12 * DEG})
          for i, printed in ((1, "186.703"), (2, "166.829"), (3, "186.483"))),
        *(Reference(output, printed, "mm/rad", MM, BY_HAND, {"phi": 7 * DEG, "psi": -12 * DEG})
          for output, printed in (("arm_1_phi", "54.605"), ("arm_1_psi", "0"), ("arm_2_phi", "-25.975"),
                                  ("arm_2_psi", "46.131"), ("arm_3_phi", "-28.466"), ("arm_3_psi", "-46.328"))),
        *(Reference(f"contraction_{i}", printed, "%", 0.01, BY_HAND, {"phi": phi * DEG, "psi": psi * DEG})
          for phi, psi, row in ((10, 0, ("5.224", "12.387", "12.387")), (20, 0, ("0.581", "14.699", "14.699")),
                                (-20, 0, ("19.388", "5.294", "5.294")), (0, 20, ("10.000", "1.844", "18.133")),
                                (20, 20, ("0.581", "7.017", "22.260")))
          for i, printed in enumerate(row, 1)),
    ),
    notes=("Both angles at 20 deg are a tilt of 28 deg: outside what the muscles of this geometry can do.",),
)  # fmt: skip
def platform_pose(phi: Array, psi: Array, circle: Array, preload: Array, length: Array) -> Values:
    """l_i [m], eps_i [1] and arms [m/rad] from phi and psi [rad], r and l0 [m], e0 [1]."""
    lengths, arms, _ = pose(phi, psi, circle, (1 - preload) * length)
    found = {f"length_{i}": lengths[i - 1] for i in (1, 2, 3)}
    found |= {f"contraction_{i}": 1 - lengths[i - 1] / length for i in (1, 2, 3)}
    return found | {f"arm_{i}_{name}": arms[i - 1, k] for i in (1, 2, 3) for k, name in enumerate(("phi", "psi"))}


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


@described(
    "platform-pressures", FAMILY, "Three pressures that give a moment at an attitude",
    equation=(
        "J^T F = Q_g - M;  F = J (J^T J)^-1 (Q_g - M) + lambda n, n the forces that make no moment",
        "P_i = (F_i - F_e) / S; lambda so that the mean is as wanted, moved until P_min <= P_i <= P_max; else refused",
    ),
    source=SOURCE,
    parameters=(
        PHI, PSI,
        Parameter("moment_phi", "M_phi", "torque", 0.0, "wanted of the muscles beyond holding the weight"),
        Parameter("moment_psi", "M_psi", "torque", 0.0, "the same about psi"),
        Parameter("pressure_mean", "P_mean", "pressure", 2.5 * BAR, "wanted mean of the three", 0.0, 1e6),
        CIRCLE, LEVEL, LENGTH, *MUSCLE, MASS, HEIGHT,
        Parameter("pressure_min", "P_min", "pressure", 0.2 * BAR, "least gauge pressure", 0.0, 1e6),
        Parameter("pressure_max", "P_max", "pressure", 5.5 * BAR, "greatest gauge pressure", 0.0, 1e6, above=True),
    ),
    outputs=tuple(Output(f"pressure_{i}", f"P{i}", "pressure", f"gauge pressure of muscle {i}") for i in (1, 2, 3)),
    references=tuple(
        Reference(f"pressure_{i}", printed, "bar", BAR, BY_HAND, {"phi": phi * DEG, "psi": psi * DEG})
        for phi, psi, row in (
            (0, 0, ("2.5", "2.5", "2.5")), (10, 0, ("1.9246", "2.7877", "2.7877")),
            (20, 0, ("1.2888", "3.1056", "3.1056")), (-20, 0, ("4.0112", "1.7444", "1.7444")),
            (0, 20, ("2.3012", "1.4261", "3.7727")),
        )
        for i, printed in enumerate(row, 1)
    ),
)  # fmt: skip
def platform_pressures(
    phi: Array, psi: Array, moment_phi: Array, moment_psi: Array, pressure_mean: Array, circle: Array, preload: Array,
    length: Array, diameter: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array, mass: Array,
    height: Array, pressure_min: Array, pressure_max: Array,
) -> Values:  # fmt: skip
    """P_i [Pa gauge] from phi and psi [rad], M [N.m], mean [Pa], r, l0 and z [m], e0 [1], the muscle, m [kg]."""
    lengths, arms, _ = pose(phi, psi, circle, (1 - preload) * length)
    eps = _contraction(lengths, length, phi)
    wanted = gravity(phi, psi, mass, height) - np.array(np.broadcast_arrays(moment_phi, moment_psi))
    least, free = allocation(np.array(np.broadcast_arrays(*wanted, lengths[0])[:2]), arms)
    section, rubber = section_factor(eps, diameter, braid_angle, alpha), rubber_force(eps, A, B1, B2)
    P, rise = (least - rubber) / section, free / section
    scale = (3 * pressure_mean - P.sum(axis=0)) / rise.sum(axis=0)
    low, high = ((pressure_min - P) / rise).max(axis=0), ((pressure_max - P) / rise).min(axis=0)
    refuse("moment_phi", "no three pressures within the limits make this moment there", low > high,
           np.broadcast_to(moment_phi, low.shape))  # fmt: skip
    P = P + rise * np.clip(scale, low, high)
    return {f"pressure_{i}": P[i - 1] for i in (1, 2, 3)}


@described(
    "platform-tilt", FAMILY, "Attitude of a platform at rest from an accelerometer with three axes",
    equation=("phi = atan2(f_y, sqrt(f_x^2 + f_z^2));  psi = atan2(-f_x, f_z), from f = g (-cos phi sin psi, sin phi,",
              "cos phi cos psi)"),
    source="paper 3 names the sensor; gravity in the platform's axes",
    parameters=tuple(
        Parameter(f"acceleration_{axis}", f"f_{axis}", "acceleration", value, f"specific force along its {axis} axis")
        for axis, value in (("x", 0.0), ("y", 0.0), ("z", 9.81))
    ),
    outputs=(
        Output("phi", "phi", "angle", "about the x axis"), Output("psi", "psi", "angle", "about its own y axis"),
        Output("norm", "|f|", "acceleration", "9.81 m/s2 at rest; anything else is motion or a fault"),
    ),
    references=(
        Reference("phi", "10.000", "deg", DEG, "by hand: 9.81 sin 10 deg = 1.703489",
                  {"acceleration_y": 1.703489, "acceleration_z": 9.660964}),
        Reference("psi", "-20.000", "deg", DEG, "by hand: 9.81 sin 20 deg = 3.355218",
                  {"acceleration_x": 3.355218, "acceleration_z": 9.218385}),
    ),
    notes=(
        "A sensor at height h above the joint reads 1 + h w^2 / g times the tilt of a swing: 80 % too much at 2 Hz and "
        "50 mm.",
    ),
)  # fmt: skip
def platform_tilt(acceleration_x: Array, acceleration_y: Array, acceleration_z: Array) -> Values:
    """Phi and psi [rad] from specific forces [m/s2]."""
    flat = np.hypot(acceleration_x, acceleration_z)
    refuse("acceleration_z", "a sensor that reads nothing at all shows no tilt",
           np.hypot(flat, acceleration_y) < 1e-9, acceleration_z)  # fmt: skip
    return {
        "phi": np.arctan2(acceleration_y, flat), "psi": np.arctan2(-acceleration_x, acceleration_z),
        "norm": np.hypot(flat, acceleration_y),
    }  # fmt: skip
