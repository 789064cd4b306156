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
from pmabench.bench.lab.questions import DAQS, NONE_YET, UNCERTAINTY, Answers, Limits, limits_of, quoted
from pmabench.bench.lab.reading import GRAVITY, QUANTITY_OF, Scale
from pmabench.bench.session import Stack
from pmabench.files.document import Document, read_document, validate
from pmabench.model.real.muscle import Surface
from pmabench.store.records import Array

_KEY = re.compile(r"( *)([\w-]+):")
COLUMN = 60
"""Column where comments begin in shorter lines."""
SOURCES = {"never_above": "data sheet", "contraction": "data sheet", "sensors": "data sheets", "supply": "as built"}
"""Question -> source of its answer; all others: asked."""


class Sheet:
    """Lines of a YAML file being written."""

    def __init__(self, answers: Answers, kind: str) -> None:
        self.answers = answers
        self.lines = [
            f"# yaml-language-server: $schema=schemas/{kind}.schema.json",
            "# Written by `pmabench init`; docs/files.md explains the keys.",
            f"schema: pmabench.{kind}/1",
        ]
        self._to_confirm: list[str] = []
        self._keys: list[str] = []
        """Path of the last key."""

    def add(self, *lines: str, note: str = "") -> None:
        """Add lines; `note` becomes a comment."""
        for line in lines:
            if key := _KEY.match(line):
                self._keys[len(key[1]) // 2 :] = [key[2]]
            noted = f"{line:{COLUMN - 1}} # {note}" if len(line) < COLUMN else f"{line}   # {note}"
            self.lines.append(noted if note else line)

    def said(self, line: str, key: str, *parts: str) -> None:
        """Add a line with the answer to question `key`, to be confirmed if it was derived."""
        if self.answers.said(key):
            self.add(line, note=f"{SOURCES.get(key, 'as said')}, asked {self.answers.asked.isoformat()}")
        else:
            self.guessed(line, "proposed by init", *parts)

    def guessed(self, line: str, why: str, *parts: str) -> None:
        """Add a line with a derived value: it, or these parts of it, are to be confirmed."""
        self.add(line, note=f"TO CONFIRM: {why}")
        places = [(*self._keys, part) for part in parts] or [(*self._keys,)]
        self._to_confirm += map(".".join, places)

    def text(self) -> str:
        """Text of the file, with the list of what is to be confirmed at its end."""
        lines = [*self.lines, "to_confirm:   # delete an entry when you have looked it up; nothing runs before"]
        lines += [f"  - {place}" for place in self._to_confirm]
        if not self._to_confirm:
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
    limits, simulated = limits_of(answers), answers.text("daq") == NONE_YET
    sheet, end = Sheet(answers, "bench"), answers.text("free_end")
    name = f"{answers.text('make')} {answers.text('type')}, {end}"
    sheet.add(f"name: {quoted(name[:200])}")
    sheet.said(f"free_end: {end}", "free_end")
    sheet.add(f"time: {'virtual' if simulated else 'real'}")
    _end(sheet, answers)
    _air(sheet, answers, limits)
    if simulated:
        _simulated(sheet, answers, limits)
    else:
        _device(sheet, answers)
        _channels(sheet, answers, limits, calibrations)
        _outputs(sheet, answers)
    _limits(sheet, answers, limits)
    _safety(sheet, answers, limits)
    return sheet.text()


def _end(sheet: Sheet, answers: Answers) -> None:
    if answers.text("free_end") == "actuator":
        stroke, speed, force = answers.value("actuator")
        values = f"stroke: {_span(0.0, stroke, 'length')}, speed: {show(speed, 'speed')}, force: {show(force, 'force')}"
        sheet.said(f"actuator: {{{values}}}", "actuator", "stroke", "speed", "force")
        return
    stack = answers.value("stack")
    plates = ", ".join(f"{count} x {show(mass, 'mass')}" for count, mass in stack.plates)
    sheet.add("weights:")
    sheet.said(f"  hanger: {show(stack.hanger, 'mass')}", "stack")
    sheet.said(f"  plates: [{plates}]", "stack")
    sheet.said(f"  carriage: {show(stack.carriage, 'mass')}", "stack")
    sheet.said(f"  pulley: {str(stack.pulley).lower()}", "stack")


def _air(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    pressure, relief = answers.value("supply")
    sheet.add("air:")
    sheet.said(f"  supply: {show(pressure, 'pressure')}", "supply")
    sheet.said(f"  relief_valve: {'none' if relief is None else show(relief, 'pressure')}", "supply")
    sheet.guessed(f"  overshoot: {show(limits.overshoot, 'pressure')}", "2 % of the regulator")


def _device(sheet: Sheet, answers: Answers) -> None:
    daq = DAQS[answers.text("daq")]
    address, _, registers = (part.strip() for part in answers.text("address").partition(","))
    sheet.add("devices:", f"  {DEVICE}:", f"    driver: {daq.driver}")
    sheet.said(f"    address: {quoted(address)}", "address")
    if registers:
        sheet.said(f"    options: {{map: registers/{registers.rpartition('/')[2]}}}", "address")
    if daq.watchdog:
        sheet.guessed(f"    watchdog: {daq.watchdog}", "it vents by itself after so long")


def _channels(sheet: Sheet, answers: Answers, limits: Limits, calibrations: dict[str, str]) -> None:
    inputs = answers.value("inputs")
    sheet.add("channels:")
    for channel, quantity in QUANTITY_OF.items():
        sheet.add(f"  {channel}:", f"    device: {DEVICE}")
        sheet.said(f"    input: {inputs[channel]}", "inputs")
        sheet.said(f"    range: {_span(*limits.scales[channel].values, quantity)}", "sensors")
        if channel == "force":
            sheet.guessed("    at: fixed end", "where the load cell is")
        if name := calibrations.get(channel):
            sheet.said(f"    calibration: {name}", "calibration")
        else:
            why = "the data sheet's line, 0.5 % of the range uncertain"
            sheet.guessed(f"    calibration: {channel}-data-sheet", why)
    for name, (output, quantity, scale) in _commanded(answers).items():
        if name in inputs:
            span = _span(*scale.values, quantity)
            sheet.add(f"  {output}_command:", f"    device: {DEVICE}", f"    range: {span}")
            sheet.said(f"    input: {inputs[name]}", "inputs")
            sheet.add(f"    calibration: {name}-looped")


def _outputs(sheet: Sheet, answers: Answers) -> None:
    daq, said = DAQS[answers.text("daq")], answers.value("regulator")[0]
    commanded = _commanded(answers)
    head = (f"    device: {DEVICE}", f"    resolution: {daq.resolution}")
    sheet.add("outputs:", "  pressure:", *head)
    sheet.said(f"    output: {said}", "regulator")
    sheet.said(f"    scale: {_line(*commanded['command'][1:])}", "regulator")
    if "actuator" in commanded:
        sheet.add("  displacement:", *head)
        sheet.guessed(f"    output: {daq.second}", "where the actuator is wired")
        sheet.guessed(f"    scale: {_line(*commanded['actuator'][1:])}", "the actuator's input")
    if (valve := answers.value("dump_valve")) is not None:
        sheet.said(f"  dump_valve: {{device: {DEVICE}, output: {valve[0]}, energised: {valve[1]}}}", "dump_valve")
    interlock = answers.value("interlock")
    stop = f"[{{name: e-stop, input: {{device: {DEVICE}, input: {interlock}}}, safe: high}}]" if interlock else "[]"
    sheet.said(f"interlocks: {stop}", "interlock")


def _commanded(answers: Answers) -> dict[str, tuple[str, str, Scale]]:
    """Name of a looped-back command -> name of its output, quantity, and scale."""
    found = {"command": ("pressure", "pressure", answers.value("regulator")[1])}
    if answers.text("free_end") == "actuator":
        daq = DAQS[answers.text("daq")]
        stroke = Scale((f"0 {daq.raw}", f"{daq.out_full:g} {daq.raw}"), (0.0, answers.value("actuator")[0]))
        found["actuator"] = "displacement", "length", stroke
    return found


def _span(low: float, high: float, quantity: str) -> str:
    return f"[{show(low, quantity)}, {show(high, quantity)}]"


def _line(quantity: str, scale: Scale) -> str:
    """The two points of a scale."""
    low, high = (f"[{raw}, {show(value, quantity)}]" for raw, value in zip(scale.raw, scale.values, strict=True))
    return f"[{low}, {high}]"


def _simulated(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    """The simulated device, with its channels and outputs: their numbers are those of the plant."""
    moved, actuated = answers.text("free_end"), answers.text("free_end") == "actuator"
    options = f"{{plant: {PLANT_FILE}, preset: bench, free_end: {moved}, seed: 1}}"
    sheet.add("devices:", f"  {DEVICE}: {{driver: mock, options: {options}}}", "channels:")
    of = f"{{device: {DEVICE}"
    for name, unit in SIMULATED_INPUTS.items():
        span = _span(*limits.scales[name].values, QUANTITY_OF[name])
        sheet.add(f"  {name}: {of}, input: {name}, range: {span}, unit: {unit}}}")
    top = (0.0, limits.scales["pressure"].values[1])
    sheet.add(f"  pressure_command: {of}, input: pressure_set, range: {_span(*top, 'pressure')}, unit: Pa}}")
    if actuated:
        span = _span(*limits.scales["displacement"].values, "length")
        sheet.add(f"  displacement_command: {of}, input: displacement_set, range: {span}, unit: m}}")
    sheet.add("outputs:")
    for name in ("pressure", "displacement") if actuated else ("pressure",):
        ends = _span(0.0, 0.0, QUANTITY_OF[name]), _span(*(2 * limits.scales[name].values[1:]), QUANTITY_OF[name])
        sheet.add(f"  {name}: {of}, output: {name}, scale: [{', '.join(ends)}]}}")
    sheet.add(f"  dump_valve: {of}, output: dump_valve, energised: closed}}")


def _limits(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    sheet.add("limits:", "  pressure:")
    sheet.guessed(f"    command: {show(limits.command, 'pressure')}", "88 % of what may be")
    sheet.guessed(f"    trip: {show(limits.trip, 'pressure')}", "between command and relief valve or never_above")
    if (low := 0.6 * limits.scales["pressure"].values[0]) < 0:
        sheet.guessed(f"    trip_low: {show(low, 'pressure')}", "a broken wire")
    sheet.add("    delay: 4 ms", "    action: vent", "  contraction:")
    sheet.said(f"    trip: {show(limits.contraction, 'ratio')}", "contraction")
    sheet.add("    action: vent", "  force:")
    sheet.guessed(f"    trip: {show(limits.force, 'force')}", "95 % of the sensor's range")
    sheet.add("    action: vent")
    if answers.text("free_end") == "actuator":
        most = min(answers.value("actuator")[0], 0.9 * limits.contraction * answers.value("mounted")[0])
        sheet.add("  displacement:", "    action: vent")
        sheet.guessed(f"    command: {show(most, 'length', 3)}", "90 % of the highest contraction")
        scale = limits.scales["displacement"]
        if (low := 0.6 * scale.values[0]) < -2 * UNCERTAINTY * scale.span:
            sheet.guessed(f"    trip_low: {show(low, 'length')}", "the actuator may stretch the muscle")


def _safety(sheet: Sheet, answers: Answers, limits: Limits) -> None:
    """Watch list, safe state, hands, and proof of the vent path."""
    real, actuated = answers.text("daq") != NONE_YET, answers.text("free_end") == "actuator"
    if real:
        sheet.guessed("watch:", "times of a usual regulator")
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
    sheet.guessed("safe_state:", "done in this order when anything goes wrong")
    if actuated:
        sheet.add("  - {set: displacement, to: 0 mm, within: 200 ms}")
    sheet.add("  - {set: pressure, to: 0 kPa, within: 200 ms}")
    if not real or answers.value("dump_valve") is not None:
        sheet.add("  - {open: dump_valve, within: 200 ms}")
    sheet.add("  - {confirm: pressure, below: 20 kPa, within: 5 s}")
    sheet.guessed("hands: {below: 20 kPa}", "under this measured pressure hands may go in", "below")
    if real:
        proof = f"proof: {{pressure: {show(limits.setup, 'pressure')}, below: 20 kPa, within: 2 s}}"
        sheet.guessed(proof, "the vent path is tried before each use")


def calibration_texts(answers: Answers, calibrations: dict[str, str]) -> dict[str, str]:
    """Path -> text of the calibrations by data sheets, for channels that have none in `calibrations`."""
    if answers.text("daq") == NONE_YET:
        return {}
    found = {}
    scales = {
        **{f"{name}-data-sheet": (QUANTITY_OF[name], scale) for name, scale in answers.value("sensors").items()
           if name not in calibrations},
        **{f"{name}-looped": (quantity, scale) for name, (_, quantity, scale) in _commanded(answers).items()},
    }  # fmt: skip
    for name, (quantity, scale) in scales.items():
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
    sheet = Sheet(answers, "specimen")
    for key in ("make", "type", "serial"):
        sheet.said(f"{key}: {quoted(answers.text(key))}", key)
    for key in ("nominal_length", "inner_diameter"):
        sheet.said(f"{key}: {show(answers.value(key), 'length')}", key)
    at = f"{{load: {show(load, 'mass')}, pressure: 0 kPa}}"
    line = f"mounted: {{date: {quoted(answers.asked.isoformat())}, length: {show(length, 'length')}, at: {at}}}"
    sheet.said(line, "mounted", "length")
    sheet.add("limits:", "  pressure:")
    sheet.said(f"    never_above: {show(answers.value('never_above'), 'pressure')}", "never_above")
    sheet.guessed(f"    command: {show(limits.specimen, 'pressure')}", "95 % of never_above")
    sheet.said(f"  contraction: {show(limits.contraction, 'ratio')}", "contraction")
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
    own, specimen = _calibrations(answers), specimen_text(answers)
    names = {channel: path.stem for channel, path in own.items()}
    files = {
        "bench.yaml": bench_text(answers, names),
        "specimen.yaml": specimen,
        **calibration_texts(answers, names),
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
