"""Loads of a muscle: end stops, force, mass, spring, imposed displacement; Coulomb friction and hysteresis."""

from __future__ import annotations

import math

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import MM
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse
from pmabench.model.library.three_element import DAMPING, FORCE_CE, LOAD, STIFFNESS

FAMILY = "load"
G = 9.81
"""Gravity as in paper 0: 10.79 N / 1.1 kg [m/s2]."""

ACCELERATION = Parameter("acceleration", "x''", "acceleration", 0.0, "acceleration of contraction")
CELL = Output("force", "F", "force", "pull on the muscle, what a cell reads")


@described(
    "end-stops", FAMILY, "A muscle at rest between the support at x = 0 and its own stop",
    equation=(
        "x = (F_ce - F_L) / K, held to 0 to x_stop;  support carries max(F_L - F_ce, 0) at x = 0",
        "stop takes max(F_ce - K x_stop - F_L, 0);  the cell reads min(F_ce, F_L) on the support",
    ),
    source="the simulated bench: loads land without rebound",
    parameters=(
        FORCE_CE, LOAD, STIFFNESS,
        Parameter("stop", "x_stop", "length", 70 * MM, "contraction at the stop", 0.0, above=True),
    ),
    outputs=(
        Output("displacement", "x", "length", "contraction"),
        Output("support", "", "force", "what the support carries"),
        Output("stop_force", "", "force", "what the stop takes"),
        CELL,
    ),
    references=(
        Reference("displacement", "40.60", "mm", MM, "table of plant paper0 at 300 kPa, 0 N"),
        Reference("support", "25", "N", 1.0, "by hand: 300 - 275", {"load": 300.0}),
        Reference("force", "275", "N", 1.0, "the cell reads F_ce while the support carries the rest", {"load": 300.0}),
        Reference("stop_force", "207.27", "N", 1.0, "by hand: 275 - 6.773 10", {"stop": 10 * MM}),
    ),
)  # fmt: skip
def end_stops(force_ce: Array, load: Array, stiffness: Array, stop: Array) -> Values:
    """X [m], support, stop and cell force [N] from F_ce and F_L [N], K [N/m], x_stop [m]."""
    x = np.clip((force_ce - load) / stiffness, 0, stop)
    support = np.maximum(load - force_ce, 0)
    held = np.maximum(force_ce - stiffness * x - load, 0) * (x >= stop)
    return {"displacement": x, "support": support, "stop_force": held, "force": np.minimum(force_ce, load) + held}


@described(
    "load-force", FAMILY, "A force that stays, with a moving mass",
    equation=("F = F_L + M x''",),
    source="the simulated bench: a load in N moves 0.5 kg",
    parameters=(LOAD, Parameter("mass", "M", "mass", 0.5, "moving mass", 0.0, INF, "", "assumed"), ACCELERATION),
    outputs=(CELL,),
    references=(
        Reference("force", "60", "N", 1.0, "by hand: 58.86 + 0.5 2.28", {"load": 58.86, "acceleration": 2.28}),
    ),
)  # fmt: skip
def load_force(load: Array, mass: Array, acceleration: Array) -> Values:
    """F [N] from F_L [N], M [kg], x'' [m/s2]."""
    return {"force": load + mass * acceleration}


@described(
    "load-hanging-mass", FAMILY, "Weights that hang on the muscle, with their inertia",
    equation=("F = m g + (m + m_0) x'';  g = 9.81 m/s2",),
    source="paper 0, weight stack (10.79 N / 1.1 kg); m_0 assumed",
    parameters=(
        Parameter("mass", "m", "mass", 6.0, "mass that hangs", 0.0),
        Parameter("table", "m_0", "mass", 2.0, "what moves without hanging", 0.0, INF, "", "assumed"),
        Parameter(
            "acceleration", "x''", "acceleration", 0.0, "acceleration of contraction", -G, INF, "the cable would be "
            "slack"
        ),
    ),
    outputs=(CELL, Output("weight", "F_L", "force", "weight"), Output("moving", "M", "mass", "moving mass")),
    references=(
        Reference("weight", "58.86", "N", 1.0, "lowest load printed in paper 0"),
        Reference("weight", "545.44", "N", 1.0, "highest load printed in paper 0: 55.6 kg", {"mass": 55.6}),
        Reference("force", "66.86", "N", 1.0, "by hand: 58.86 + 8", {"acceleration": 1.0}),
    ),
    notes=("As mass the whole stack counts: M compared with B^2 / (4 K) decides whether a step is still first order.",),
)  # fmt: skip
def load_hanging_mass(mass: Array, table: Array, acceleration: Array) -> Values:
    """F and F_L [N], M [kg] from m and m_0 [kg], x'' [m/s2]."""
    moving = mass + table
    return {"force": mass * G + moving * acceleration, "weight": mass * G, "moving": moving}


