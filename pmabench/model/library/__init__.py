"""The library of models: pure functions with units, domain, source and reference values; `MODELS` is all of them.

| module | models |
| --- | --- |
| `braid` | Chou-Hannaford, Tondu-Lopez with k or k(P), strand stretch |
| `contractor` | sigmoid length, corrected force with dead band, arm angle |
| `daerden` | force with rubber term, its inverse, volume, volume from measurements |
| `three_element` | balance, step, release; conventions of papers 0, 1 and 4 |
| `coefficients` | published coefficients over pressure |

`description` says what a model is. A new model is a function decorated with `described` in one of these modules.
"""

from pmabench.model.library import (  # noqa: F401  each enters its models
    braid,
    coefficients,
    contractor,
    daerden,
    three_element,
)
from pmabench.model.library.description import MODELS, Model, OutsideDomain, Parameter, Refusal

__all__ = ["MODELS", "Model", "OutsideDomain", "Parameter", "Refusal"]
