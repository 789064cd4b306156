"""What one trial says by itself, by kind of run, with the same functions that `process` uses; no intervals.

Knows trials and the prediction that stands beside them; judges nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module

from pmabench.display.expected import Expected
from pmabench.store.records import RunData, TrialData

DRIFT = 0.02
"""Share of a step that the last fifth of its hold may still move."""


@dataclass(frozen=True)
class Measured:
    """One quantity of a trial [SI]."""

    symbol: str
    quantity: str
    value: float | None
    expected: float | None = None
    tolerance: float = 0.0
    """What friction may take away from the prediction [SI]."""
    noise: float = 0.0
    """Differences smaller than this between repeats mean nothing [SI]."""
    assumed: bool = False
    pooled: bool = False
    """Whether earlier trials are in it, so that it cannot be held against them."""


Found = tuple[list[Measured], list[str]]
"""Quantities, and what the samples themselves say against the trial."""


@dataclass
class Quick:
    """What is remembered: load [N] and final contraction [m] of each trial, by pressure [Pa]."""

    ends: dict[float, dict[int, tuple[float, float]]] = field(default_factory=dict)


_RULES = {
    "contraction-relaxation": ("contraction", "contraction"),
    "static-load": ("statics", "static_load"),
    "sinusoidal-displacement": ("driven", "sine"),
    "ultimate-gain": ("loops", "ultimate_gain"),
    "positioning": ("loops", "position"),
    "validation": ("loops", "validation"),
    "isobaric-ramp": ("driven", "ramp"),
    "step-displacement": ("driven", "step"),
    "isometric-pressurisation": ("statics", "isometric"),
    "closed-volume": ("statics", "closed_volume"),
    "free-contraction": ("statics", "free_contraction"),
    "arm-angle": ("statics", "arm_angle"),
}
"""Kind of run -> module of `pmabench.display.kinds` and its function."""


def prepare(kind: str) -> None:
    """Import what the rule of a kind needs, which takes a second; so that the first trial's line holds up no key."""
    if kind in _RULES:
        import_module(f"pmabench.display.kinds.{_RULES[kind][0]}")


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The quantities of a trial and what its own samples say against it; none for kinds without a rule."""
    if run.kind not in _RULES:
        return [], []
    module, name = _RULES[run.kind]
    found: Found = getattr(import_module(f"pmabench.display.kinds.{module}"), name)(run, trial, expected, quick)
    return found
