"""Steps of displacement at constant pressure: stiffness at the peak and relaxed.

- `reduction` of all steps of a cell, with figure and one trial on the display: `step` (one, there or back)
- protocol files: `protocol`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("F", "force", "force", headline=True),
    Result("tau_F", "time constant of the force after a step", "time"),
    Result("tau_p", "time constant of the pressure after a step", "time"),
    Result("P_err", "largest error of the pressure", "pressure"),
)
METHODS = {
    "step, relaxed": (
        "Forces and measured contraction at rest, before a step of displacement and at the end of the rest after it: K "
        "= −ΔF/Δx; above 0 the step contracts. Where the regulator rests at other pressures, what a force twice as "
        "steep as a proportional one makes of that is in the interval, or the value is withheld. Friction f between "
        "the rests is in them: K is at least that of the muscle, up to 2 f/Δx more, and F is above the mean of both "
        "directions after a stretch, below it after a contraction."
    ),
    "step, peak": (
        "As step, relaxed, with the forces as measured and the peak in place of the relaxed one: damping, the pressure "
        "that the step makes, and friction are in it."
    ),
    "step, recovery": (
        "One exponential through force and pressure from the end of the motion on. That of the force is withheld where "
        "a filter of the cell may have made it, unless the pressure shows it, too."
    ),
}
POINT = (("start", "first"), ("step", "size"), ("speed", "speed"), ("pressure", "held"))
"""How the operating point is taken from the commands of an import."""
KIND = Kind(
    name="step-displacement",
    title="Steps of displacement",
    order=60,
    results=RESULTS,
    reduction="pmabench.kinds.step_displacement.reduction:reduce",
    papers=("paper 3, steps",),
    protocol="pmabench.kinds.step_displacement.protocol:StepDisplacement",
    live="pmabench.kinds.step_displacement.reduction:one_trial",
    moves="displacement",
    repeated="pmabench.kinds.step_displacement.reduction:stiffness_of",
    repeated_is="stiffness",
    drifts="force",
    word="step of displacement",
    offers="pmabench.kinds.step_displacement.reduction:offers",
    methods=METHODS,
    figures={"displacement-step": "pmabench.kinds.step_displacement.reduction:steps"},
    parts={"slow rows": "pmabench.analysis.surface.trials:driven"},
    imported=Imported(Commanded("displacement", phases=(("away", "step"), ("any", "back")), point=POINT, ramps=True)),
)
