"""Slow sweeps of a joint's angle with constant pressures of its two muscles: torque, stiffness, gap and loop area.

- `reduction`: one trial, then all; figure
- protocol files: `protocol`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("K_th", "torsional stiffness of the joint", "torsional stiffness", headline=True, positive=True),
    Result("H_tau", "gap of the torque between the branches", "torque", headline=True, positive=True),
    Result("W", "loop area, energy lost per cycle", "work", positive=True),
    Result("tau", "torque of the joint", "torque"),
)
METHODS = {
    "branches, 3 w cut": (
        "Slope at mid sweep of a cubic through each branch, with its sign changed; the mean of both branches. 3 w "
        "after each turn are left out, w being the angle on which a turn fades to 1/e, from the gap of the record. "
        "What is left of the turns there is taken off, and what that changed is in the interval. It is the stiffness "
        "at the speed of the sweep: what creeps more slowly than a sweep takes counts as stiff, and so do turns that "
        "fade on a longer way, which are in the interval where the gap shows them."
    ),
    "loop": (
        "Gap: torque while the angle falls minus torque while it rises, at mid sweep, at the speed of the sweep: the "
        "damping of the muscles is in it. W is the area of the loop."
    ),
    "mean curve": "Mean of both branches without what the turns leave in it, at places along the sweep.",
}
KIND = Kind(
    name="joint-sweep",
    title="Sweeps of a joint",
    order=95,
    papers=("paper 3, its muscle model in a pair",),
    reverses=True,
    results=RESULTS,
    reduction="pmabench.kinds.joint_sweep.reduction:reduce",
    protocol="pmabench.kinds.joint_sweep.protocol:JointSweep",
    live="pmabench.kinds.reduce:of_one_trial",
    moves="angle",
    repeated="pmabench.kinds.joint_sweep.reduction:stiffness_of",
    repeated_is="stiffness",
    methods=METHODS,
    figures={"joint-loop": "pmabench.kinds.joint_sweep.reduction:loops"},
)
