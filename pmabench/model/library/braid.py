"""Force of a braided muscle from its geometry: Chou-Hannaford, Tondu-Lopez with k, strand stretch (papers 1, 2, 4)."""

from __future__ import annotations

import math

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.description import Output, Parameter, Reference, Values, described, refuse

FAMILY = "static force"
BAR, DEG, MM = 1e5, math.pi / 180, 1e-3
NEUTRAL = math.acos(1 / math.sqrt(3))
"""Braid angle at which a muscle neither contracts nor extends, 54.7356 deg [rad]."""

PRESSURE = Parameter(
    "pressure", "P", "pressure", 5 * BAR, "gauge pressure", 0.0, 1e6,
    "a muscle is not worked at a vacuum or above 10 bar",
)  # fmt: skip
CONTRACTION = Parameter(
    "contraction", "eps", "ratio", 0.0, "x / L0 from the nominal length", 0.0, 1.0, "it is stretched, or gone"
)
RADIUS = Parameter(
    "radius", "r0", "length", 10 * MM, "radius at eps = 0", 0.0, 1.0, "no radius of a muscle", above=True
)
BRAID_ANGLE = Parameter(
    "braid_angle", "theta0", "angle", 25 * DEG, "angle of the braid to the muscle's axis at eps = 0", 0.0, NEUTRAL,
    "from 54.74 deg on it does not contract", above=True,
)  # fmt: skip
FORCE = Output("force", "F", "force", "pulling force; 0 beyond eps_max, where the muscle is slack")
CONTRACTION_MAX = Output("contraction_max", "eps_max", "ratio", "contraction at which the force is 0")
SLACK = "Beyond eps_max the formula would push and, past eps = 1/k, pull again; a muscle is slack there: F = 0."


def braid_factors(braid_angle: Array) -> tuple[Array, Array]:
    """Factors a = 3 / tan^2 theta0 and b = 1 / sin^2 theta0 [1], theta0 [rad] (paper 1 eqs. 5-8)."""
    return 3 / np.tan(braid_angle) ** 2, 1 / np.sin(braid_angle) ** 2


def braid_force(
    pressure: Array, contraction: Array, radius: Array, braid_angle: Array, k: Array
) -> tuple[Array, Array]:
    """Force [N], not below 0, and eps_max [1] of pi r0^2 P (a (1 - k eps)^2 - b) (paper 1 eqs. 5-8)."""
    a, b = braid_factors(braid_angle)
    stretch = np.maximum(1 - k * contraction, 0)
    force = math.pi * radius**2 * pressure * np.maximum(a * stretch**2 - b, 0)
    return force, (1 - np.sqrt(b / a)) / k


@described(
    "chou-hannaford", FAMILY, "Force, length and volume from the braid's present angle",
    equation=(
        "F = P b^2 (3 cos^2 theta - 1) / (4 pi n^2)",
        "L = b cos theta;  D = b sin theta / (n pi);  V = b^3 cos theta sin^2 theta / (4 pi n^2)",
    ),
    source="Chou and Hannaford, in paper 1 eqs. 1-4 and paper 2 eqs. 5-6",
    parameters=(
        PRESSURE,
        Parameter("strand_length", "b", "length", 250 * MM, "length of one strand of the braid", 0.0, above=True),
        Parameter("turns", "n", "count", 1.2, "turns of a strand around the muscle", 0.0, above=True),
        Parameter("braid_angle", "theta", "angle", 25 * DEG, "angle to the axis at this length", 0.0, math.pi / 2, ""),
    ),
    outputs=(
        Output("force", "F", "force", "pulling force; below 0 beyond 54.7356 deg, where the muscle extends"),
        Output("length", "L", "length", "length"),
        Output("diameter", "D", "length", "diameter"),
        Output("volume", "V", "volume", "volume as a cylinder"),
    ),
    references=(
        Reference("force", "0.0000", "N", 1.0, "closed form: cos^2 theta = 1/3", {"braid_angle": NEUTRAL}),
        Reference("force", "2528.56", "N", 1.0, "-P dV/dL by finite differences of V(L) at constant b, n"),
    ),
    notes=("Paper 2 prints D without n in its eq. 5; D = b sin theta / (n pi) is meant.",),
)  # fmt: skip
def chou_hannaford(pressure: Array, strand_length: Array, turns: Array, braid_angle: Array) -> Values:
    """F [N], L and D [m], V [m3] from P [Pa gauge], b [m], n and theta [rad]; F = -P dV/dL at constant b and n."""
    cosine, sine = np.cos(braid_angle), np.sin(braid_angle)
    section = strand_length**2 / (4 * math.pi * turns**2)
    return {
        "force": pressure * section * (3 * cosine**2 - 1),
        "length": strand_length * cosine + 0 * turns,
        "diameter": strand_length * sine / (turns * math.pi),
        "volume": section * strand_length * cosine * sine**2,
    }


