"""The specimen file of a lab from its answers, and the simulated muscle of a bench that has no devices yet."""

from __future__ import annotations

from pmabench.base.quantities import show
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.lab.answers import Answers, quoted
from pmabench.bench.lab.limits import limits_of
from pmabench.bench.lab.sheet import Sheet
from pmabench.bench.predicted_muscle import of_specimen, plant_text
from pmabench.files.document import Document, validate


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
    command = f"    command: {show(limits.specimen, 'pressure')}"
    sheet.guessed(command, "95 % of never_above", "limits.pressure.command")
    sheet.said(f"  contraction: {show(limits.contraction, 'ratio')}", "contraction", "limits.contraction")
    sheet.add(f"  source: {quoted(f'answers to pmabench init, {answers.asked.isoformat()}')}")
    return sheet.text()


def simulated_plant(answers: Answers) -> str:
    """A plant file of this muscle by its type, else by its braid."""
    specimen = validate(SpecimenFile, Document("specimen.yaml", specimen_text(answers)))
    top = limits_of(answers).scales["pressure"].values[1]
    return plant_text(of_specimen(specimen, top), answers.asked)
