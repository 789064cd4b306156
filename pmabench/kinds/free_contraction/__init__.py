"""The length of a muscle without load over pressure.

- `points`: pressure and contraction of each trial, the curve over pressure; `reduction`
- protocol files: `protocol`; sentences and figures: `figures`; one trial on the display: `reduction`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("eps_max", "largest contraction without load, of the nominal length", "ratio", headline=True),
    Result("L", "length without load", "length", headline=True),
    Result("x_H", "contraction reached from above less from below", "length"),
    Result("P_half", "pressure of half the largest contraction", "pressure", headline=True),
)
METHODS = {
    "free-length": (
        "Nominal length less the contraction at rest, the mean over the last fifth of each hold and of both sides from "
        "which the pressure was reached (from 0, and from the highest pressure), each trial carried "
        "to the set-point along the sigmoid and what the points are off it. P_half is where half of the "
        "contraction at the highest pressure is reached, by monotone cubics through the points."
    ),
    "sigmoid": (
        "L = a + b / [1 + (p/c)^d]^e − 0.009 L0 √p (paper 2, eq. 1) by least squares through the lengths at all "
        "pressures, the mean of trials by the sigmoid itself; intervals by the profile of the sum of squares, if L has "
        "this form."
    ),
}
KIND = Kind(
    name="free-contraction",
    title="Free contraction",
    order=110,
    results=RESULTS,
    reduction="pmabench.kinds.free_contraction.reduction:reduce",
    papers=("paper 2, eqs. 1-2",),
    protocol="pmabench.kinds.free_contraction.protocol:FreeContraction",
    live="pmabench.kinds.free_contraction.reduction:one_trial",
    moves="displacement",
    repeated="pmabench.kinds.free_contraction.reduction:contraction_of",
    repeated_is="contraction",
    drifts="displacement",
    word="free contraction",
    offers="pmabench.kinds.free_contraction.reduction:offers",
    methods=METHODS,
    figures={"free-contraction": "pmabench.kinds.free_contraction.figures:lengths"},
    imported=Imported(
        Commanded(
            "pressure",
            phases=(("leaves", "vent"), ("rises", "fill"), ("any", "empty")),
            point=(("pressure", "reached"), ("side", "side")),
            ramps=True,
            still=True,
        ),
        follows="displacement",
    ),
)