@described(
    "tondu-lopez", FAMILY, "Force over contraction, with a constant end factor k",
    equation=(
        "F = pi r0^2 P [a (1 - k eps)^2 - b];  a = 3 / tan^2 theta0;  b = 1 / sin^2 theta0",
        "eps_max = (1 - sqrt(b / a)) / k = (1 - 1 / (sqrt(3) cos theta0)) / k",
    ),
    source="Tondu and Lopez, in paper 1 eqs. 5-8, paper 2 eq. 7, paper 4 eqs. 3-4",
    fitted=("radius", "braid_angle", "k"),
    parameters=(
        PRESSURE, CONTRACTION, RADIUS, BRAID_ANGLE,
        Parameter(
            "k", "k", "count", 1.0, "makes up for ends that are no cylinder", 0.5, 3.0,
            "no muscle is known with it",
        ),
    ),
    outputs=(
        FORCE, CONTRACTION_MAX,
        Output("a", "a", "count", "3 / tan^2 theta0"), Output("b", "b", "count", "1 / sin^2 theta0"),
    ),
    references=(
        Reference("a", "22.646", "", 1.0, "3 / tan^2 20 deg", {"braid_angle": 20 * DEG}),
        Reference("b", "8.549", "", 1.0, "1 / sin^2 20 deg", {"braid_angle": 20 * DEG}),
        Reference("contraction_max", "0.3856", "", 1.0, "closed form", {"braid_angle": 20 * DEG}),
        Reference("a", "13.797", "", 1.0, "3 / tan^2 25 deg"),
        Reference("b", "5.599", "", 1.0, "1 / sin^2 25 deg"),
        Reference("contraction_max", "0.3630", "", 1.0, "closed form"),
        Reference("contraction_max", "0.333333", "", 1.0, "1/3 at 30 deg", {"braid_angle": 30 * DEG}),
    ),
    notes=(
        SLACK,
        "k never changes F at eps = 0.",
        "F is largest at eps = 0; the text of paper 2 has it the other way round.",
    ),
)  # fmt: skip
def tondu_lopez(pressure: Array, contraction: Array, radius: Array, braid_angle: Array, k: Array) -> Values:
    """F [N], eps_max, a, b [1] from P [Pa gauge], eps [1], r0 [m], theta0 [rad] and k [1]."""
    force, most = braid_force(pressure, contraction, radius, braid_angle, k)
    a, b = braid_factors(braid_angle)
    return {"force": force, "contraction_max": most, "a": a, "b": b}


