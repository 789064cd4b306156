"""A step to a pressure at a set contraction, held for minutes: relaxation of the rubber.

- `relaxing`: the force after a step, with a straight line over log t, exponentials and their noise
- `vented`: what the cell reads before and after the hold: its zero, and the muscle's own recovery
- `course`: one trial, and what else than the rubber may have changed its force
- `reduction`: all trials of a point; figure and one trial on the display
- protocol files: `protocol`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("s", "relaxation of the force per decade of time", "ratio", headline=True),
    Result("F_1", "force one second after the step", "force"),
    Result("g", "share of the force that relaxes with a time constant", "ratio"),
)
METHODS = {
    "relaxation, log t": (
        "F = F_1 (1 − s log10(t/1 s)) from a begin on, F multiplied by the mean pressure over the measured one; a "
        "straight line through means over equal parts of log t. The noise of neighbouring samples counts with its "
        "correlation."
    ),
    "relaxation, Prony": (
        "F = F_1 [g_0 + Σ g_j exp(−t/T_j)] with T_j of 1, 10, 100 and 1000 s, non-negative least squares through the "
        "same means. Time constants that the hold does not show are withheld. The interval is that of all terms "
        "together, from what the exponentials leave of the samples: wide where the muscle relaxes otherwise."
    ),
}
PHASES, POINT = (("to the highest", "step"), ("any", "vent")), (("contraction", "length"), ("pressure", "highest"))
"""Names for the commands of an import, and how the operating point is taken from them."""
KIND = Kind(
    name="relaxation",
    title="Relaxation",
    order=65,
    results=RESULTS,
    reduction="pmabench.kinds.relaxation.reduction:reduce",
    papers=("paper 4, relaxation of the rubber",),
    protocol="pmabench.kinds.relaxation.protocol:Relaxation",
    live="pmabench.kinds.relaxation.reduction:one_trial",
    moves="force",
    repeated="pmabench.kinds.relaxation.reduction:per_decade",
    repeated_is="relaxation per decade",
    word="relaxation",
    methods=METHODS,
    figures={"relaxation": "pmabench.kinds.relaxation.reduction:courses"},
    imported=Imported(Commanded("pressure", phases=PHASES, point=POINT), follows="force"),
)
