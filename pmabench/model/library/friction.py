"""Friction and hysteresis of a muscle: Coulomb with stiction, and one hysteresis that knows no rate."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse

FAMILY = "friction and hysteresis"

HEIGHT = Parameter("height", "H", "force", 30.0, "half the gap of a wide loop", 0.0, INF, "", "assumed")
WIDTH = Parameter(
    "width", "w", "ratio", 0.006, "contraction over which a reversal fades to 1/e", 0.0, 1.0, "", "assumed", above=True
)
HYSTERESIS = Output("force", "F_h", "force", "added to the force of the model")


@described(
    "coulomb-stiction", FAMILY, "Coulomb friction with stiction",
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
    "hysteresis-branch", FAMILY, "Hysteresis after a reversal, by the way gone alone",
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
    "hysteresis-loop", FAMILY, "The same in a steady loop between two contractions",
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


def hysteresis_path(contraction: Array, height: float, width: float, start: float = 0.0) -> Array:
    """F_h [N] along a path of contractions [1], shape (n,), from F_h = `start` [N] on; what lies between is "
    "monotone.
    """
    force = np.empty(len(contraction))
    last, at = start, float(contraction[0])
    for index, eps in enumerate(np.asarray(contraction, dtype=np.float64).tolist()):
        end = -float(np.sign(eps - at)) * height
        last = end + (last - end) * float(np.exp(-abs(eps - at) / width)) if eps != at else last
        force[index], at = last, eps
    return force
