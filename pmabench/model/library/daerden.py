"""Modified Daerden model of paper 3: force with a rubber term, volume, inverse; and volume from measurements."""

from __future__ import annotations

import math

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BAR, BRAID_ANGLE, MM
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse

FAMILY = "modified Daerden"
ASSUMED = "assumed"
"""Origin of values that paper 3 does not print: chosen to reproduce the statements of its text."""
CM3 = 1e-6

PRESSURE = Parameter("pressure", "P", "pressure", 5 * BAR, "gauge pressure", 0.0, 1e6, "no pressure of a muscle")
CONTRACTION = Parameter(
    "contraction", "eps", "ratio", 0.0, "x / l0, below 0 stretched", -0.03, 0.20, "paper 3 measured -3 to 20 %"
)
DIAMETER = Parameter(
    "diameter", "D0", "length", 20 * MM, "free diameter, at eps = 0", 0.0, 1.0, "no diameter of a muscle", ASSUMED,
    above=True,
)  # fmt: skip
ALPHA = Parameter("alpha", "alpha", "count", 2.6, "exponent; 2 is Tondu-Lopez", 1.0, 5.0, "no muscle is known", ASSUMED)
A = Parameter("A", "A", "force", 800.0, "size of the rubber term", 0.0, 1e6, "", ASSUMED)
B1 = Parameter("B1", "B1", "ratio", 0.22, "contraction at which the rubber term is 0 again", 0.0, 1.0, "", ASSUMED)
B2 = Parameter("B2", "B2", "ratio", 0.04, "the rubber term has its pole at eps = -B2", 0.03, 1.0,
               "the pole would lie inside the measured range", ASSUMED, above=True)  # fmt: skip
LENGTH = Parameter("length", "l0", "length", 200 * MM, "free length", 0.0, 10.0, "", ASSUMED, above=True)
MUSCLE = (DIAMETER, LENGTH, BRAID_ANGLE, ALPHA, A, B1, B2)
ATMOSPHERE = Parameter(
    "atmosphere", "P_atm", "pressure", 101325.0, "absolute pressure of the room", 5e4, 1.1e5, "no place is like that"
)


def section_factor(contraction: Array, diameter: Array, braid_angle: Array, alpha: Array) -> Array:
    """S [m2], force by pressure, from eps [1], D0 [m], theta0 [rad], alpha [1] (paper 3 eq. 9)."""
    shape = 3 * (1 - contraction) ** alpha / np.tan(braid_angle) ** 2 - 1 / np.sin(braid_angle) ** 2
    return np.asarray(math.pi / 4 * diameter**2 * shape)


def rubber_force(contraction: Array, A: Array, B1: Array, B2: Array) -> Array:
    """F_e [N], pull without pressure, from eps [1], A [N], B1 and B2 [1] (paper 3 eq. 8), including the factor eps."""
    return np.asarray(A * contraction * (contraction - B1) / (contraction + B2))


def muscle_volume(contraction: Array, diameter: Array, length: Array, braid_angle: Array, alpha: Array) -> Array:
    """V [m3] from eps [1], D0 and l0 [m], theta0 [rad], alpha [1] (paper 3, volume of the muscle)."""
    shape = 1 / np.sin(braid_angle) ** 2 - (1 - contraction) ** alpha / np.tan(braid_angle) ** 2
    return np.asarray(math.pi / 4 * diameter**2 * length * shape * (1 - contraction))


