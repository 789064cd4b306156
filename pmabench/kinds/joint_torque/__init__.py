"""Isometric torque of a joint over its angle for pairs of pressures: maps of torque and stiffness.

- `reduction`: all trials of a pair of pressures, made of `staircase` (one trial); figure
- protocol files: `protocol`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("K_th", "torsional stiffness of the joint", "torsional stiffness", headline=True),
    Result("H_tau", "gap of the torque between the branches", "torque", headline=True),
    Result("tau", "torque of the joint", "torque", headline=True),
    Result("s_1", "torque by the pressure of muscle 1", "torque per pressure"),
    Result("s_2", "torque by the pressure of muscle 2", "torque per pressure"),
    Result("tau_0", "torque that does not depend on the pressures", "torque"),
)
METHODS = {
    "both sides": (
        "Mean of the torques that the joint holds at an angle reached from below and from above, in the later half of "
        "each rest. w, the angle on which a turn fades to 1/e, is from the torque while the joint moves; an angle "
        "within 3 w of a turn has no value. What is left of the turns is taken off, and is in the interval."
    ),
    "gap": (
        "Torque with the angle reached from above minus that from below, at the angle farthest from both turns. "
        "Withheld where torques move in their rests, pressures or angles differ between the sides, or the turns show "
        "play between encoder and joint, by more than 2 %."
    ),
    "polynomial": (
        "Minus the slope of a polynomial of order 5 of torque over angle; its difference from that of order 3 is in "
        "the interval, and so is by how much encoder and drive disagree on the way."
    ),
    "plane": (
        "Least squares of tau = tau_0 + s_1 P_1 - s_2 P_2 over the pairs of pressures of one angle. Withheld where a "
        "torque is off the plane by more than noise and pressures explain: at a slack muscle the torque has a kink."
    ),
}
KIND = Kind(
    name="joint-torque",
    title="Isometric torque of a joint",
    order=94,
    papers=("paper 3, its muscle model in a pair",),
    results=RESULTS,
    reduction="pmabench.kinds.joint_torque.reduction:reduce",
    protocol="pmabench.kinds.joint_torque.protocol:JointTorque",
    live="pmabench.kinds.reduce:of_one_trial",
    moves="angle",
    repeated="pmabench.kinds.joint_torque.reduction:gap_of",
    repeated_is="gap",
    methods=METHODS,
    figures={"joint-map": "pmabench.kinds.joint_torque.reduction:maps"},
    front={"joint-map": "pmabench.kinds.joint_torque.reduction:maps"},
)
