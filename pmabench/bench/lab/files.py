"""All files of a lab's folder from its answers: bench, calibrations by data sheets, specimen, muscle, protocols.

A protocol is a shipped one with the loads, pressures and strokes of one muscle and bench in place of its paper's.

`Sheet`: a file being written; each line states the source of its value, and values not given by a person are listed
for confirmation.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.bench.dry_run import PredictedMuscle, of_specimen, plant_text
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.lab.questions import DAQS, NONE_YET, UNCERTAINTY, Answers, Daq, Limits, limits_of, quoted
from pmabench.bench.lab.reading import GRAVITY, QUANTITY_OF, Scale
from pmabench.bench.session import Stack
from pmabench.files.document import Document, read_document, validate
from pmabench.model.real.muscle import Surface
from pmabench.store.records import Array

COLUMN = 60
"""Column where comments begin in shorter lines."""
SOURCES = {"never_above": "data sheet", "contraction": "data sheet", "sensors": "data sheets", "supply": "as built"}
"""Question -> source of its answer; all others: asked."""


class Sheet:
    """Lines of a YAML file being written."""

    def __init__(self, answers: Answers, schema: str, *head: str) -> None:
        self.answers = answers
        self.lines = [f"# yaml-language-server: $schema={schema}", *(f"# {line}" for line in head)]
        self.to_confirm: list[str] = []

    def add(self, *lines: str) -> None:
        """Add lines unchanged."""
        self.lines += lines

    def said(self, line: str, key: str, *places: str) -> None:
        """Add a line with the answer to question `key`; if it was derived, `places` are to be confirmed."""
        if self.answers.said(key):
            self._noted(line, f"{SOURCES.get(key, 'as said')}, asked {self.answers.asked.isoformat()}")
        else:
            self.guessed(line, "proposed by init", *places)

    def guessed(self, line: str, why: str, *places: str) -> None:
        """Add a line with a derived value at `places`, which are to be confirmed."""
        self._noted(line, f"TO CONFIRM: {why}")
        self.to_confirm += places

    def _noted(self, line: str, note: str) -> None:
        self.lines.append(f"{line:{COLUMN - 1}} # {note}" if len(line) < COLUMN else f"{line}   # {note}")

    def text(self) -> str:
        """Text of the file, with the list of what is to be confirmed at its end."""
        lines = [*self.lines, "to_confirm:   # delete an entry when you have looked it up; nothing runs before"]
        lines += [f"  - {place}" for place in self.to_confirm]
        if not self.to_confirm:
            lines[-1] = "to_confirm: []"
        return "\n".join(lines) + "\n"


DEVICE = "daq"
"""Name of the only device of a bench."""
PLANT_FILE = "plant.yaml"
CALIBRATION = """\
# yaml-language-server: $schema=../schemas/calibration.schema.json
# By the sensor's data sheet; `pmabench calibrate` compares it with a reference and writes a file like this one.
schema: pmabench.calibration/1
id: {id}
quantity: {quantity}
reference: the sensor's data sheet; not compared with anything yet
date: {date}
points: [[{raw[0]}, {low}], [{raw[1]}, {high}]]
expanded_uncertainty: {uncertainty}
"""
SIMULATED_INPUTS = {"pressure": "Pa", "displacement": "m", "force": "N"}
"""Measured input of the simulated bench -> its unit."""


def bench_text(answers: Answers, calibrations: dict[str, str]) -> str:
    """The bench file; `calibrations`: channel -> id of a calibration file of the lab."""
    limits = limits_of(answers)
    simulated = answers.text("daq") == NONE_YET
    sheet = Sheet(answers, "schemas/bench.schema.json", "Written by `pmabench init`; docs/files.md explains the keys.")
    end = answers.text("free_end")
    name = f"{answers.text('make')} {answers.text('type')}, {end}"
    sheet.add("schema: pmabench.bench/1", f"name: {quoted(name[:200])}")
    sheet.said(f"free_end: {end}", "free_end", "free_end")
    sheet.add(f"time: {'virtual' if simulated else 'real'}")
    _end(sheet, answers)
    _air(sheet, answers, limits)
    sheet.add("devices:")
    if simulated:
        moved = "actuator" if end == "actuator" else "weights"
        options = f"{{plant: {PLANT_FILE}, preset: bench, free_end: {moved}, seed: 1}}"
        sheet.add(f"  {DEVICE}: {{driver: mock, options: {options}}}")
        _simulated_channels(sheet, limits, actuated=end == "actuator")
    else:
        _device(sheet, answers)
        _channels(sheet, answers, limits, calibrations)
    _limits(sheet, answers, limits)
    return sheet.text()


def _end(sheet: Sheet, answers: Answers) -> None:
    if answers.text("free_end") == "actuator":
        stroke, speed, force = answers.value("actuator")
        values = (
            f"stroke: [0 mm, {show(stroke, 'length')}], speed: {show(speed, 'speed')}, force: {show(force, 'force')}"
        )
        sheet.said(f"actuator: {{{values}}}", "actuator", "actuator.stroke", "actuator.speed", "actuator.force")
        return
    stack = answers.value("stack")
    plates = ", ".join(f"{count} x {show(mass, 'mass')}" for count, mass in stack.plates)
    sheet.add("weights:")
    sheet.said(f"  hanger: {show(stack.hanger, 'mass')}", "stack", "weights.hanger")
    sheet.said(f"  plates: [{plates}]", "stack", "weights.plates")
    sheet.said(f"  carriage: {show(stack.carriage, 'mass')}", "stack", "weights.carriage")
    sheet.said(f"  pulley: {str(stack.pulley).lower()}", "stack", "weights.pulley")


def _air(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    pressure, relief = answers.value("supply")
    sheet.add("air:")
    sheet.said(f"  supply: {show(pressure, 'pressure')}", "supply")
    sheet.said(f"  relief_valve: {'none' if relief is None else show(relief, 'pressure')}", "supply")
    sheet.guessed(f"  overshoot: {show(limits.overshoot, 'pressure')}", "2 % of the regulator", "air.overshoot")


def _device(sheet: Sheet, answers: Answers) -> None:
    daq = DAQS[answers.text("daq")]
    address, _, registers = (part.strip() for part in answers.text("address").partition(","))
    place = f"devices.{DEVICE}"
    sheet.add(f"  {DEVICE}:", f"    driver: {daq.driver}")
    sheet.said(f"    address: {quoted(address)}", "address", f"{place}.address")
    if registers:
        sheet.said(f"    options: {{map: registers/{registers.rpartition('/')[2]}}}", "address")
    if daq.watchdog:
        sheet.guessed(f"    watchdog: {daq.watchdog}", "it vents by itself after so long", f"{place}.watchdog")


def _channels(sheet: Sheet, answers: Answers, limits: Limits, calibrations: dict[str, str]) -> None:
    daq = DAQS[answers.text("daq")]
    inputs = answers.value("inputs")
    output, scale = answers.value("regulator")
    sheet.add("channels:")
    for channel, quantity in QUANTITY_OF.items():
        low, high = (show(value, quantity) for value in limits.scales[channel].values)
        sheet.add(f"  {channel}:", f"    device: {DEVICE}")
        sheet.said(f"    input: {inputs[channel]}", "inputs", f"channels.{channel}.input")
        sheet.said(f"    range: [{low}, {high}]", "sensors", f"channels.{channel}.range")
        if channel == "force":
            sheet.guessed("    at: fixed end", "where the load cell is", "channels.force.at")
        if name := calibrations.get(channel):
            sheet.said(f"    calibration: {name}", "calibration")
        else:
            why = "the data sheet's line, 0.5 % of the range uncertain"
            sheet.guessed(f"    calibration: {channel}-data-sheet", why, f"channels.{channel}.calibration")
    low, high = (show(value, "pressure") for value in scale.values)
    sheet.add("  pressure_command:", f"    device: {DEVICE}", f"    range: [{low}, {high}]")
    sheet.said(f"    input: {inputs['command']}", "inputs", "channels.pressure_command.input")
    sheet.add("    calibration: command-looped")
    if "actuator" in inputs:
        stroke = show(answers.value("actuator")[0], "length")
        sheet.add("  displacement_command:", f"    device: {DEVICE}", f"    range: [0 mm, {stroke}]")
        sheet.said(f"    input: {inputs['actuator']}", "inputs", "channels.displacement_command.input")
        sheet.add("    calibration: actuator-looped")
    raw = f"[[{scale.raw[0]}, {low}], [{scale.raw[1]}, {high}]]"
    sheet.add("outputs:", "  pressure:", f"    device: {DEVICE}", f"    resolution: {daq.resolution}")
    sheet.said(f"    output: {output}", "regulator", "outputs.pressure.output")
    sheet.said(f"    scale: {raw}", "regulator", "outputs.pressure.scale")
    _actuator_output(sheet, answers, daq)
    _valves(sheet, answers)


def _actuator_output(sheet: Sheet, answers: Answers, daq: Daq) -> None:
    if answers.text("free_end") != "actuator":
        return
    stroke = show(answers.value("actuator")[0], "length")
    scale = f"[[0 {daq.raw}, 0 mm], [{daq.out_full:g} {daq.raw}, {stroke}]]"
    sheet.add("  displacement:", f"    device: {DEVICE}", f"    resolution: {daq.resolution}")
    sheet.guessed(f"    output: {daq.second}", "where the actuator is wired", "outputs.displacement.output")
    sheet.guessed(f"    scale: {scale}", "the actuator's input", "outputs.displacement.scale")


def _valves(sheet: Sheet, answers: Answers) -> None:
    if (valve := answers.value("dump_valve")) is not None:
        sheet.said(f"  dump_valve: {{device: {DEVICE}, output: {valve[0]}, energised: {valve[1]}}}", "dump_valve")
    interlock = answers.value("interlock")
    stop = f"[{{name: e-stop, input: {{device: {DEVICE}, input: {interlock}}}, safe: high}}]" if interlock else "[]"
    sheet.said(f"interlocks: {stop}", "interlock", "interlocks")


def _simulated_channels(sheet: Sheet, limits: Limits, *, actuated: bool) -> None:
    top = show(limits.scales["pressure"].values[1], "pressure")
    sheet.add("channels:")
    for channel, quantity in QUANTITY_OF.items():
        low, high = (show(value, quantity) for value in limits.scales[channel].values)
        unit = SIMULATED_INPUTS[channel]
        sheet.add(f"  {channel}: {{device: {DEVICE}, input: {channel}, range: [{low}, {high}], unit: {unit}}}")
    command = f"device: {DEVICE}, input: pressure_set, range: [0 kPa, {top}], unit: Pa"
    sheet.add(f"  pressure_command: {{{command}}}")
    if actuated:
        low, high = (show(value, "length") for value in limits.scales["displacement"].values)
        moved = f"device: {DEVICE}, input: displacement_set, range: [{low}, {high}], unit: m"
        sheet.add(f"  displacement_command: {{{moved}}}")
    sheet.add(
        "outputs:", f"  pressure: {{device: {DEVICE}, output: pressure, scale: [[0 kPa, 0 kPa], [{top}, {top}]]}}"
    )
    if actuated:
        high = show(limits.scales["displacement"].values[1], "length")
        scale = f"[[0 mm, 0 mm], [{high}, {high}]]"
        sheet.add(f"  displacement: {{device: {DEVICE}, output: displacement, scale: {scale}}}")
    sheet.add(f"  dump_valve: {{device: {DEVICE}, output: dump_valve, energised: closed}}")


def _limits(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    pressure = "between command and relief valve or never_above"
    sheet.add("limits:", "  pressure:")
    sheet.guessed(f"    command: {show(limits.command, 'pressure')}", "88 % of what may be", "limits.pressure.command")
    sheet.guessed(f"    trip: {show(limits.trip, 'pressure')}", pressure, "limits.pressure.trip")
    if (low := 0.6 * limits.scales["pressure"].values[0]) < 0:
        sheet.guessed(f"    trip_low: {show(low, 'pressure')}", "a broken wire", "limits.pressure.trip_low")
    sheet.add("    delay: 4 ms", "    action: vent")
    sheet.add("  contraction:")
    sheet.said(f"    trip: {show(limits.contraction, 'ratio')}", "contraction", "limits.contraction.trip")
    sheet.add("    action: vent", "  force:")
    sheet.guessed(f"    trip: {show(limits.force, 'force')}", "95 % of the sensor's range", "limits.force.trip")
    sheet.add("    action: vent")
    if actuated := answers.text("free_end") == "actuator":
        most = min(answers.value("actuator")[0], 0.9 * limits.contraction * answers.value("mounted")[0])
        sheet.add("  displacement:", "    action: vent")
        command = f"    command: {show(most, 'length', 3)}"
        sheet.guessed(command, "90 % of the highest contraction", "limits.displacement.command")
        scale = limits.scales["displacement"]
        if (low := 0.6 * scale.values[0]) < -2 * UNCERTAINTY * scale.span:
            line = f"    trip_low: {show(low, 'length')}"
            sheet.guessed(line, "the actuator may stretch the muscle", "limits.displacement.trip_low")
    if real := answers.text("daq") != NONE_YET:
        sheet.guessed("watch:", "times of a usual regulator", "watch")
        sheet.add(
            "  - {stale: pressure, for: 300 ms, action: vent}",
            "  - {off_range: pressure, for: 40 ms, action: vent}",
            "  - {stale: force, for: 1 s, action: stop}",
            "  - {stale: displacement, for: 1 s, action: stop}",
            "  - {following: pressure, more_than: 60 kPa, for: 3 s, action: stop}",
        )
    if real and actuated:
        far = show(max(2e-3, 0.03 * answers.value("actuator")[0]), "length")
        sheet.add(f"  - {{following: displacement, more_than: {far}, for: 500 ms, action: vent}}")
    sheet.guessed("safe_state:", "done in this order when anything goes wrong", "safe_state")
    if actuated:
        sheet.add("  - {set: displacement, to: 0 mm, within: 200 ms}")
    sheet.add("  - {set: pressure, to: 0 kPa, within: 200 ms}")
    if not real or answers.value("dump_valve") is not None:
        sheet.add("  - {open: dump_valve, within: 200 ms}")
    sheet.add("  - {confirm: pressure, below: 20 kPa, within: 5 s}")
    sheet.guessed("hands: {below: 20 kPa}", "under this measured pressure hands may go in", "hands.below")
    if real:
        proof = f"proof: {{pressure: {show(limits.setup, 'pressure')}, below: 20 kPa, within: 2 s}}"
        sheet.guessed(proof, "the vent path is tried before each use", "proof")


def calibration_texts(answers: Answers, calibrations: dict[str, str]) -> dict[str, str]:
    """Path -> text of the calibrations by data sheets, for channels that have none in `calibrations`."""
    if answers.text("daq") == NONE_YET:
        return {}
    found = {}
    scales = {channel: (QUANTITY_OF[channel], scale) for channel, scale in answers.value("sensors").items()}
    names = {channel: f"{channel}-data-sheet" for channel in scales if channel not in calibrations}
    scales["command"], names["command"] = ("pressure", answers.value("regulator")[1]), "command-looped"
    if answers.text("free_end") == "actuator":
        daq = DAQS[answers.text("daq")]
        stroke = Scale((f"0 {daq.raw}", f"{daq.out_full:g} {daq.raw}"), (0.0, answers.value("actuator")[0]))
        scales["actuator"], names["actuator"] = ("length", stroke), "actuator-looped"
    for channel, name in names.items():
        quantity, scale = scales[channel]
        low, high = (show(value, quantity, 10) for value in scale.values)
        found[f"calibrations/{name}.yaml"] = CALIBRATION.format(
            id=name, quantity=quantity, date=answers.asked.isoformat(), raw=scale.raw, low=low, high=high,
            uncertainty=show(UNCERTAINTY * scale.span, quantity),
        )  # fmt: skip
    return found


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


LOADS, PRESSURES = 9, 7
"""Numbers of loads and of pressures of a sweep."""
ENOUGH = 4
"""Loads needed for a line of force over contraction."""
LIFTED = (0.1, 0.7)
"""Lightest and heaviest load, as fractions of the force at the highest pressure."""
LIFTS = 0.2
"""Fraction of the highest contraction to which the lowest pressure lifts the lightest load."""
STRONGER = 1.25
"""Factor by which a muscle may pull more than predicted without reaching its highest contraction."""
SHORT_OF = 0.85
"""Fraction of the highest contraction that a sweep may reach."""
NO_LIMIT = """\
# What is good enough is for you to say, for what you need K for; until then results are judged without a limit.
# accept:
#   K: {relative_interval: 5 %}                # widest 95 % interval of K, of its value\
"""
"""Replaces the acceptance limits: none is known, and meeting an invented one would mean nothing."""


def protocol_text(shipped: str, answers: Answers, specimen: SpecimenFile) -> str:
    """The shipped protocol adapted to this lab: every value that depends on the size of the muscle is replaced."""
    limits = limits_of(answers)
    muscle = of_specimen(specimen, limits.command)
    text = re.sub(r"^(name: .*?),.*$", rf"\1, {answers.text('type')}", shipped, count=1, flags=re.MULTILINE)
    text = text.replace("$schema=../docs/schemas/", "$schema=schemas/")
    if answers.text("free_end") == "weights":
        return _with_weights(text, answers, limits, muscle)
    return _with_actuator(text, answers, limits)


def _with_weights(text: str, answers: Answers, limits: Limits, muscle: PredictedMuscle) -> str:
    surface = Surface(**muscle.numbers["surface"])
    loads, top = _loads(answers, surface, limits)
    P = np.linspace(0.3, 0.6, 61) * top
    pull = surface.force(np.full(P.shape, LIFTS * limits.contraction), P)
    low = min(float(np.append(P[pull >= loads[0] * GRAVITY], P[-1])[0]), top - 10e3)
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


def _loads(answers: Answers, surface: Surface, limits: Limits) -> tuple[list[float], float]:
    """Loads that hanger and plates can make [kg], and the highest pressure for them [Pa].

    The lightest load limits the pressure, and so the heaviest load that is lifted. Chosen is the lightest load with
    `ENOUGH` loads in its range, and among these the widest range.
    """
    given = answers.value("stack")
    totals = np.round(Stack(given.hanger, given.plates).loads[1:], 6)

    def lifted(lightest: float) -> tuple[Array, float]:
        top = _highest(surface, lightest * GRAVITY, limits)
        low, high = (share * float(surface.force(np.array(0.0), np.array(top))) / GRAVITY for share in LIFTED)
        return totals[(totals >= max(low, lightest)) & (totals <= max(high, lightest))], top

    found = [lifted(float(lightest)) for lightest in totals]
    within, top = max(found, key=lambda one: (min(len(one[0]), ENOUGH), one[0][-1] / one[0][0] if len(one[0]) else 0.0))
    if not len(within):
        force = float(surface.force(np.array(0.0), np.array(top)))
        within = totals[np.argsort(np.abs(totals - LIFTED[1] * force / GRAVITY))[:1]]
    wanted = np.linspace(within[0], within[-1], LOADS)
    return sorted({float(within[np.argmin(np.abs(within - one))]) for one in wanted}), top


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
    """Path in the lab's folder -> text; `shipped_protocol` is the text of the protocol to be adapted.

    Raises
    ------
    UsageError
        If a file that an answer names cannot be read.
    """
    own = _calibrations(answers)
    specimen = specimen_text(answers)
    files = {
        "bench.yaml": bench_text(answers, {channel: path.stem for channel, path in own.items()}),
        "specimen.yaml": specimen,
        **calibration_texts(answers, {channel: path.stem for channel, path in own.items()}),
        **{f"calibrations/{path.name}": path.read_text(encoding="utf-8") for path in own.values()},
    }
    muscle = validate(SpecimenFile, Document("specimen.yaml", specimen))
    if answers.text("daq") == NONE_YET:
        top = limits_of(answers).scales["pressure"].values[1]
        files[PLANT_FILE] = plant_text(of_specimen(muscle, top), answers.asked)
    elif registers := answers.text("address").partition(",")[2].strip():
        files[f"registers/{Path(registers).name}"] = _text(Path(registers), "address")
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
