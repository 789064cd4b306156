"""Two muscles against each other: a joint that is locked at angles, swept, and held in closed loop.

Three kinds of test:

- joint-torque, torque at locked angles for pairs of pressures: `torque`, made of `staircase` (one trial)
- joint-sweep, slow sweeps with the pressures held: `sweep`; protocol files of both: `protocol`
- joint-step, steps and sines in closed loop: `step`; `step_protocol`: pressures by a model or a measured map
- figures and one trial on the display: `figures`
"""

from pmabench.base.kind import Kind, Result

PAPERS = ("paper 3, its muscle model in a pair",)
K_TH = Result("K_th", "torsional stiffness of the joint", "torsional stiffness", headline=True)
H_TAU = Result("H_tau", "gap of the torque between the branches", "torque", headline=True)
OF_TORQUE = (
    K_TH,
    H_TAU,
    Result("tau", "torque of the joint", "torque", headline=True),
    Result("s_1", "torque by the pressure of muscle 1", "torque per pressure"),
    Result("s_2", "torque by the pressure of muscle 2", "torque per pressure"),
    Result("tau_0", "torque that does not depend on the pressures", "torque"),
)
OF_SWEEP = (
    K_TH,
    H_TAU,
    Result("W", "loop area, energy lost per cycle", "work", positive=True),
    Result("tau", "torque of the joint", "torque"),
)
OF_STEP = (
    Result("e_th", "end error of the angle", "angle", headline=True),
    Result("t_s", "settling time", "time", headline=True),
    Result("t_r", "rise time", "time"),
    Result("OS_th", "overshoot of the angle", "angle"),
    Result("g_th", "angle over reference", "ratio", headline=True),
    Result("phi_th", "phase of the angle against the reference", "angle", headline=True),
    Result("e_s", "error along a sine, rms", "angle"),
)
METHODS_OF_SWEEP = {
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
METHODS_OF_STEP = {
    "step in closed loop": (
        "e_th is the mean of angle minus goal in the stated window; t_s the time from which on the angle stays within "
        "the stated band about the goal; t_r from 10 to 90 % of the step, which begins at the angle held before it. "
        "The filter that the angle declares (sensor_lag) is undone first."
    ),
    "sine in closed loop": (
        "Least squares of mean, cosine and sine at the known frequency, cycle by cycle within the stated window, over "
        "the sine that the loop was to follow; the phase is below 0 where the angle is late."
    ),
}
METHODS_OF_TORQUE = {
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
SWEEP = Kind(
    name="joint-sweep",
    title="Sweeps of a joint",
    order=95,
    papers=PAPERS,
    reverses=True,
    results=OF_SWEEP,
    reduction="pmabench.kinds.joint.sweep:reduce",
    protocol="pmabench.kinds.joint.protocol:JointSweep",
    live="pmabench.kinds.joint.figures:measure_sweep",
    moves="angle",
    repeated="pmabench.kinds.joint.sweep:stiffness_of",
    repeated_is="stiffness",
    methods=METHODS_OF_SWEEP,
    figures={"joint-loop": "pmabench.kinds.joint.figures:loops"},
)
STEP = Kind(
    name="joint-step",
    title="Joint in closed loop",
    order=96,
    papers=PAPERS,
    results=OF_STEP,
    reduction="pmabench.kinds.joint.step:reduce",
    protocol="pmabench.kinds.joint.step_protocol:JointStep",
    live="pmabench.kinds.joint.figures:measure_step",
    moves="angle",
    methods=METHODS_OF_STEP,
    figures={"joint-step": "pmabench.kinds.joint.figures:courses"},
    loop=True,
)
KIND = Kind(
    name="joint-torque",
    title="Isometric torque of a joint",
    order=94,
    papers=PAPERS,
    results=OF_TORQUE,
    reduction="pmabench.kinds.joint.torque:reduce",
    protocol="pmabench.kinds.joint.protocol:JointTorque",
    live="pmabench.kinds.joint.figures:measure_torque",
    moves="angle",
    repeated="pmabench.kinds.joint.torque:gap_of",
    repeated_is="gap",
    methods=METHODS_OF_TORQUE,
    figures={"joint-map": "pmabench.kinds.joint.figures:maps"},
    front={"joint-map": "pmabench.kinds.joint.figures:maps"},
    also=(SWEEP, STEP),
)