@described(
    "load-spring", FAMILY, "A spring with preload, and where the muscle comes to rest against it",
    equation=("F = F_0 + c x;  at rest x = (F_ce - F_0) / (K + c)",),
    source="closed form",
    parameters=(
        FORCE_CE, STIFFNESS,
        Parameter("rate", "c", "stiffness", 2e3, "stiffness of the spring", 0.0),
        Parameter("preload", "F_0", "force", 50.0, "its force at x = 0", 0.0),
    ),
    outputs=(Output("displacement", "x", "length", "contraction at rest"), CELL),
    references=(
        Reference("displacement", "25.647", "mm", MM, "by hand: 225 / 8.773"),
        Reference("force", "101.29", "N", 1.0, "by hand: 50 + 2 25.647"),
    ),
)  # fmt: skip
def load_spring(force_ce: Array, stiffness: Array, rate: Array, preload: Array) -> Values:
    """X [m] and F [N] from F_ce [N], K and c [N/m], F_0 [N]; no motion where F_ce <= F_0."""
    x = np.maximum(force_ce - preload, 0) / (stiffness + rate)
    return {"displacement": x, "force": np.minimum(preload, force_ce) * (x <= 0) + (preload + rate * x) * (x > 0)}


@described(
    "load-imposed", FAMILY, "A sine of displacement that an actuator imposes, and the force that it meets",
    equation=(
        "x = x_m + A sin(2 pi f t);  F = F_ce - K x - B x' - F_c sign(x'), not below 0",
    ),
    source="paper 3, sinusoidal displacement, with the coefficients of paper 0",
    parameters=(
        Parameter("time", "t", "time", 0.0, "since the start", 0.0),
        Parameter("mean", "x_m", "length", 20 * MM, "middle of the sine", 0.0),
        Parameter("amplitude", "A", "length", 10 * MM, "amplitude", 0.0),
        Parameter("frequency", "f", "frequency", 0.5, "of the sine", 0.0, above=True),
        FORCE_CE, STIFFNESS, DAMPING,
        Parameter("kinetic", "F_c", "force", 6.0, "Coulomb friction", 0.0, INF, "", "assumed"),
    ),
    outputs=(
        Output("displacement", "x", "length", "contraction"),
        Output("speed", "x'", "speed", "its rate"),
        CELL,
    ),
    references=(
        Reference("speed", "31.416", "mm/s", MM, "closed form: 2 pi 0.5 10"),
        Reference("force", "80.76", "N", 1.0, "by hand: 275 - 135.46 - 1.68 31.416 - 6"),
    ),
)  # fmt: skip
def load_imposed(
    time: Array,
    mean: Array,
    amplitude: Array,
    frequency: Array,
    force_ce: Array,
    stiffness: Array,
    damping: Array,
    kinetic: Array,
) -> Values:
    """X [m], x' [m/s], F [N] from t [s], x_m and A [m], f [Hz], F_ce and F_c [N], K [N/m], B [N.s/m]."""
    refuse("amplitude", "the muscle would be stretched: it must not be above mean", amplitude > mean)
    omega = 2 * math.pi * frequency
    x, speed = mean + amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time)
    force = force_ce - stiffness * x - damping * speed - kinetic * np.sign(speed)
    return {"displacement": x, "speed": speed, "force": np.maximum(force, 0)}


FRICTION_FAMILY = "friction and hysteresis"

HEIGHT = Parameter("height", "H", "force", 30.0, "half the gap of a wide loop", 0.0, INF, "", "assumed")
WIDTH = Parameter(
    "width", "w", "ratio", 0.006, "contraction over which a reversal fades to 1/e", 0.0, 1.0, "", "assumed", above=True
)
HYSTERESIS = Output("force", "F_h", "force", "added to the force of the model")


