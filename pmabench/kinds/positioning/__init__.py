"""Positions held in closed loop: error, overshoot, settling, limit cycle.

- `reduction` of holds and of trials along a path
- protocol files, and gains of the controller: `protocol`; figures and one trial on the display: `figures`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("e_ss", "steady-state error", "ratio", headline=True),
    Result("e_rms", "error along a path, rms", "length", headline=True),
    Result("e_max", "largest error along a path", "length"),
    Result("OS", "overshoot", "ratio", headline=True),
    Result("t_r", "rise time", "time"),
    Result("t_s", "settling time", "time", headline=True),
    Result("IAE", "integral of the absolute error", "", unit="m.s"),
    Result("x_pp", "limit cycle, peak to peak", "length", headline=True),
    Result("T_c", "period of the limit cycle", "time", headline=True),
    Result("e_sim", "difference from the simulation, rms", "length"),
)
METHODS = {
    "closed-loop": (
        "The position held by the controller: e_ss is the mean of set-point minus contraction in the stated window, "
        "over the set-point; rise from 10 to 90 % of it; cycles from one upward crossing of their middle to the next. "
        "The filter that the displacement declares (sensor_lag) is undone first."
    ),
    "closed-loop, simulated": (
        "The same controller, sample by sample, around the model that the protocol names; e_sim is the rms difference "
        "of measured and simulated contraction from the step on."
    ),
    "along a path": (
        "The controller follows places over time: e_rms and e_max are of contraction minus the place that was wanted "
        "at the same moment, from the first sample to the last; OS is the most that a move goes beyond its place "
        "before the next one begins, over the move. The filter that the displacement declares (sensor_lag) is undone "
        "first, and noise is averaged out."
    ),
    "along a path, with feed-forward": (
        "The same, with the pressure added that the inverse of a muscle as a surface gives for the path, hysteresis "
        "and creep included, and led by the dead time and the lag of the regulator."
    ),
}
FIGURES = {
    "position": "pmabench.kinds.positioning.figures:positions",
    "path": "pmabench.kinds.positioning.figures:paths",
}
KIND = Kind(
    name="positioning",
    title="Positioning in closed loop",
    order=70,
    results=RESULTS,
    reduction="pmabench.kinds.positioning.reduction:reduce",
    papers=("paper 0, control",),
    protocol="pmabench.kinds.positioning.protocol:Positioning",
    live="pmabench.kinds.positioning.figures:measure",
    moves="displacement",
    methods=METHODS,
    figures=FIGURES,
    front=FIGURES,
    loop=True,
)
