"""Steps of attitude of a platform that is tilted by three muscles: settling time, overshoot, end error, valve openings.

- `reduction`: one step, checks of the accelerometer; then all steps of an attitude; the figure
- protocol files: `protocol`
"""

from pmabench.base.kind import Kind, Result

MUSCLES = ("pressure_1", "pressure_2", "pressure_3")
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
VALVES = tuple(f"{kind}_{i}" for i in (1, 2, 3) for kind in ("fill", "exhaust"))
RESULTS = (
    Result("t_1", "time to within 1 deg of the attitude", "time", headline=True),
    Result("OS_q", "overshoot of the attitude", "angle", headline=True, positive=True),
    Result("e_q", "end error of the attitude", "angle", headline=True, positive=True),
    Result("n_v", "openings a second of the busiest valve", "frequency", headline=True),
)
METHODS = {
    "chain reference": (
        "The attitude is that of the accelerometer, with what its height above the joint adds taken off: both "
        "directions of time through a lag of sqrt(h / g). t_1: after it the attitude stays within 1 deg. OS_q: "
        "furthest way beyond the attitude, in its direction. e_q: distance of the mean of the last second. n_v: pulses "
        "that follow each other without a pause count as one opening. Muscles' contractions come from the reference."
    ),
    "chain measured": "The same, with the muscles' contractions from the measured attitude, as paper 3 prints it.",
}
KIND = Kind(
    name="platform-step",
    title="Platform of three muscles",
    order=97,
    papers=("paper 3, application",),
    results=RESULTS,
    reduction="pmabench.kinds.platform_step.reduction:reduce",
    protocol="pmabench.kinds.platform_step.protocol:PlatformSteps",
    live="pmabench.kinds.reduce:of_one_trial",
    methods=METHODS,
    figures={"attitude": "pmabench.kinds.platform_step.reduction:attitudes"},
    front={"attitude": "pmabench.kinds.platform_step.reduction:attitudes"},
    loop=True,
)
