"""A pulley between two antagonistic muscles (torque, stiffness, pressures for both), and a platform tilted by three.

Muscle 1 of a pulley shortens with a positive angle. Both follow the modified Daerden model; alpha = 2 and A = 0 give
the model of Tondu and Lopez. Stiffness is isobaric, with regulated pressures, except for the additional one with shut
valves.

A platform turns by phi about the x axis, which is fixed to the base, then by psi about its own y axis. The muscles are
anchored on a circle at 90, 210 and 330 deg and hang vertically while it is level. Paper 3 prints the chain of
computations but no dimensions: all numbers are assumed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, DEG, MM
from pmabench.model.library.daerden import ASSUMED, ATMOSPHERE, MUSCLE, muscle_volume, rubber_force, section_factor
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse

FAMILY = "joint"
LEAST, MOST = -0.03, 0.20
"""Range of contraction in which the muscle model is valid [1]."""
SOURCE = "computed from the equations of paper 3; no paper prints a pair"
BY_HAND = "computed from the equations, by another program"
ANGLE = Parameter("angle", "th", "angle", 0.0, "of the pulley; above 0 muscle 1 is shorter", -math.pi, math.pi,
                  "no pulley with two muscles turns further")  # fmt: skip
PULLEY = Parameter(
    "pulley_radius", "R", "length", 25 * MM, "lever arm of both muscles", 0.0, 1.0, "no joint", above=True
)
PRELOAD = Parameter("preload", "e0", "ratio", 0.10, "contraction of both at angle 0", LEAST, MOST,
                    "paper 3 measured -3 to 20 %")  # fmt: skip
TONDU = {"alpha": 2.0, "A": 0.0}
"""Parameters that give the model of Tondu and Lopez."""
LOWEST, HIGHEST = 0.2 * BAR, 5.5 * BAR


def _pressure(number: int) -> Parameter:
    return Parameter(f"pressure_{number}", f"P{number}", "pressure", 2 * BAR, f"gauge pressure of muscle {number}",
                     0.0, 1e6, "no pressure of a muscle")  # fmt: skip


class _Side(NamedTuple):
    """One muscle at its contraction: S [m2] and F_e [N], and their slopes over the contraction [m2], [N]."""

    section: Array
    rubber: Array
    section_slope: Array
    rubber_slope: Array


def _side(eps: Array, diameter: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array) -> _Side:
    steep = -math.pi / 4 * diameter**2 * 3 * alpha * (1 - eps) ** (alpha - 1) / np.tan(braid_angle) ** 2
    bent = A * ((2 * eps - B1) * (eps + B2) - eps * (eps - B1)) / (eps + B2) ** 2
    return _Side(section_factor(eps, diameter, braid_angle, alpha), rubber_force(eps, A, B1, B2), steep, bent)


def _contractions(angle: Array, radius: Array, preload: Array, length: Array) -> tuple[Array, Array]:
    """Contractions of muscles 1 and 2 [1]; OutsideDomain where the muscle model is not valid."""
    way = radius * angle / length
    both = np.asarray(preload + way), np.asarray(preload - way)
    for eps in both:
        refuse("angle", "a muscle would be outside -3 to 20 % of contraction, where it is known",
               (eps < LEAST - 1e-9) | (eps > MOST + 1e-9), np.broadcast_to(angle, eps.shape))  # fmt: skip
    return both


def _force(side: _Side, P: Array) -> Array:
    """Pull of one muscle [N]; 0 if it is slack."""
    return np.asarray(np.maximum(0.0, side.section * P + side.rubber))


@described(
    "joint", FAMILY, "Torque and stiffness of a pulley between two muscles",
    equation=(
        "eps_1 = e0 + R th / l0,  eps_2 = e0 - R th / l0;  F_i = max(0, S P_i + F_e), as in daerden-force",
        "tau = R (F_1 - F_2);  K = -(R^2 / l0) sum over taut muscles of S'(eps_i) P_i + F_e'(eps_i)",
        "shut valves add K_air = (R^2 / l0) n sum S(eps_i) (P_i + P_atm) V'(eps_i) / V(eps_i)",
    ),
    source=SOURCE,
    parameters=(
        ANGLE, _pressure(1), _pressure(2), PULLEY, PRELOAD, *MUSCLE,
        Parameter("polytropic", "n", "count", 1.2, "1 isothermal, 1.4 adiabatic", 1.0, 1.4, "no air behaves so"),
        ATMOSPHERE,
    ),
    outputs=(
        Output("torque", "tau", "torque", "of both muscles, towards a positive angle"),
        Output("stiffness", "K", "torsional stiffness", "isobaric: -d tau / d th"),
        Output("air_stiffness", "K_air", "torsional stiffness", "what shut valves add to K"),
        Output("force_1", "F_1", "force", "pull of muscle 1"),
        Output("force_2", "F_2", "force", "pull of muscle 2"),
    ),
    references=tuple(
        Reference(output, printed, unit, 1.0, BY_HAND,
                  {"angle": angle * DEG, "pressure_1": p1 * BAR, "pressure_2": p2 * BAR} | muscle)
        for angle, p1, p2, muscle, torque, K, K_air in (
            (0, 2, 2, {}, None, "9.554", "12.833"), (0, 4, 2, {}, "7.684", "15.505", "17.092"),
            (0, 4, 4, {}, None, "21.456", "21.350"), (15, 4, 2, {}, "3.629", "15.648", "16.935"),
            (30, 2, 4, {}, "-16.380", "18.884", "31.261"),
            (0, 2, 2, TONDU, None, "9.752", "13.092"), (0, 4, 2, TONDU, "8.759", "14.629", "17.436"),
            (0, 4, 4, TONDU, None, "19.505", "21.781"), (15, 4, 2, TONDU, "4.953", "14.451", "17.035"),
            (30, 2, 4, TONDU, "-16.512", "14.983", "27.432"), (45, 4, 4, TONDU, "-15.319", "19.505", "41.613"),
            (45, 4, 4, {}, "-18.903", "34.260", "53.209"),
        )
        for output, printed, unit in (
            ("torque", torque, "N.m"), ("stiffness", K, "N.m/rad"), ("air_stiffness", K_air, "N.m/rad")
        )
        if printed is not None
    ),
    notes=(
        "At angle 0 both muscles are slack below 0.446 bar and hold nothing: a vented joint does not stay where it is.",
        "Hysteresis of the muscles makes a small perturbation look stiffer than this: at +-0.25 deg three times as "
        "stiff.",
    ),
)  # fmt: skip
def joint(
    angle: Array, pressure_1: Array, pressure_2: Array, pulley_radius: Array, preload: Array, diameter: Array,
    length: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array, polytropic: Array,
    atmosphere: Array,
) -> Values:  # fmt: skip
    """Tau [N.m], K and K_air [N.m/rad], F_i [N] from th [rad], P_i [Pa gauge], R and l0 [m], e0 [1] and the muscle."""
    shape = (diameter, braid_angle, alpha, A, B1, B2)
    both = _contractions(angle, pulley_radius, preload, length)
    arm, K, air, forces = pulley_radius**2 / length, np.zeros(()), np.zeros(()), []
    for eps, P in zip(both, (pressure_1, pressure_2), strict=True):
        side = _side(eps, *shape)
        forces.append(_force(side, P))
        taut = forces[-1] > 0
        K = K - arm * np.where(taut, side.section_slope * P + side.rubber_slope, 0.0)
        volume = muscle_volume(eps, diameter, length, braid_angle, alpha)
        size = math.pi / 4 * diameter**2 * length
        slope = size * ((alpha + 1) * (1 - eps) ** alpha / np.tan(braid_angle) ** 2 - 1 / np.sin(braid_angle) ** 2)
        air = air + arm * polytropic * np.where(taut, side.section * (P + atmosphere) * slope / volume, 0.0)
    torque = pulley_radius * (forces[0] - forces[1])
    return {"torque": torque, "stiffness": K, "air_stiffness": air, "force_1": forces[0], "force_2": forces[1]}


@described(
    "joint-inverse", FAMILY, "Both pressures for a torque and a stiffness at an angle",
    equation=(
        "[S_1, -S_2; -S_1', -S_2'] (P_1, P_2) = (tau / R - F_e1 + F_e2, K l0 / R^2 + F_e1' + F_e2')",
        "linear, because S P + F_e is; F_i >= 0 and P_i within limits, else refused",
    ),
    source=SOURCE,
    parameters=(
        ANGLE,
        Parameter("torque", "tau", "torque", 0.0, "wanted"),
        Parameter("stiffness", "K", "torsional stiffness", 20.0, "wanted, isobaric"),
        PULLEY, PRELOAD, *MUSCLE,
        Parameter("pressure_min", "P_min", "pressure", LOWEST, "least gauge pressure of a regulator", 0.0, 1e6),
        Parameter("pressure_max", "P_max", "pressure", HIGHEST, "greatest gauge pressure", 0.0, 1e6, above=True),
    ),
    outputs=(
        Output("pressure_1", "P1", "pressure", "gauge pressure of muscle 1"),
        Output("pressure_2", "P2", "pressure", "gauge pressure of muscle 2"),
    ),
    references=(
        Reference("pressure_1", "4.5543", "bar", BAR, BY_HAND, {"angle": 20 * DEG}),
        Reference("pressure_2", "2.7775", "bar", BAR, BY_HAND, {"angle": 20 * DEG}),
        Reference("pressure_1", "5.2628", "bar", BAR, BY_HAND, {"angle": 20 * DEG, "torque": 5.0}),
        Reference("pressure_2", "2.1709", "bar", BAR, BY_HAND, {"angle": 20 * DEG, "torque": 5.0}),
        Reference("pressure_1", "6.727", "bar", BAR, BY_HAND,
                  {"angle": 20 * DEG, "stiffness": 30.0, "pressure_max": 7 * BAR}),
        Reference("pressure_2", "4.033", "bar", BAR, BY_HAND,
                  {"angle": 20 * DEG, "stiffness": 30.0, "pressure_max": 7 * BAR}),
    ),
    notes=(
        "What is outside the limits is refused with the stiffness that this torque can have there.",
        "Hysteresis is left out: with a perfect model the joint still misses by 2.5 to 4.6 deg without feedback.",
    ),
)  # fmt: skip
def joint_inverse(
    angle: Array, torque: Array, stiffness: Array, pulley_radius: Array, preload: Array, diameter: Array,
    length: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array, pressure_min: Array,
    pressure_max: Array,
) -> Values:  # fmt: skip
    """P_1 and P_2 [Pa gauge] from th [rad], tau [N.m], K [N.m/rad], R and l0 [m], e0 [1], the muscle, limits."""
    shape = (diameter, braid_angle, alpha, A, B1, B2)
    both = _contractions(angle, pulley_radius, preload, length)
    one, two = (_side(eps, *shape) for eps in both)
    for side in (one, two):
        refuse("angle", "S is not above 0: no pressure gives a pull there", side.section <= 0)
    pull = torque / pulley_radius - one.rubber + two.rubber
    slope = stiffness * length / pulley_radius**2 + one.rubber_slope + two.rubber_slope
    determinant = -one.section * two.section_slope - two.section * one.section_slope
    P1 = (-pull * two.section_slope + slope * two.section) / determinant
    P2 = (slope * one.section + pull * one.section_slope) / determinant
    # at constant torque P1, P2 and the stiffness rise together: the limits of pressure give an interval of stiffness
    low = np.maximum(pressure_min, (pull + two.section * pressure_min) / one.section)
    high = np.minimum(pressure_max, (pull + two.section * pressure_max) / one.section)
    ends = []
    for P in (low, high):
        steeper = -one.section_slope * P - two.section_slope * (one.section * P - pull) / two.section
        ends.append(pulley_radius**2 / length * (steeper - one.rubber_slope - two.rubber_slope))
    outside = (
        (np.minimum(P1, P2) < pressure_min - 1e-6)
        | (np.maximum(P1, P2) > pressure_max + 1e-6)
        | (one.section * P1 + one.rubber < -1e-9)
        | (two.section * P2 + two.rubber < -1e-9)
    )
    if np.any(outside):
        where = np.unravel_index(int(np.argmax(outside)), np.shape(outside))
        least, most, P_1, P_2 = (float(np.broadcast_to(v, np.shape(outside))[where]) for v in (*ends, P1, P2))
        reach = f"from {least:.3g} to {most:.3g} N.m/rad" if most > least else "at no stiffness"
        refuse(
            "stiffness",
            f"it would take {P_1 / BAR:.4g} and {P_2 / BAR:.4g} bar; within the limits this torque can be had {reach}",
            outside, np.broadcast_to(stiffness, np.shape(outside)),
        )  # fmt: skip
    return {"pressure_1": P1, "pressure_2": P2}


STEEPEST = 24 * DEG
"""Angle of the mechanical stops [rad]."""
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
DIAMETER, LENGTH, *SHAPE = MUSCLE


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
    "platform-moment", "platform", "Moments and stiffness of a platform at three pressures",
    equation=(
        "Q = -J^T F + m g z (sin phi cos psi, cos phi sin psi);  F_i = max(0, S P_i + F_e), as in daerden-force",
        "K = -dQ/d(phi, psi), isobaric",
    ),
    source="paper 3 names the chain; geometry and numbers are assumed",
    parameters=(
        PHI, PSI,
        *(Parameter(f"pressure_{i}", f"P{i}", "pressure", 2.5 * BAR, f"gauge pressure of muscle {i}", 0.0, 1e6)
          for i in (1, 2, 3)),
        CIRCLE, LEVEL, LENGTH, DIAMETER, *SHAPE, MASS, HEIGHT,
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