@described(
    "daerden-force", FAMILY, "Force over contraction with a rubber term, also stretched",
    equation=(
        "F = S(eps) P + F_e(eps);  F_e = A eps (eps - B1) / (eps + B2)",
        "S = (pi / 4) D0^2 [3 (1 - eps)^alpha / tan^2 theta0 - 1 / sin^2 theta0]",
    ),
    source="paper 3 eqs. 6, 8-10",
    fitted=("diameter", "braid_angle", "alpha", "A", "B1", "B2"),
    parameters=(PRESSURE, CONTRACTION, DIAMETER, BRAID_ANGLE, ALPHA, A, B1, B2),
    outputs=(
        Output("force", "F", "force", "mean of the two branches; hysteresis is a separate model"),
        Output("section", "S", "force per pressure", "force by pressure"),
        Output("rubber_force", "F_e", "force", "pull of the rubber without pressure, below 0 where it pushes"),
    ),
    references=(
        Reference("force", "2061", "N", 1.0, "computed from the equations", {"contraction": -0.03}),
        Reference("force", "1288", "N", 1.0, "the same"),
        Reference("force", "942", "N", 1.0, "the same", {"contraction": 0.05}),
        Reference("force", "700", "N", 1.0, "the same", {"contraction": 0.10}),
        Reference("force", "320", "N", 1.0, "the same", {"contraction": 0.20}),
        Reference("rubber_force", "600", "N", 1.0, "by hand: 800 (-0.03) (-0.25) / 0.01", {"contraction": -0.03}),
    ),
    notes=(
        "Eq. 8 already holds the factor eps that eq. 6 writes next to K: it is K(eps) eps.",
        "A, B1 and B2 with eps as a fraction; in percent B1 and B2 are 100 times larger and A 100 times smaller.",
        "The force may come out below 0 at low pressure and high contraction: there a real muscle buckles.",
    ),
)  # fmt: skip
def daerden_force(pressure: Array, contraction: Array, *muscle: Array) -> Values:
    """F [N], S [N/Pa], F_e [N] from P [Pa gauge], eps [1], D0 [m], theta0 [rad], alpha [1], A [N], B1 and B2 [1]."""
    section, rubber = section_factor(contraction, *muscle[:3]), rubber_force(contraction, *muscle[3:])
    return {"force": section * pressure + rubber, "section": section, "rubber_force": rubber}


@described(
    "daerden-inverse", FAMILY, "Gauge pressure that gives a force at a contraction",
    equation=("P = (F - F_e(eps)) / S(eps), where S(eps) > 0;  S and F_e as in daerden-force",),
    source="paper 3, the inverse of eq. 10",
    parameters=(
        Parameter("force", "F", "force", 700.0, "pulling force", 0.0, INF, "a muscle cannot push"),
        CONTRACTION, DIAMETER, BRAID_ANGLE, ALPHA, A, B1, B2,
    ),
    outputs=(Output("pressure", "P", "pressure", "gauge pressure"),),
    references=(
        Reference("pressure", "300.000", "kPa", 1e3, "daerden-force at 3 bar, 10 %, computed apart",
                  {"force": 392.47397, "contraction": 0.10}),
    ),
    notes=("A pressure below 0 is refused: the rubber alone pulls more than the force that is asked for.",),
)  # fmt: skip
def daerden_inverse(
    force: Array, contraction: Array, diameter: Array, braid_angle: Array, alpha: Array, A: Array, B1: Array, B2: Array
) -> Values:
    """P [Pa gauge] from F [N], eps [1], D0 [m], theta0 [rad], alpha [1], A [N], B1 and B2 [1]."""
    section = section_factor(contraction, diameter, braid_angle, alpha)
    refuse("contraction", "S(eps) is not above 0: no pressure gives a pull there", section <= 0, contraction)
    pressure = (force - rubber_force(contraction, A, B1, B2)) / section
    refuse("force", "the rubber alone pulls more at this contraction: it would take a vacuum", pressure < -1e-6, force)
    return {"pressure": np.maximum(pressure, 0.0)}


@described(
    "daerden-volume", FAMILY, "Volume over contraction, and its slope",
    equation=(
        "V = (pi / 4) D0^2 l0 [1 / sin^2 theta0 - (1 - eps)^alpha / tan^2 theta0] (1 - eps)",
        "dV/deps = (pi / 4) D0^2 l0 [(alpha + 1) (1 - eps)^alpha / tan^2 theta0 - 1 / sin^2 theta0]",
    ),
    source="paper 3, volume of the muscle",
    fitted=("diameter", "braid_angle", "alpha"),
    parameters=(CONTRACTION, DIAMETER, LENGTH, BRAID_ANGLE, ALPHA),
    outputs=(
        Output("volume", "V", "volume", "volume inside"),
        Output("volume_slope", "dV/deps", "volume", "change of volume by contraction"),
    ),
    references=(
        Reference("volume", "40.9", "cm3", CM3, "computed from the equations", {"contraction": -0.03}),
        Reference("volume", "62.832", "cm3", CM3, "closed form: pi D0^2 l0 / 4"),
        Reference("volume", "152.0", "cm3", CM3, "computed from the equations", {"contraction": 0.20}),
    ),
    notes=(
        "With one alpha for S and V the work of force and volume agrees only for alpha = 2: dV/deps = l0 S. With 2.6 "
        "it is 1.337 l0 S at eps = 0; the authors accept that as losses.",
        "D0 is the free diameter; the text of paper 3 calls it the diameter at theta = 90 deg once, which gives "
        "another V.",
    ),
)  # fmt: skip
def daerden_volume(contraction: Array, diameter: Array, length: Array, braid_angle: Array, alpha: Array) -> Values:
    """V and dV/deps [m3] from eps [1], D0 and l0 [m], theta0 [rad], alpha [1]."""
    size = math.pi / 4 * diameter**2 * length
    round_, straight = 1 / np.sin(braid_angle) ** 2, (1 - contraction) ** alpha / np.tan(braid_angle) ** 2
    return {
        "volume": muscle_volume(contraction, diameter, length, braid_angle, alpha),
        "volume_slope": size * ((alpha + 1) * straight - round_),
    }


