"""All slow tests of a muscle together: its force as a surface over contraction and pressure, hysteresis, creep.

- `reduction`; the fit itself is `pmabench.analysis.surface`
"""

from pmabench.base.kind import Kind, Result

RESULTS = (
    Result("F", "force", "force"),
    Result("K", "stiffness", "stiffness", headline=True),
    Result("K_s", "slope of one straight line over the tested contractions", "stiffness", headline=True),
    Result("H", "loop width", "force", headline=True, positive=True),
    Result("W", "loop area, energy lost per cycle", "work", positive=True),
    Result("H_P", "width of the loop of force over pressure", "force", headline=True, positive=True),
    Result("B_c", "damping, contracting", "damping", positive=True),
    Result("B_r", "damping, relaxing", "damping", positive=True),
    Result("F_c", "Coulomb friction", "force", positive=True),
    Result("c_x", "creep in each decade of time, of the contraction", "ratio", headline=True, positive=True),
    Result("c_P", "force gained in each decade of time, of the step of pressure", "force per pressure", headline=True,
           positive=True),
)  # fmt: skip
METHODS = {
    "surface": (
        "One bounded least-squares fit to all slow trials: F = F_s(P, x) as cubic splines in both, minus friction as "
        "stops on contraction and on pressure, minus damping by direction, plus creep as a chain of lags that acts "
        "through the stiffness. A term is kept only if it predicts trials that were left out better by more than 10 % "
        "and by more than the standard error. F and K at a point are those of F_s: half way between both directions, "
        "about 5 s after the muscle came there; without a term of creep, at the pace of the tests. Intervals: "
        "jackknife over groups of trials, with what other choices of smoothness and terms change."
    ),
    "surface, straight line": (
        "Minus the slope of the least-squares straight line through the fitted surface over the tested contractions: "
        "what a model with one K at each pressure would get."
    ),
}
KIND = Kind(
    name="surface",
    title="Muscle as a surface",
    order=160,
    reverses=True,
    results=RESULTS,
    reduction="pmabench.kinds.surface.reduction:reduce",
    methods=METHODS,
    figures={"loop": "pmabench.plotting.motion:loops"},
    parts={"form of all tests": "pmabench.kinds.surface.reduction:reduce"},
)
