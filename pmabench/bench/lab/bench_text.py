"""The bench file of a lab from its answers, and the calibrations that its sensors' data sheets give.

`Sheet`: a file while it is written; each line says where its value is from, what nobody said is listed for
confirmation.
"""

from __future__ import annotations

from pmabench.base.quantities import show
from pmabench.bench.lab.answers import UNCERTAINTY, Answers, Limits, limits_of, quoted
from pmabench.bench.lab.questions import DAQS, NONE_YET, Daq
from pmabench.bench.lab.reading import QUANTITY_OF, Scale

COLUMN = 60
"""Where comments begin, in lines that are shorter."""
SOURCES = {"never_above": "data sheet", "contraction": "data sheet", "sensors": "data sheets", "supply": "as built"}
"""Question -> where its answer is from; all others: asked."""


class Sheet:
    """Lines of a YAML file."""

    def __init__(self, answers: Answers, schema: str, *head: str) -> None:
        self.answers = answers
        self.lines = [f"# yaml-language-server: $schema={schema}", *(f"# {line}" for line in head)]
        self.to_confirm: list[str] = []

    def add(self, *lines: str) -> None:
        """Lines as they are."""
        self.lines += lines

    def said(self, line: str, key: str, *places: str) -> None:
        """A line by the answer to question `key`; where nobody gave it, `places` are to be confirmed."""
        if self.answers.said(key):
            self._noted(line, f"{SOURCES.get(key, 'as said')}, asked {self.answers.asked.isoformat()}")
        else:
            self.guessed(line, "derived, not asked", *places)

    def guessed(self, line: str, why: str, *places: str) -> None:
        """A line with a derived value at `places`, which are to be confirmed."""
        self._noted(line, f"TO CONFIRM: {why}")
        self.to_confirm += places

    def _noted(self, line: str, note: str) -> None:
        self.lines.append(f"{line:{COLUMN - 1}} # {note}" if len(line) < COLUMN else f"{line}   # {note}")

    def text(self) -> str:
        """The file, with the list of what is to be confirmed at its end."""
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
        name = calibrations.get(channel)
        if name:
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
    valve = answers.value("dump_valve")
    if valve is not None:
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
    low = 0.6 * limits.scales["pressure"].values[0]
    if low < 0:
        sheet.guessed(f"    trip_low: {show(low, 'pressure')}", "a broken wire", "limits.pressure.trip_low")
    sheet.add("    delay: 4 ms", "    action: vent")
    sheet.add("  contraction:")
    sheet.said(f"    trip: {show(limits.contraction, 'ratio')}", "contraction", "limits.contraction.trip")
    sheet.add("    action: vent", "  force:")
    sheet.guessed(f"    trip: {show(limits.force, 'force')}", "95 % of the sensor's range", "limits.force.trip")
    sheet.add("    action: vent")
    actuated = answers.text("free_end") == "actuator"
    if actuated:
        most = min(answers.value("actuator")[0], 0.9 * limits.contraction * answers.value("mounted")[0])
        line = f"  displacement: {{command: {show(most, 'length', 3)}}}"
        sheet.guessed(line, "90 % of the highest contraction", "limits.displacement.command")
    real = answers.text("daq") != NONE_YET
    if real:
        sheet.guessed("watch:", "times of a usual regulator", "watch")
        sheet.add(
            "  - {stale: pressure, for: 300 ms, action: vent}",
            "  - {off_range: pressure, for: 40 ms, action: vent}",
            "  - {stale: force, for: 1 s, action: stop}",
            "  - {stale: displacement, for: 1 s, action: stop}",
        )
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
    """Path -> text of the calibrations by data sheets, for the channels that have none in `calibrations`."""
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