@described(
    "closed-volume", FAMILY, "Volume of a closed muscle from its pressure (isothermal)",
    equation=("V = V0 (P0 + P_atm) / (P + P_atm): absolute pressures",),
    source="paper 3, volume test",
    parameters=(
        Parameter("pressure_start", "P0", "pressure", 3 * BAR, "gauge pressure when the valve was shut", 0.0, 1e6),
        Parameter("pressure", "P", "pressure", 2 * BAR, "gauge pressure now", 0.0, 1e6),
        Parameter("volume_start", "V0", "volume", 60 * CM3, "volume when the valve was shut", 0.0, above=True),
        ATMOSPHERE,
    ),
    outputs=(Output("volume", "V", "volume", "volume now"),),
    references=(Reference("volume", "79.912", "cm3", CM3, "by hand: 60 (401.325 / 301.325)"),),
    notes=(
        "Pressures are gauge, the room's is added: P V of gauge pressures is not constant and is wrong by up to 122 %.",
    ),
)  # fmt: skip
def closed_volume(pressure_start: Array, pressure: Array, volume_start: Array, atmosphere: Array) -> Values:
    """V [m3] from P0 and P [Pa gauge], V0 [m3] and P_atm [Pa absolute]."""
    return {"volume": volume_start * (pressure_start + atmosphere) / (pressure + atmosphere)}


@described(
    "three-cylinder-volume", FAMILY, "Volume from three outer diameters and the wall's thickness",
    equation=("V = sum over j of (pi / 4) (d_j - 2 t)^2 h_j",),
    source="paper 3, diameter test",
    parameters=(
        *(
            Parameter(
                f"diameter_{j}", f"d{j}", "length", d * MM, f"outer diameter at station {j}", 0.0, 1.0, above=True,
            )
            for j, d in ((1, 24.0), (2, 28.0), (3, 24.0))
        ),
        *(
            Parameter(f"height_{j}", f"h{j}", "length", h * MM, f"length of cylinder {j}", 0.0, above=True)
            for j, h in ((1, 40.0), (2, 100.0), (3, 40.0))
        ),
        Parameter("thickness", "t", "length", 2 * MM, "thickness of the wall, the same everywhere", 0.0, 0.1),
    ),
    outputs=(Output("volume", "V", "volume", "volume inside"),),
    references=(Reference("volume", "70.372", "cm3", CM3, "by hand: (pi / 4) (2 * 20^2 * 40 + 24^2 * 100) mm3"),),
)  # fmt: skip
def three_cylinder_volume(
    diameter_1: Array, diameter_2: Array, diameter_3: Array, height_1: Array, height_2: Array, height_3: Array,
    thickness: Array,
) -> Values:  # fmt: skip
    """V [m3] from outer diameters, heights and thickness [m]."""
    pairs = ((diameter_1, height_1), (diameter_2, height_2), (diameter_3, height_3))
    for number, (diameter, _) in enumerate(pairs, 1):
        refuse("thickness", f"the wall is thicker than diameter_{number} allows", diameter <= 2 * thickness)
    volumes = [np.asarray(math.pi / 4 * (diameter - 2 * thickness) ** 2 * height) for diameter, height in pairs]
    return {"volume": volumes[0] + volumes[1] + volumes[2]}
