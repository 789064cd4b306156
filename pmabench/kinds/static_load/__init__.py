"""The pressures at which loads lift off and set down: F_ce over pressure.

- `reduction`, made of `points` (lift and set-down, corrected to x = 0) and `line` (F_ce over pressure, by each
  direction and their mean, corrected for hysteresis)
- protocol files: `protocol`; sentences, figures and one trial on the display: `figures`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("F_f", "friction, half the difference of both directions", "force", positive=True),
)
METHODS = {
    "static-mean": (
        "F_ce(P) from the mean of the pressures at which each load lifts off its support and sets down again: friction "
        "acts in opposite directions and drops out. Least squares of pressure on load."
    ),
    "static-lift": "As static-mean, from the lift-off alone: F_ce comes out low by the friction.",
    "static-set-down": "As static-mean, from the set-down alone: F_ce comes out high by the friction.",
    "static-half-difference": (
        "Half the difference of lift-off and set-down, as a force: friction between sliding and static."
    ),
}
KIND = Kind(
    name="static-load",
    title="Static load",
    order=10,
    results=RESULTS,
    reduction="pmabench.kinds.static_load.reduction:reduce",
    papers=("paper 0, static study",),
    protocol="pmabench.kinds.static_load.protocol:StaticLoad",
    live="pmabench.kinds.static_load.figures:measure",
    moves="displacement",
    repeated="pmabench.kinds.static_load.points:mean_pressure",
    repeated_is="pressure at which the load is lifted",
    word="static load",
    offers="pmabench.kinds.static_load.reduction:offers",
    after="pmabench.kinds.static_load.points:option_of",
    methods=METHODS,
    figures={"static": "pmabench.kinds.static_load.figures:points", "lift": "pmabench.kinds.static_load.figures:lifts"},
    imported=Imported(
        Commanded("pressure", phases=(("rises", "lift"), ("any", "set-down"))),
        follows="displacement",
        loaded=True,
        lifted=True,
    ),
)
