"""Pressure steps without load, compared with the contraction by a model.

- `reduction`, with the figure and one trial on the display; protocol files: `protocol`
"""

from pmabench.base.kind import Imported, Kind, Result

RESULTS = (
    Result("e_ss", "steady-state error", "ratio", headline=True),
    Result("e_sim", "difference from the simulation, rms", "length"),
    Result("e_fs", "steady-state error, of full scale", "ratio"),
)
METHODS = {
    "commanded pressure": (
        "The way of paper 0: the model gets the pressure that was commanded. Errors are simulated minus measured "
        "contraction, means over the stated window; e_ss over the measured contraction, e_fs over the largest one."
    ),
    "measured pressure": (
        "As with the commanded pressure, but the model gets the pressure that was measured, so that the regulator's "
        "errors are none of the model's."
    ),
}
FIGURES = {"validation": "pmabench.kinds.validation.reduction:validations"}
KIND = Kind(
    name="validation",
    title="Validation of a model",
    order=80,
    results=RESULTS,
    reduction="pmabench.kinds.validation.reduction:reduce",
    papers=("paper 0, validation",),
    protocol="pmabench.kinds.validation.protocol:Validation",
    live="pmabench.kinds.validation.reduction:measure",
    moves="displacement",
    repeated="pmabench.kinds.validation.reduction:contraction_of",
    repeated_is="contraction",
    methods=METHODS,
    figures=FIGURES,
    front=FIGURES,
    imported=Imported(),
)
