"""Steps and sines of a joint's angle in closed loop, with both muscles pulling.

- `reduction`: one trial, then all of a point; figure
- protocol files: `protocol`: pressures by a model or a measured map
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("e_th", "end error of the angle", "angle", headline=True),
    Result("t_s", "settling time", "time", headline=True),
    Result("t_r", "rise time", "time"),
    Result("OS_th", "overshoot of the angle", "angle"),
    Result("g_th", "angle over reference", "ratio", headline=True),
    Result("phi_th", "phase of the angle against the reference", "angle", headline=True),
    Result("e_s", "error along a sine, rms", "angle"),
)
METHODS = {
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
KIND = Kind(
    name="joint-step",
    title="Joint in closed loop",
    order=96,
    papers=("paper 3, its muscle model in a pair",),
    results=RESULTS,
    reduction="pmabench.kinds.joint_step.reduction:reduce",
    protocol="pmabench.kinds.joint_step.protocol:JointStep",
    live="pmabench.kinds.reduce:of_one_trial",
    moves="angle",
    methods=METHODS,
    figures={"joint-step": "pmabench.kinds.joint_step.reduction:courses"},
    loop=True,
)
