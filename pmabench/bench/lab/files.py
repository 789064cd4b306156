"""All files of a lab's folder from its answers: specimen, simulated muscle, protocols.

A protocol is a shipped one with the loads, pressures and ways of one muscle and bench in place of those of its paper.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.bench.dry_run import PredictedMuscle, of_specimen, plant_text
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.lab.answers import Answers, Limits, limits_of, quoted
from pmabench.bench.lab.bench_text import PLANT_FILE, Sheet, bench_text, calibration_texts
from pmabench.bench.lab.questions import NONE_YET
from pmabench.bench.lab.reading import GRAVITY
from pmabench.files.document import Document, read_document, validate
from pmabench.model.real.muscle import Surface


def specimen_text(answers: Answers) -> str:
    """The specimen file."""
    limits = limits_of(answers)
    length, load = answers.value("mounted")
    sheet = Sheet(
        answers, "schemas/specimen.schema.json", "Written by `pmabench init`; docs/files.md explains the keys."
    )
    sheet.add("schema: pmabench.specimen/1")
    for key in ("make", "type", "serial"):
        sheet.said(f"{key}: {quoted(answers.text(key))}", key, key)
    for key in ("nominal_length", "inner_diameter"):
        sheet.said(f"{key}: {show(answers.value(key), 'length')}", key, key)
    at = f"{{load: {show(load, 'mass')}, pressure: 0 kPa}}"
    line = f"mounted: {{date: {quoted(answers.asked.isoformat())}, length: {show(length, 'length')}, at: {at}}}"
    sheet.said(line, "mounted", "mounted.length")
    sheet.add("limits:", "  pressure:")
    sheet.said(f"    never_above: {show(answers.value('never_above'), 'pressure')}", "never_above")
    sheet.guessed(f"    command: {show(limits.specimen, 'pressure')}", "95 % of never_above", "limits.pressure.command")
    sheet.said(f"  contraction: {show(limits.contraction, 'ratio')}", "contraction", "limits.contraction")
    sheet.add(f"  source: {quoted(f'answers to pmabench init, {answers.asked.isoformat()}')}")
    return sheet.text()


def simulated_plant(answers: Answers) -> str:
    """A plant file of this muscle by its type, else by its braid."""
    specimen = validate(SpecimenFile, Document("specimen.yaml", specimen_text(answers)))
    top = limits_of(answers).scales["pressure"].values[1]
    return plant_text(of_specimen(specimen, top), answers.asked)


LOADS, PRESSURES = 9, 7
"""Steps of a sweep."""
LIFTED = (0.1, 0.7)
"""Lightest and heaviest load, as shares of the force at the highest pressure."""
STRONGER = 1.25
"""How much more a muscle may pull than foreseen, and still stays short of its highest contraction."""
SHORT_OF = 0.85
"""Share of the highest contraction that a sweep may reach."""
NO_LIMIT = """\
# What is good enough is for you to say, for what you need K for; until then results are judged without a limit.
# accept:
#   K: {relative_interval: 5 %}                # widest 95 % interval of K, of its value\
"""
"""In place of limits of acceptance: nobody asked for one, and one that nobody set would be met or missed by chance."""


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
        r"accept:\n( +.*\n?)+": f"{NO_LIMIT}\n",
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


CHANNEL_OF = {"pressure": "pressure", "length": "displacement", "force": "force"}
"""Quantity of a calibration -> channel."""


def lab_files(answers: Answers, shipped_protocol: str) -> dict[str, str]:
    """Path in the lab's folder -> text; `shipped_protocol` is the text that is made to fit.

    Raises
    ------
    UsageError
        Where a file that an answer names cannot be read.
    """
    own = _calibrations(answers)
    specimen = specimen_text(answers)
    files = {
        "bench.yaml": bench_text(answers, {channel: path.stem for channel, path in own.items()}),
        "specimen.yaml": specimen,
        **calibration_texts(answers, {channel: path.stem for channel, path in own.items()}),
        **{f"calibrations/{path.name}": path.read_text(encoding="utf-8") for path in own.values()},
    }
    if answers.text("daq") == NONE_YET:
        files[PLANT_FILE] = simulated_plant(answers)
    elif registers := answers.text("address").partition(",")[2].strip():
        files[f"registers/{Path(registers).name}"] = _text(Path(registers), "address")
    muscle = validate(SpecimenFile, Document("specimen.yaml", specimen))
    files["protocol.yaml"] = protocol_text(shipped_protocol, answers, muscle)
    return files


def _calibrations(answers: Answers) -> dict[str, Path]:
    """Channel -> the lab's calibration file for it."""
    if answers.text("daq") == NONE_YET or answers.text("calibration") == "none yet":
        return {}
    folder = Path(answers.text("calibration"))
    found = {}
    for path in sorted(folder.glob("*.yaml")):
        channel = CHANNEL_OF.get(str(read_document(path).data.get("quantity")))
        if channel is not None and channel not in found:
            found[channel] = path
    if not found:
        raise UsageError(f'calibration: "{folder}" holds no calibration files; give their folder, or "none yet"')
    return found


def _text(path: Path, key: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'{key}: "{path}" cannot be read: {getattr(error, "strerror", None) or error}') from error
