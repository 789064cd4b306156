"""The kinds of runs, a record of each: which module reduces it, and where its other parts are; imports none of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Kind:
    """Where the parts of one kind of run are: "module:name" within `pmabench.analysis`, loaded on use."""

    reduction: str
    """Module with `reduce(runs, options) -> Analysis` and `RESULTS`, what it can give."""
    word: str = ""
    """Its name in a comparison of tests, `sine`; the same in two kinds: two reductions of the same runs."""
    offers: str = ""
    """Analysis -> what it says of quantities that other kinds measure, too (`verdict.offers`)."""
    trial_value: str = ""
    """Run and trial -> the value that differs between repeats, None or `NotUsable` where there is none ..."""
    trial_value_is: str = ""
    """... and what that value is, in words."""
    repeats: str = ""
    """Channel of repeats drawn over each other; empty where trials of one operating point differ in time."""
    from_others: str = ""
    """Analyses of the specimen's other tests -> options of this reduction, which is then done after them."""
    force_at_rest: bool = False
    """Whether its F_ce is the one that a protocol's limits against static load mean."""
    instead: str = ""
    """The advice to run it where other tests contradict each other on F, F_ce or K."""


KINDS: Mapping[str, Kind] = {
    "static-load": Kind(
        "statics.static_load",
        "static load",
        "statics.static_load:offers",
        "statics.static_load_points:mean_pressure",
        "pressure at which the load is lifted",
        from_others="statics.break_away:option_of",
        force_at_rest=True,
    ),
    "sinusoidal-displacement": Kind(
        "driven.sine", "sine", "driven.sine:offers", "driven.sine_loop:stiffness_of", "stiffness", "force"
    ),
    "isometric-pressurisation": Kind(
        "statics.isometric_pressurisation",
        "isometric",
        "statics.isometric_pressurisation:offers",
        "statics.isometric_curve:largest_force",
        "largest force",
        "force",
    ),
    "isobaric-ramp": Kind(
        "driven.isobaric",
        "isobaric",
        "driven.isobaric:offers",
        "driven.ramp_loop:stiffness_of",
        "stiffness",
        "force",
        instead="an isobaric ramp (isobaric-ramp) measures the curve itself",
    ),
    "step-displacement": Kind(
        "driven.step_displacement",
        "step of displacement",
        "driven.step_displacement:offers",
        "driven.step_relaxation:stiffness_of",
        "stiffness",
        "force",
    ),
    "free-contraction": Kind(
        "statics.free_contraction",
        "free contraction",
        "statics.free_contraction:offers",
        "statics.free_contraction:contraction_of",
        "contraction",
        "displacement",
    ),
    "contraction-relaxation": Kind(
        "contraction.contraction",
        "contraction",
        "contraction.contraction_offers:offers",
        "shared.reference:stroke_of",
        "stroke",
        "displacement",
    ),
    "contraction-relaxation-paper-1": Kind(
        "contraction.contraction_paper1",
        "contraction",
        "contraction.contraction_offers:by_paper_1",
        repeats="displacement",
    ),
    "closed-volume": Kind("statics.closed_volume"),
    "isometric": Kind("recorded.isometric", "recorded isometric", "recorded.isometric:offers"),
    "recorded-pull": Kind("recorded.isometric", "recorded pull", "recorded.isometric:offers"),
    "recorded-step": Kind("recorded.recorded_steps", "recorded step", "recorded.recorded_steps:offers"),
    "recorded-sine": Kind("recorded.recorded_sines"),
    "ultimate-gain": Kind("loops.ultimate_gain"),
    "positioning": Kind("loops.positioning", repeats="displacement"),
    "validation": Kind(
        "loops.validation",
        trial_value="loops.validation:mean_in_window",
        trial_value_is="contraction",
        repeats="displacement",
    ),
    "arm-angle": Kind("statics.arm_angle"),
}
"""Kind of run, with the reduction that its protocol asks for -> its record; the order is that of naming two tests."""


def part(name: str) -> Any:
    """What a "module:name" of a record is, or the module where it names one alone."""
    module, _, attribute = name.partition(":")
    found = import_module(f"pmabench.analysis.{module}")
    return getattr(found, attribute) if attribute else found