@described(
    "tondu-lopez-k-of-p", FAMILY, "Force over contraction, with an end factor k that follows pressure",
    equation=(
        "F = pi r0^2 P [a (1 - k(P) eps)^2 - b];  a, b as in tondu-lopez",
        "k(P) = k_low + (k_high - k_low) (P - P_low) / (P_high - P_low)",
    ),
    source="paper 1 eqs. 5-8 with k(P); the straight line between two measured pressures is ours",
    fitted=("radius", "braid_angle", "k_low", "k_high"),
    parameters=(
        PRESSURE, CONTRACTION, RADIUS, BRAID_ANGLE,
        Parameter("pressure_low", "P_low", "pressure", 1 * BAR, "gauge pressure at which k is k_low", 0.0, 1e6),
        Parameter("k_low", "k_low", "count", 1.4, "k at P_low", 0.5, 3.0, "no muscle is known with it"),
        Parameter("pressure_high", "P_high", "pressure", 6 * BAR, "gauge pressure at which k is k_high", 0.0, 1e6),
        Parameter("k_high", "k_high", "count", 1.1, "k at P_high", 0.5, 3.0, "no muscle is known with it"),
    ),
    outputs=(FORCE, CONTRACTION_MAX, Output("k", "k", "count", "k at this pressure")),
    references=(
        Reference("k", "1.16", "", 1.0, "by hand: 1.4 - 0.3 (5 - 1) / 5"),
        Reference("contraction_max", "0.3129", "", 1.0, "by hand: (1 - 1 / (sqrt(3) cos 25 deg)) / 1.16"),
    ),
    notes=(SLACK, "Pressures outside P_low to P_high are refused: k was not measured there."),
)  # fmt: skip
def tondu_lopez_k_of_p(
    pressure: Array,
    contraction: Array,
    radius: Array,
    braid_angle: Array,
    pressure_low: Array,
    k_low: Array,
    pressure_high: Array,
    k_high: Array,
) -> Values:
    """F [N], eps_max and k [1] from P [Pa gauge], eps [1], r0 [m], theta0 [rad] and k at two pressures [Pa gauge]."""
    refuse("pressure_high", "it must be above pressure_low", pressure_high <= pressure_low)
    outside = (pressure < pressure_low * (1 - 1e-12)) | (pressure > pressure_high * (1 + 1e-12))
    refuse("pressure", "k is known from pressure_low to pressure_high only", outside, pressure)
    k = k_low + (k_high - k_low) * (pressure - pressure_low) / (pressure_high - pressure_low)
    force, most = braid_force(pressure, contraction, radius, braid_angle, k)
    return {"force": force, "contraction_max": most, "k": k}


@described(
    "strand-stretch", FAMILY, "Force with strands that stretch (k_s) and a contraction gain (k_p)",
    equation=(
        "F = A0 P [a0 (1 - k_p h)^2 - b0 k_s^2];  A0 = pi D0^2 / 4;  D0 = S0 sin theta0 / (n pi)",
        "h = eps;  k_s = S(P) / S0;  h_max = (1 - k_s sqrt(b0 / a0)) / k_p",
    ),
    source="paper 4 eqs. 5-6 (Blasiak)",
    fitted=("k_p", "k_s"),
    parameters=(
        PRESSURE, CONTRACTION,
        Parameter("strand_length", "S0", "length", 250 * MM, "length of a strand without load", 0.0, above=True),
        Parameter("turns", "n", "count", 1.2, "turns of a strand around the muscle", 0.0, above=True),
        BRAID_ANGLE,
        Parameter("k_p", "k_p", "count", 1.0, "contraction gain", 0.5, 3.0, "no muscle is known with it"),
        Parameter(
            "k_s", "k_s", "count", 1.0, "stretched by unstretched strand", 1.0, 2.0,
            "a strand under tension gets longer",
        ),
    ),
    outputs=(FORCE, CONTRACTION_MAX, Output("diameter", "D0", "length", "diameter at eps = 0")),
    references=(
        Reference("contraction_max", "0.3630", "", 1.0, "tondu-lopez at 25 deg: k_p = k_s = 1 is the same"),
        Reference("diameter", "28.0", "mm", MM, "by hand: 250 mm sin 25 deg / (1.2 pi)"),
    ),
    notes=(SLACK, "The paper prints no value of k_p and k_s; 1 and 1 is the model without them."),
)  # fmt: skip
def strand_stretch(
    pressure: Array, contraction: Array, strand_length: Array, turns: Array, braid_angle: Array, k_p: Array, k_s: Array
) -> Values:
    """F [N], h_max [1], D0 [m] from P [Pa gauge], h [1], S0 [m], n [1], theta0 [rad], k_p and k_s [1]."""
    a, b = braid_factors(braid_angle)
    most = (1 - k_s * np.sqrt(b / a)) / k_p
    refuse("k_s", "strands that stretch so far leave no force even at eps = 0", most <= 0, k_s)
    diameter = strand_length * np.sin(braid_angle) / (turns * math.pi)
    drive = np.maximum(a * np.maximum(1 - k_p * contraction, 0) ** 2 - b * k_s**2, 0)
    return {"force": math.pi / 4 * diameter**2 * pressure * drive, "contraction_max": most, "diameter": diameter}