@described(
    "coulomb-stiction", FRICTION_FAMILY, "Coulomb friction with stiction",
    equation=(
        "at rest: f = drive, at most F_s;  moving: f = sign(v) max(F_c, F_s - (F_s - F_c) |v| / v_c)",
    ),
    source="the simulated bench; F_s = 10 N and F_c = 6 N are assumed",
    parameters=(
        Parameter("speed", "v", "speed", 0.0, "rate of contraction"),
        Parameter("drive", "", "force", 8.0, "force out of balance without friction"),
        Parameter("static", "F_s", "force", 10.0, "most at rest", 0.0, INF, "", "assumed"),
        Parameter("kinetic", "F_c", "force", 6.0, "while moving", 0.0, INF, "", "assumed"),
        Parameter("knee", "v_c", "speed", 1e-3, "speed from which on it is F_c", 0.0, 10.0, "", "assumed", above=True),
    ),
    outputs=(
        Output("friction", "f", "force", "friction, against the motion or the drive"),
        Output("left", "", "force", "drive less friction: what accelerates"),
    ),
    references=(
        Reference("friction", "8", "N", 1.0, "it holds up to F_s"),
        Reference("friction", "10", "N", 1.0, "it holds no more than F_s", {"drive": 12.0}),
        Reference("friction", "-8", "N", 1.0, "halfway down the straight line", {"speed": -0.5e-3}),
        Reference("friction", "6", "N", 1.0, "above the knee", {"speed": 2e-3}),
    ),
)  # fmt: skip
def coulomb_stiction(speed: Array, drive: Array, static: Array, kinetic: Array, knee: Array) -> Values:
    """F and drive - f [N] from v [m/s], drive, F_s and F_c [N], v_c [m/s]."""
    refuse("kinetic", "it must not be above static", kinetic > static)
    fall = (static - kinetic) / knee
    moving = np.sign(speed) * np.maximum(kinetic, static - fall * np.abs(speed))
    friction = np.where(speed == 0, np.clip(drive, -static, static), moving)
    return {"friction": friction, "left": drive - friction}


@described(
    "hysteresis-branch", FRICTION_FAMILY, "Hysteresis after a reversal, by the way gone alone",
    equation=(
        "F_h = s H + (F_0 - s H) exp(-|eps - eps_0| / w);  s = -1 contracting (eps > eps_0), +1 expanding",
    ),
    source="Dahl 1968 (solid friction, exponent 1): rate-independent; paper 3 shows the loop, contracting branch lower",
    parameters=(
        Parameter("contraction", "eps", "ratio", 0.05, "contraction", -0.1, 0.5),
        Parameter("reversal", "eps_0", "ratio", 0.0, "where it turned last", -0.1, 0.5),
        Parameter("force_start", "F_0", "force", 30.0, "F_h there"),
        HEIGHT, WIDTH,
    ),
    outputs=(HYSTERESIS,),
    references=(
        Reference("force", "-7.927", "N", 1.0, "closed form: 30 (-1 + 2/e)", {"contraction": 0.006}),
        Reference("force", "30", "N", 1.0, "the reversal", {"contraction": 0.0}),
    ),
)  # fmt: skip
def hysteresis_branch(contraction: Array, reversal: Array, force_start: Array, height: Array, width: Array) -> Values:
    """F_h [N] from eps and eps_0 [1], F_0 and H [N], w [1]."""
    refuse("force_start", "it cannot be larger than height", np.abs(force_start) > height)
    end = -np.sign(contraction - reversal) * height
    return {"force": end + (force_start - end) * np.exp(-np.abs(contraction - reversal) / width)}


@described(
    "hysteresis-loop", FRICTION_FAMILY, "The same in a steady loop between two contractions",
    equation=(
        "contracting: F_h = -H + (F_t + H) exp(-(eps - eps_low) / w);  expanding: mirrored",
        "F_t = H tanh((eps_high - eps_low) / (2 w)) at the turns;  gap = expanding - contracting",
    ),
    source="Dahl 1968; height and width assumed so that the gap of paper 3, about 60 N, comes out",
    fitted=("height", "width"),
    parameters=(
        Parameter("contraction", "eps", "ratio", 0.085, "contraction", -0.1, 0.5),
        Parameter("contraction_low", "eps_low", "ratio", -0.03, "lower turn", -0.1, 0.5),
        Parameter("contraction_high", "eps_high", "ratio", 0.20, "upper turn", -0.1, 0.5),
        HEIGHT, WIDTH,
    ),
    outputs=(
        Output("contracting", "", "force", "F_h while it contracts"),
        Output("expanding", "", "force", "F_h while it expands"),
        Output("gap", "", "force", "expanding less contracting"),
    ),
    references=(
        Reference("gap", "60", "N", 1.0, "gap that paper 3 shows at 5 bar"),
        Reference("gap", "0", "N", 1.0, "the branches meet at the turn", {"contraction": 0.2}),
    ),
)  # fmt: skip
def hysteresis_loop(
    contraction: Array, contraction_low: Array, contraction_high: Array, height: Array, width: Array
) -> Values:
    """F_h of both branches and the gap [N] from contractions [1], H [N], w [1]."""
    outside = (contraction < contraction_low) | (contraction > contraction_high)
    refuse("contraction", "it must be between the turns", outside, contraction)
    turn = height * np.tanh((contraction_high - contraction_low) / (2 * width))
    down = -height + (turn + height) * np.exp(-(contraction - contraction_low) / width)
    up = height - (turn + height) * np.exp(-(contraction_high - contraction) / width)
    return {"contracting": down, "expanding": up, "gap": up - down}
