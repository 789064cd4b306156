"""`pmabench model simulate`: what a simulated muscle does in time under steps and sines of pressure and a load."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import show
from pmabench.cli.common import Problems, Ui, common
from pmabench.cli.model_inputs import column_of, described_by, show_columns

if TYPE_CHECKING:
    from pmabench.model.driven import Actuator, DrivenPlant
    from pmabench.model.identified.plant import IdentifiedDrivenPlant, IdentifiedPlant
    from pmabench.model.motion import Motion
    from pmabench.model.overrides import Overrides
    from pmabench.model.plant import Plant
    from pmabench.model.presets import Setup
    from pmabench.model.real.plants import RealPlant
    from pmabench.model.regulator import Wave

MOST_ROWS = 20_000
LONGEST = 1000.0
"""Longest time that is simulated [s]."""
HIGHEST, OF_PRESETS = 1e6, 600e3
"""Most pressure of any muscle, and of the presets [Pa]."""
FASTEST = 10.0
"""Fastest sine [Hz]."""
G = 9.81
CARRIAGE, FORCE_MASS = 2.0, 0.5
"""What moves besides the weights, and with a load that is a force [kg]."""
EXAMPLE = (
    "\b\n"
    'pmabench model simulate paper0 --step "300 kPa at 0.5 s" --step "0 kPa at 4 s" \\\n'
    '    --load "6 kg" --for "8 s"'
)
COLUMNS = (
    ("time", "time", "t"),
    ("pressure_command", "pressure", "P_set"),
    ("pressure", "pressure", "P"),
    ("displacement", "length", "x"),
    ("speed", "speed", "v"),
    ("force", "force", "F"),
)
"""Name, quantity and field of `Motion` of what is printed."""
CHANGES = {
    "friction": "count", "F_s": "force", "F_c": "force", "hysteresis": "force", "regulator_lag": "time",
    "natural_frequency": "frequency", "damping_ratio": "count",
    "dead_time": "time", "vent_ratio": "count", "dead_band": "pressure", "leak": "rate",
    "hysteresis_x": "count", "hysteresis_p": "count", "creep": "count", "bend": "count", "first_cycle": "count",
}  # fmt: skip
"""What --set takes, as in the options of the mock bench."""


@click.command(name="simulate", epilog=EXAMPLE)
@click.argument("plant")
@click.option("--kind", default="bench", help="bench: regulator lag, dead time, stiction; ideal: dead time only.")
@click.option(
    "--step", "steps", multiple=True, metavar="PRESSURE", help='"300 kPa at 0.5 s", or a ramp: "... by 50 kPa/s".'
)
@click.option("--sine", metavar="SINE", help='About the last step before it: "20 kPa, 0.5 Hz at 4 s".')
@click.option("--load", help='"58.86 N", a force, or "6 kg", which hangs with its inertia.')
@click.option("--drive", metavar="SINE", help='The free end driven: "20 mm +- 10 mm, 0.5 Hz"; below 0 mm stretched.')
@click.option("--for", "duration", default="5 s", show_default=True, help="How long.")
@click.option("--every", help="Time between rows; a twenty-fifth of the whole where not given.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="Change a parameter of the plant.")
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout.")
@common
def simulate(ui: Ui, plant: str, kind: str, duration: str, every: str | None, *, as_csv: bool, **course: Any) -> None:
    """Simulate PLANT (paper0, serres2009, real; daerden with --drive; or the path of a plant file) from rest.

    Or the folder of an analysis of kind surface. True values in time, without sensors.
    """
    problems = Problems()
    if course["load"] and course["drive"]:
        problems.append("--load and --drive: the free end carries a load or is driven, not both")
    if not course["steps"] and course["sine"] is None:
        problems.append('--step: nothing is commanded; for instance --step "300 kPa at 0.5 s"')
    times = _times(problems, duration, every)
    asked = _asked(problems, **course)
    problems.refuse()
    try:
        motion = _simulated(plant, kind, asked, times)
    except ValueError as error:
        raise UsageError(f"{plant}: {error}") from error
    columns = [column_of(name, quantity, getattr(motion, field).tolist()) for name, quantity, field in COLUMNS]
    data = {"schema": "pmabench.model-simulation/1", "simulated": True, "plant": plant, "kind": kind}
    above = f"SIMULATED: plant {plant}, {kind}; true values, no sensors"
    show_columns(ui, data | {"columns": columns}, as_csv=as_csv, above=above)


@dataclass(frozen=True)
class Asked:
    """What a plant of one muscle goes through."""

    waves: tuple[Wave, ...]
    """The commanded pressure."""
    weight: tuple[float, float]
    """Force [N] and moving mass [kg]."""
    drive: tuple[float, float, float] | None
    """Mean and amplitude of the driven end [m], frequency [Hz]."""
    changes: Overrides

    def refuse_above(self, highest: float, why: str) -> None:
        """Raise ValueError, with `why`, where more than a pressure [Pa] is commanded."""
        peak = max(wave.level + wave.amplitude for wave in self.waves)
        if peak > highest * (1 + 1e-9):
            raise ValueError(f"{show(peak, 'pressure')} is outside 0 kPa to {show(highest, 'pressure')}, {why}")


def _times(problems: Problems, duration: str, every: str | None) -> list[float]:
    """The moments that are printed [s]; what is wrong with --for and --every is added to `problems`."""
    seconds = _parsed(problems, "--for", within, duration, "time", 1e-3, LONGEST)
    spacing = seconds and seconds / 25
    if every:
        spacing = _parsed(problems, "--every", within, every, "time", 1e-6, LONGEST)
    if not seconds or not spacing:
        return []
    if seconds / spacing > MOST_ROWS:
        problems.append(f"--every: {seconds / spacing:.0f} rows; at most {MOST_ROWS} are made")
        return []
    return [number * spacing for number in range(int(seconds / spacing * (1 + 1e-9)) + 1)]


def _asked(
    problems: Problems, steps: tuple[str, ...], sine: str | None, load: str | None, drive: str | None,
    settings: tuple[str, ...],
) -> Asked:  # fmt: skip
    """What was typed; what is wrong with it is added to `problems`."""
    return Asked(
        waves=_parsed(problems, "--step", _course, steps, sine),
        weight=_parsed(problems, "--load", _load, load),
        drive=_parsed(problems, "--drive", _drive, drive),
        changes=_parsed(problems, "--set", _overrides, settings),
    )


def _simulated(plant: str, kind: str, asked: Asked, times: list[float]) -> Motion:
    import numpy as np

    from pmabench.model.regulator import sine

    bench: Any = _of_analysis(Path(plant), asked) if Path(plant).is_dir() else _of_library(plant, kind, asked)
    if asked.drive is not None:
        mean, amplitude, frequency = asked.drive
        bench.move(sine(0.0, mean, amplitude, frequency, math.ceil(times[-1] * frequency)))
    bench.command(asked.waves)
    motion: Motion = bench.advance(times[-1], np.array(times))
    return motion


def _of_analysis(folder: Path, asked: Asked) -> Plant | IdentifiedPlant | IdentifiedDrivenPlant:
    """The muscle of an analysis; ValueError beyond the pressures and contractions that were tested."""
    from pmabench.model.driven import Actuator
    from pmabench.model.identified.plant import IdentifiedDrivenPlant
    from pmabench.model.regulator import Regulator

    given = {name: value for name, value in asdict(asked.changes).items() if value is not None}
    names = {"regulator_lag": "lag", "dead_time": "dead_time", "vent_ratio": "vent_ratio", "dead_band": "dead_band"}
    if wrong := sorted(set(given) - set(names)):
        raise ValueError(f"--set {wrong[0]}: of the muscle of an analysis {', '.join(names)} can be set")
    before = Regulator(**{"dead_time": 0.0} | {names[name]: value for name, value in given.items()})
    model = described_by(folder, before)
    asked.refuse_above(model.domain[1], "up to which it was tested")
    if asked.drive is None or model.surface is None:
        return model.plant(*asked.weight)
    (mean, amplitude, _), (low, high) = asked.drive, model.surface.reach
    if mean - amplitude < low - 1e-9 or mean + amplitude > high + 1e-9:
        raise ValueError(f"--drive leaves {show(low, 'length')} to {show(high, 'length')}, where it was tested")
    return IdentifiedDrivenPlant(model.surface, before, Actuator(), position=mean)


def _of_library(plant: str, kind: str, asked: Asked) -> Plant | RealPlant | DrivenPlant:
    """A preset by name, or what a plant file says; ValueError where the course goes beyond that."""
    from pmabench.model.driven import Actuator
    from pmabench.model.presets import changed, preset

    if plant.endswith(".yaml"):
        from pmabench.bench.plant import read_plant
        from pmabench.model.presets import setup_of

        numbers = read_plant(Path(plant)).numbers
        setup, highest = changed(setup_of(numbers), kind, asked.changes), float(numbers["highest_pressure"])
    else:
        setup, highest = preset(plant, kind, asked.changes), OF_PRESETS
    asked.refuse_above(highest, "for which it is described")
    if asked.drive is None:
        return setup.free(*asked.weight)
    mean, amplitude, _ = asked.drive
    driven = setup.driven(Actuator(), position=mean)
    _stays_inside(setup, driven.actuator, mean - amplitude, mean + amplitude)
    return driven


def _stays_inside(setup: Setup, actuator: Actuator, low: float, high: float) -> None:
    """Check that a drive from `low` to `high` [m] stays where the muscle is described; ValueError where not.

    Below 0 it is stretched, and only a muscle whose law says how far may be.
    """
    least = actuator.low if hasattr(setup.muscle, "reach") else 0.0
    if low < least - 1e-9 or high > actuator.high + 1e-9:
        lengths = f"{show(low, 'length')} to {show(high, 'length')}"
        ends = f"{show(least, 'length')} to {show(actuator.high, 'length')}"
        below = "; its law says nothing of a muscle that is stretched beyond its nominal length"
        raise ValueError(
            f"--drive goes from {lengths}, and it is driven from {ends}{below if low < least == 0 else ''}"
        )


def within(text: str, quantity: str, least: float, most: float) -> float:
    """What was typed [SI]; ValueError where it is outside, with room for rounding of units."""
    from pmabench.files.quantity import parse_quantity

    value = parse_quantity(text.strip(), quantity)
    if not least <= value <= most * (1 + 1e-9):
        raise ValueError(f'"{text.strip()}" is outside {show(least, quantity)} to {show(most, quantity)}')
    return value


def _parsed(problems: Problems, option: str, parse: Any, *arguments: Any) -> Any:
    """What `parse` makes of the arguments, or None and a line in `problems`."""
    with problems.of(option):
        return parse(*arguments)


STEP = re.compile(r"(?P<level>.+?)\s+at\s+(?P<at>.+?)(?:\s+by\s+(?P<rate>.+))?")
DRIVE = re.compile(r"(?P<mean>[^,]+?)\s*\+-\s*(?P<amplitude>[^,]+),(?P<frequency>[^,]+)")
SINE = re.compile(r"(?P<amplitude>[^,]+),(?P<frequency>[^,]+?)\s+at\s+(?P<at>.+)")


def _course(steps: tuple[str, ...], sine: str | None) -> tuple[Wave, ...]:
    """The commanded pressure from 0 on."""
    from pmabench.model.regulator import Wave, constant, ramp, to_nanosecond

    waves: list[Wave] = list(constant(0.0, 0.0))
    for text in steps:
        match = STEP.fullmatch(text.strip())
        if match is None:
            raise ValueError(f'"{text}" is no step; write "300 kPa at 0.5 s" or "300 kPa at 0.5 s by 50 kPa/s"')
        level = within(match["level"], "pressure", 0.0, HIGHEST)
        at = to_nanosecond(within(match["at"], "time", 0.0, LONGEST))
        if at < waves[-1].start or (at == waves[-1].start > 0):
            raise ValueError(f'"{text}" begins before the one before it has ended; give the steps in order of time')
        before = waves[-1].level
        if at == 0:
            waves.pop()
        if match["rate"]:
            waves += ramp(at, before, level, within(match["rate"], "pressure rate", 1.0, 1e9))
        else:
            waves += constant(at, level)
    if sine is not None:
        match = SINE.fullmatch(sine.strip())
        if match is None:
            raise ValueError(f'"{sine}" is no sine; write --sine "20 kPa, 0.5 Hz at 4 s"')
        at = to_nanosecond(within(match["at"], "time", 0.0, LONGEST))
        mean = waves[-1].level
        if at <= waves[-1].start:
            raise ValueError(f'"{sine}" begins before the last step has ended')
        amplitude = within(match["amplitude"], "pressure", 0.0, min(mean, HIGHEST - mean))
        omega = 2 * math.pi * within(match["frequency"], "frequency", 1e-6, FASTEST)
        waves.append(Wave(at, mean, amplitude=amplitude, omega=omega))
    return tuple(waves)


def _load(text: str | None) -> tuple[float, float]:
    """Force [N] and moving mass [kg]."""
    from pmabench.files.quantity import parse_mass_or_force

    kind, value = parse_mass_or_force(text or "0 N")
    if not 0 <= value <= 1e5:
        raise ValueError(f'"{text}" is no load of a muscle; expected is 0 N or more')
    return (value * G, value + CARRIAGE) if kind == "mass" else (value, FORCE_MASS)


def _drive(text: str | None) -> tuple[float, float, float] | None:
    """Mean and amplitude [m], frequency [Hz]."""
    if text is None:
        return None
    match = DRIVE.fullmatch(text.strip())
    if match is None:
        raise ValueError(f'"{text}" is no drive; write "20 mm +- 10 mm, 0.5 Hz"')
    mean = within(match["mean"], "length", -0.1, 0.1)
    return mean, within(match["amplitude"], "length", 0.0, 0.1), within(match["frequency"], "frequency", 1e-6, FASTEST)


def _overrides(settings: tuple[str, ...]) -> Overrides:
    """The changes by name; ValueError with a line for each that is wrong."""
    from pmabench.files.quantity import parse_quantity
    from pmabench.model.overrides import Overrides

    found: dict[str, Any] = {}
    wrong = []
    for text in settings:
        name, _, value = text.partition("=")
        name = name.strip()
        try:
            if name not in CHANGES:
                wrong.append(f'"{name}" is no parameter of the plants{did_you_mean(name, CHANGES)}')
            else:
                of = CHANGES[name]
                found[name] = float(value) if of == "count" else parse_quantity(value.strip(), of)
        except ValueError as error:
            wrong.append(f"{name}: {error}")
    wrong += [f"{name}: a finite number is expected" for name, value in found.items() if not math.isfinite(value)]
    if wrong:
        raise ValueError("\n".join(wrong))
    return Overrides(**found)
