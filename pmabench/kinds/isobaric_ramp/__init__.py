"""Slow ramps of displacement at constant pressure: F over contraction, K, loop gap and work; the rubber at 0 kPa.

- `reduction`, with the rubber
- `cell`: one pressure and stroke; `coefficients`: its values and doubts about them; `creep`: the most creep that its
  cycles allow
- protocol files: `protocol`; figures and one trial on the display: `figures`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("B", "damping, mean of both directions", "damping", headline=True, plot="Damping", positive=True),
    Result("F_c", "Coulomb friction", "force", headline=True, positive=True),
    Result("F", "force", "force", headline=True),
    Result("H", "loop width", "force"),
    Result("W", "loop area, energy lost per cycle", "work", positive=True),
    Result("W_c", "work given while contracting", "work"),
    Result("eta", "work given back, of the work taken up", "ratio", positive=True),
    Result("F_e", "force of the rubber without pressure", "force"),
    Result("A", "size of the rubber term", "force"),
    Result("B1", "contraction at which the rubber term is 0 again", "ratio"),
    Result("B2", "pole of the rubber term", "ratio"),
)
METHODS = {
    "mean-curve": (
        "Mean of the contracting and the expanding branch at constant pressure (paper 3), taken to speed 0 by a line "
        "over the speed. How the branches turn into each other is fitted to the gap between them, exponentially over "
        "the way, and taken off. K is minus the slope of a line through it, F_ce its force at x = 0. Both are those "
        "after creep, but for what was over before the record begins or takes more than twice as long as the test."
    ),
    "mean-curve, turns left in": (
        "As mean-curve, the plain mean of the branches, as paper 3 has it: near the ends it still holds how one branch "
        "turns into the other."
    ),
    "mean-curve, local": "As mean-curve, at places along the stroke by a cubic through the points around each.",
    "loop-gap": (
        "Force while expanding minus force while contracting at mid stroke, above 0 where the contracting branch is the"
        " lower one: 2 F_c + (B_c + B_r) v, a straight line over the speed v. What is left at speed 0 is true "
        "hysteresis. W is the area of the loop, W_c the work given while contracting, eta its share of what is taken up"
        " while expanding; air is not measured, so eta is no efficiency of the drive."
    ),
    "rubber term": (
        "F_e = A ε (ε − B1)/(ε + B2) (paper 3, eq. 8) by least squares through the mean curve at 0 kPa, ε by the "
        "nominal length."
    ),
}
POINT = (("lower", "lowest end"), ("upper", "highest end"), ("speed", "speed"), ("cycles", "pairs"),
         ("pressure", "held"))  # fmt: skip
"""How the operating point is taken from the commands of an import."""
KIND = Kind(
    name="isobaric-ramp",
    title="Isobaric ramps",
    order=50,
    reverses=True,
    results=RESULTS,
    reduction="pmabench.kinds.isobaric_ramp.reduction:reduce",
    papers=("paper 3, isobaric loops",),
    protocol="pmabench.kinds.isobaric_ramp.protocol:IsobaricRamp",
    live="pmabench.kinds.isobaric_ramp.figures:measure",
    moves="displacement",
    regulated=False,
    repeated="pmabench.analysis.shared.ramp_loop:stiffness_of",
    repeated_is="stiffness",
    drifts="force",
    word="isobaric",
    offers="pmabench.kinds.isobaric_ramp.reduction:offers",
    instead="an isobaric ramp (isobaric-ramp) measures the curve itself",
    methods=METHODS,
    figures={
        **dict.fromkeys(("isobaric", "mean-curve"), "pmabench.kinds.isobaric_ramp.figures:loops"),
        "rubber": "pmabench.kinds.isobaric_ramp.figures:rubber",
    },
    front={"isobaric": "pmabench.kinds.isobaric_ramp.figures:loops"},
    published=dict.fromkeys(("mean-curve", "isobaric", "rubber"), ("displacement", "force", "pressure")),
    parts={"slow rows": "pmabench.analysis.surface.trials:driven"},
    imported=Imported(
        Commanded("displacement", phases=(("rises", "contract"), ("any", "expand")), point=POINT),
        follows="force",
        shown="length ramps",
    ),
)
