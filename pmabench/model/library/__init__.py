"""The library of models: pure functions with units, domain, source and reference values; `MODELS` is all of them.

| module | models |
| --- | --- |
| `braid` | Chou-Hannaford, Tondu-Lopez with k or k(P), strand stretch |
| `contractor` | sigmoid length, corrected force with dead band, arm angle; also with their coefficients as inputs |
| `daerden` | force with rubber term, its inverse, volume, volume from measurements |
| `three_element` | balance, step, release; conventions of papers 0, 1 and 4 |
| `coefficients` | published coefficients over pressure; parabolas and polynomials with your own |
| `chamber` | rate of pressure, closed and driven chamber |
| `joint` | two muscles on a pulley against each other, three under a tilting platform: moments and stiffness |
| `compositions` | parallel, series, cascade; the loop that a controller sees |

`description` defines a model. A new model is a function decorated with `described`, in one of these modules or in
a package that names its module in the entry-point group `pmabench.models`.
"""

from importlib.metadata import entry_points

from pmabench.model.library import (  # noqa: F401  each enters its models
    braid,
    chamber,
    coefficients,
    compositions,
    contractor,
    daerden,
    joint,
    three_element,
)
from pmabench.model.library.description import FAMILIES, MODELS, Model, OutsideDomain, Parameter, Refusal, check

__all__ = ["FAMILIES", "MODELS", "Model", "OutsideDomain", "Parameter", "Refusal", "check", "models"]


def models() -> dict[str, Model]:
    """Every model by name, including those of other installed packages."""
    for point in entry_points(group="pmabench.models"):
        point.load()  # registers its models
    return MODELS
