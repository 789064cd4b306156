"""Ultimate gain and period of the position loop: by a rising gain, a relay, or open-loop steps.

- `reduction`: rising gain by `levels`; relay by `relay`, `relay_gauge`; open-loop steps by `open_loop`,
  `open_loop_fit`, `open_loop_response` (without a model);
  from a campaign of contractions by `model_gain`; comparison of these methods in `ways`
- protocol files: `protocol`; one trial on the display: `reduction`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("K_u", "ultimate gain", "gain", headline=True, positive=True),
    Result("T_u", "ultimate period", "time", headline=True, positive=True),
)
METHODS = {
    "open-loop": (
        "Steps of pressure to both sides of the operating point, no loop closed. A dead time and a lag, or two where "
        "the steps show them (which may swing), are fitted from command to pressure, a gain, a lag for each direction "
        "and an inertia or a delay from the pressure to the contraction; K_u and T_u solve the phase equation "
        "ω L + Σ atan(ω T) = π of both, with the mean of the two directions (Ziegler and Nichols 1942). A contraction "
        "that begins before its pressure shows a filter of the gauge, which is taken off. Where rests depend on the "
        "side they were reached from, as friction makes them, or a valve limits the flow, neither is reported."
    ),
    "gain-steps": (
        "The gain of a proportional loop is raised in steps. The logarithm of the ratio of successive swings is fitted "
        "by a line over the gain; K_u is its zero (Ziegler and Nichols 1942). Oscillations that are no sine are "
        "refused."
    ),
    "relay-fit": (
        "A relay makes the loop swing at two sizes. A gain, a dead time, one lag or two of the regulator (which may "
        "swing) and those of the muscle are fitted to the harmonics of command, pressure and contraction of the "
        "larger one; K_u and T_u solve the phase equation of that loop. Where "
        "period or gain by the describing function, 4 d / (π √(a² − h²)) (Åström and Hägglund 1984: d half the "
        "switching of the command, a half the swing, h the hysteresis), change with the size, as friction makes them, "
        "neither is reported."
    ),
}
KIND = Kind(
    name="ultimate-gain",
    title="Ultimate gain",
    order=40,
    results=RESULTS,
    reduction="pmabench.kinds.ultimate_gain.reduction:reduce",
    papers=("paper 0, control",),
    protocol="pmabench.kinds.ultimate_gain.protocol:UltimateGain",
    live="pmabench.kinds.ultimate_gain.reduction:measure",
    moves="displacement",
    methods=METHODS,
    parts={
        "tune by steps": "pmabench.kinds.ultimate_gain.reduction:of_open_loops",
        "tune by model": "pmabench.kinds.ultimate_gain.model_gain:by_model",
    },
    figures={"oscillation": "pmabench.plotting.motion:oscillations", "growth": "pmabench.plotting.motion:oscillations"},
    front={"growth": "pmabench.plotting.motion:oscillation"},
    loop=True,
)
