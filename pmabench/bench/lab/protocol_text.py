"""A shipped protocol with the loads, pressures and ways of one muscle and bench in place of those of its paper."""

from __future__ import annotations

import re

import numpy as np

from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.lab.answers import Answers
from pmabench.bench.lab.limits import Limits, limits_of
from pmabench.bench.lab.reading import GRAVITY
from pmabench.bench.predicted_muscle import PredictedMuscle, of_specimen
from pmabench.model.real.muscle import Surface

LOADS, PRESSURES = 9, 7
"""Steps of a sweep."""
LIFTED = (0.1, 0.7)
"""Lightest and heaviest load, as shares of the force at the highest pressure."""
STRONGER = 1.25
"""How much more a muscle may pull than foreseen, and still stays short of its highest contraction."""
SHORT_OF = 0.85
"""Share of the highest contraction that a sweep may reach."""
WIDEST = "10 %"
"""Limit of the interval of K: K of a real muscle changes over the contraction, and at its ends few trials tell it."""


def protocol_text(shipped: str, answers: Answers, specimen: SpecimenFile) -> str:
    """The text of the shipped protocol for this lab: every value that depends on the size of the muscle replaced."""
    limits = limits_of(answers)
    muscle = of_specimen(specimen, limits.command)
    text = re.sub(r"^(name: .*?),.*$", rf"\1, {answers.text('type')}", shipped, count=1, flags=re.MULTILINE)
    text = text.replace("$schema=../docs/schemas/", "$schema=schemas/")
    if answers.text("free_end") == "weights":
        return _with_weights(text, answers, limits, muscle)
    return _with_actuator(text, answers, limits)


def _with_weights(text: str, answers: Answers, limits: Limits, muscle: PredictedMuscle) -> str:
    surface = Surface(**muscle.numbers["surface"])
    loads = _loads(answers, surface, 0.85 * limits.command)
    top = _highest(surface, loads[0] * GRAVITY, limits)
    low = min(0.3 * top, top - 10e3)
    step = max(round((top - low) / (PRESSURES - 1) / 5e3) * 5, 1)
    first = round(low / 5e3) * 5
    last = first + (PRESSURES - 1) * step
    last = last if last * 1e3 <= top else last - step
    values = {
        r"load: \[.*?\]": f"load: [{', '.join(f'{load:g} kg' for load in loads)}]",
        r"pressure: \{start:.*?\}": f"pressure: {{start: {first} kPa, stop: {last} kPa, step: {step} kPa}}",
        r"(precondition: .*?pressure: )\d+ kPa": rf"\g<1>{round(0.7 * last)} kPa",
        r"(relax: \{by: )\d+ kPa": rf"\g<1>{max(round(0.2 * last), 5)} kPa",
        r"( +K: \{relative_interval: )2 %\}": rf"\g<1>{WIDEST}}}   # yours to set; 2 % suits a muscle that is straight",
        r"up_to: \d+ kPa": f"up_to: {int(0.98 * limits.command / 1e3)} kPa",
    }
    return _replaced(text, values)


def _loads(answers: Answers, surface: Surface, pressure: float) -> list[float]:
    """Loads that hanger and plates make [kg], spread over what the muscle lifts at the pressure [Pa]."""
    force = float(surface.force(np.array(0.0), np.array(pressure)))
    totals = np.array(answers.value("stack").totals())
    low, high = (share * force / GRAVITY for share in LIFTED)
    within = totals[(totals >= low) & (totals <= high)]
    if not len(within):
        within = totals[np.argsort(np.abs(totals - high))[:1]]
    wanted = np.linspace(within[0], within[-1], LOADS)
    return sorted({float(within[np.argmin(np.abs(within - one))]) for one in wanted})


def _highest(surface: Surface, lightest: float, limits: Limits) -> float:
    """Highest pressure [Pa] at which the lightest load [N] stays short of the highest contraction."""
    P = np.linspace(0.1, 0.85, 151) * limits.command
    pull = STRONGER * surface.force(np.full(P.shape, SHORT_OF * limits.contraction), P)
    short = P[pull <= lightest]
    return float(short[-1]) if len(short) else float(P[0])


def _with_actuator(text: str, answers: Answers, limits: Limits) -> str:
    kilo = limits.command / 1e3
    pressures = ", ".join(f"{round(share * kilo)} kPa" for share in (0.35, 0.5, 0.65))
    reach = min(0.5 * limits.contraction * answers.value("mounted")[0], 0.8 * answers.value("actuator")[0]) * 1e3
    share = 100 * reach / (1e3 * answers.value("mounted")[0])
    steps = ", ".join(f"{part * share:.3g} %" for part in (0, 0.2, 0.4, 0.6, 0.8, 1))
    values = {
        r"pressure: \[.*?\]": f"pressure: [{pressures}]",
        r"contraction: \[.*?\]": f"contraction: [{steps}]",
        r"upper: [\d.]+ mm": f"upper: {reach:.3g} mm",
        r"mean: [\d.]+ mm": f"mean: {reach / 2:.3g} mm",
        r"amplitude: [\d.]+ mm": f"amplitude: {reach / 4:.3g} mm",
        r"(precondition: .*?pressure: )\d+ kPa": rf"\g<1>{round(0.5 * kilo)} kPa",
        r"(move: \{pressure: )\d+ kPa": rf"\g<1>{round(0.1 * kilo)} kPa",
        r"(pressurise: \{start: 0 kPa, stop: )\d+ kPa": rf"\g<1>{round(0.75 * kilo)} kPa",
    }
    return _replaced(text, values)


def _replaced(text: str, values: dict[str, str]) -> str:
    for pattern, value in values.items():
        text = re.sub(pattern, value, text)
    return text
