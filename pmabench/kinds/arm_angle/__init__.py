"""The bending angle of an arm of muscles over pressure and load.

- `reduction`, on the rests of `stairs`
- protocol files: `protocol`; sentences, figures and one trial on the display: `figures`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("alpha_0", "bending angle at the preload", "angle"),
    Result("alpha_max", "largest bending angle", "angle", headline=True),
    Result("P_flat", "pressure from which on the angle stays within 1° of its largest", "pressure", headline=True),
    Result("alpha_H", "angle reached from above less from below", "angle", headline=True),
    Result("alpha_b", "bending angle", "angle"),
)
METHODS = {
    "angle-at-rest": (
        "Mean over the last fifth of each hold; α0 and αmax on the way up, as in paper 2. P_flat by monotone cubics "
        "through the way up; αH where it is widest. The method part of αmax holds half of αH: at the top one way only "
        "is known."
    ),
    "logistic-up": (
        "α = a + b / [1 + (p/c)^d] (paper 2, second eqs. 10) by least squares through the way up, as paper 2 does; "
        "without intervals, and only where the angles have this form."
    ),
    "logistic-loads": (
        "The same with a, b, c, d as powers of the load up to the fourth, through the ways up of all loads at once: "
        "paper 2's 20 numbers."
    ),
}
KIND = Kind(
    name="arm-angle",
    title="Bending angle of an arm",
    order=120,
    results=RESULTS,
    reduction="pmabench.kinds.arm_angle.reduction:reduce",
    papers=("paper 2, arm of four contractors",),
    protocol="pmabench.kinds.arm_angle.protocol:ArmAngle",
    live="pmabench.kinds.arm_angle.figures:measure",
    moves="angle",
    methods=METHODS,
    figures={
        "arm-angle": "pmabench.kinds.arm_angle.figures:angles",
    },
)
