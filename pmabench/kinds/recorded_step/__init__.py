"""Steps of pressure recorded by other programs: dead time, rise, stroke, and K and B from ringing.

- `reduction` of the result of `step`, with `motion`
"""

from pmabench.base.kind import Imported, Kind, Result

RESULTS = (
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("B", "damping, mean of both directions", "damping", headline=True, plot="Damping", positive=True),
    Result("t_d", "dead time", "time", headline=True, plot="Dead times t_d", positive=True),
    Result("tau_c", "time constant, contracting", "time", headline=True, plot="Time constants", positive=True),
    Result("tau_r", "time constant, relaxing", "time", headline=True, plot="Time constants", positive=True),
    Result("tau_P", "rise time of the pressure", "time", headline=True, positive=True),
    Result("X", "stroke", "length", headline=True),
    Result("dP/dx", "pressure per contraction", "gain", headline=True),
)
METHODS = {
    "driven-delay": (
        "M x″ + B x′ + K x driven by the measured pressure and by the square of its change, which takes up that K and "
        "B change along the step; B/K, the mass and the delay behind the pressure are free."
    ),
    "recorded-step": ("Dead time, rise time and stroke of each recorded step; pressure per contraction from its ends."),
    "ringing-of-known-mass": (
        "M x″ + B x′ + K x = (dF_ce/dP) P + const, driven by the measured pressure, with the moving mass taken as "
        "exact: K = M ω², B = 2 D ω M."
    ),
}
KIND = Kind(
    name="recorded-step",
    title="Recorded steps of pressure",
    order=140,
    results=RESULTS,
    reduction="pmabench.kinds.recorded_step.reduction:reduce",
    word="recorded step",
    offers="pmabench.kinds.recorded_step.reduction:offers",
    methods=METHODS,
    figures={"overlay": "pmabench.plotting.motion:overlays"},
    front={"overlay": "pmabench.plotting.motion:overlays"},
    parts={"slow rows": "pmabench.analysis.surface.trials:hanging"},
    imported=Imported(recording=True, follows="displacement", timed=True, shown="steps"),
)
