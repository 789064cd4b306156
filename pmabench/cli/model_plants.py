"""Plants of `pmabench model simulate` besides the library's single muscles: joint, platform, muscle of an analysis.

The muscle of an analysis of kind surface is also a model of the other commands.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.cli.model_inputs import column_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pmabench.model.library import Model
    from pmabench.model.many.platform import Opening
    from pmabench.model.presets import Described
    from pmabench.model.regulator import Regulator, Wave
    from pmabench.store.analyses.results import Analysis


PLANTS = ("joint", "platform")
LONGEST = 100.0
"""Latest moment of a step or opening [s]."""
HIGHEST = 7e5
"""Most gauge pressure that is commanded [Pa]."""
MOST_TURN = math.radians(45.8)
"""To either side a muscle of the joint reaches the end of the contractions for which it is described [rad]."""
MOST_TILT = math.radians(20)
SAMPLE = 0.002
"""Period of the platform's loop [s]."""
OF_MUSCLE = re.compile(r"\s*([12])\s*:\s*(.+)")
OPEN = re.compile(r"\s*(fill|exhaust)\s+([123])\s*,\s*(.+?)\s+to\s+(.+?)\s*")
DRIVE = re.compile(r"(?P<mean>[^,]+?)\s*\+-\s*(?P<amplitude>[^,]+),(?P<frequency>[^,]+)")


def columns_of(
    plant: str, steps: Sequence[str], openings: Sequence[str], drive: str | None, chain: str, times: list[float]
) -> tuple[list[Any], str]:
    """A joint or a platform of the library, simulated from rest: its columns, and a sentence about its law."""
    if plant == "joint":
        if openings:
            raise ValueError("--open is for the platform")
        return _joint(_courses(steps), drive, times), ""
    if drive is not None:
        raise ValueError("--drive is for the joint; the platform is free")
    return _platform(steps, openings, chain, times)


def within(text: str, quantity: str, least: float, most: float) -> float:
    """What was typed [SI]; ValueError where it is outside, with room for rounding of units."""
    from pmabench.files.quantity import parse_quantity

    value = parse_quantity(text.strip(), quantity)
    if not least <= value <= most * (1 + 1e-9):
        raise ValueError(f'"{text.strip()}" is outside {show(least, quantity)} to {show(most, quantity)}')
    return value


def _courses(steps: Sequence[str]) -> tuple[tuple[Wave, ...], tuple[Wave, ...]]:
    """Commanded pressures of both muscles, from 0 on."""
    from pmabench.model.regulator import constant, to_nanosecond

    courses: tuple[list[Wave], list[Wave]] = list(constant(0.0, 0.0)), list(constant(0.0, 0.0))
    for text in steps:
        match = OF_MUSCLE.fullmatch(text)
        level, _, at = (match[2] if match else "").partition(" at ")
        if match is None or not at:
            raise ValueError(f'"{text}" is no step of a muscle; write --step "1: 300 kPa at 0.5 s"')
        course = courses[int(match[1]) - 1]
        begin = to_nanosecond(within(at, "time", 0.0, LONGEST))
        if begin < course[-1].start:
            raise ValueError(f'"{text}" begins before the one before it; give the steps in order of time')
        if begin == course[-1].start:
            course.pop()
        course += constant(begin, within(level, "pressure", 0.0, HIGHEST))
    return tuple(courses[0]), tuple(courses[1])


def _joint(courses: tuple[tuple[Wave, ...], tuple[Wave, ...]], drive: str | None, times: list[float]) -> list[Any]:
    from pmabench.model.many.joint import Joint, JointPlant
    from pmabench.model.regulator import sine

    plant = JointPlant(Joint())
    for muscle, course in enumerate(courses):
        plant.command(muscle, course)
    if drive is not None:
        match = DRIVE.fullmatch(drive.strip())
        if match is None:
            raise ValueError(f'"{drive}" is no drive of a joint; write --drive "0 deg +- 30 deg, 0.05 Hz"')
        mean = within(match["mean"], "angle", -MOST_TURN, MOST_TURN)
        amplitude = within(match["amplitude"], "angle", 0.0, MOST_TURN - abs(mean))
        frequency = within(match["frequency"], "frequency", 1e-6, 10.0)
        plant.angle = mean
        plant.drive(sine(0.0, mean, amplitude, frequency, math.ceil(times[-1] * frequency) + 1))
    found = plant.advance(times[-1], times)
    quantities = ("angle", "angular speed", "torque", "pressure", "pressure")
    return [
        column_of("time", "time", times),
        *(column_of(name, quantity, getattr(found, name).tolist())
          for name, quantity in zip(found._fields, quantities, strict=True)),
    ]  # fmt: skip


def _opening(text: str) -> Opening:
    from pmabench.model.many.platform import Opening

    match = OPEN.fullmatch(text)
    if match is None:
        raise ValueError(f'"{text}" is no opening of a valve; write --open "fill 1, 100 ms to 130 ms"')
    begin, end = (within(part, "time", 0.0, LONGEST) for part in match.groups()[2:])
    if end <= begin:
        raise ValueError(f'"{text}" shuts before it opens')
    return Opening(match[1], int(match[2]) - 1, begin, end)


def _attitude(text: str) -> list[float]:
    """Time [s], phi and psi [rad] of a step of attitude."""
    angles, _, at = text.partition(" at ")
    phi, comma, psi = angles.partition(",")
    if not comma or not at:
        raise ValueError(f'"{text}" is no step of a platform; write --step "10 deg, 0 deg at 1 s"')
    return [within(at, "time", 0.0, LONGEST), *(within(part, "angle", -MOST_TILT, MOST_TILT) for part in (phi, psi))]


def _controlled(goals: list[list[float]], chain: str, times: list[float]) -> tuple[list[Any], str]:
    """The platform under its law at 500 Hz, level at first; and what its largest goal was like, in a sentence."""
    from pmabench.engine.laws.platform_loop import PlatformLoop
    from pmabench.model.many.platform import PlatformPlant

    plant, states, wanted = PlatformPlant(), [], sorted(goals)
    loop = PlatformLoop(goals=[[0.0, 0.0, 0.0], *wanted], duration=times[-1] + 1.0, chain=chain)
    farthest, far = 0.0, 0
    samples = math.ceil(times[-1] / SAMPLE)
    for number in range(samples + 1):
        t = number * SAMPLE
        while far < len(times) and times[far] <= t + 1e-9:
            plant.advance(max(plant.time, times[far]))
            states.append(plant.state)
            far += 1
        plant.advance(max(plant.time, t))
        farthest = max(farthest, math.acos(math.cos(plant.state[0]) * math.cos(plant.state[1])))
        for pulse in loop.update(plant.time, plant.measure()).pulses:
            kind, _, muscle = pulse.valve.partition("_")
            plant.pulse(kind, int(muscle) - 1, pulse.seconds)
    most = max(plant.openings.values()) / max(times[-1], SAMPLE)
    steepest = max(math.acos(math.cos(phi) * math.cos(psi)) for _, phi, psi in wanted)
    said = f"steepest goal {show(steepest, 'angle', 3)}, steepest tilt {show(farthest, 'angle', 3)}"
    return _columns(times, states), f"{said}; a valve opened {most:.1f} times a second at most"


def _platform(steps: Sequence[str], openings: Sequence[str], chain: str, times: list[float]) -> tuple[list[Any], str]:
    """A platform under its law, or with valves opened by hand: its columns, and a sentence about its law."""
    from pmabench.model.many.platform import Platform

    if steps and openings:
        raise ValueError("a platform is controlled, with --step, or its valves are opened, with --open; not both")
    if steps:
        return _controlled([_attitude(text) for text in steps], chain, times)
    if chain != "reference":
        raise ValueError("--chain is for a platform with --step")
    return _columns(times, Platform().simulate([_opening(text) for text in openings], times)), ""


def _columns(times: list[float], states: Sequence[Sequence[float]]) -> list[Any]:
    """Attitude and pressures of a platform."""
    heads = (("phi", "angle", 0), ("psi", "angle", 1), *((f"pressure_{i + 1}", "pressure", 4 + i) for i in range(3)))
    return [
        column_of("time", "time", times),
        *(column_of(name, quantity, [state[place] for state in states]) for name, quantity, place in heads),
    ]


def analysis_of(folder: Path) -> Analysis:
    """The analysis in a folder, or the first inside it, that holds a muscle as a surface; else UsageError."""
    from pmabench.model.identified.library import holds_surface
    from pmabench.store.analyses.folder import analyses_below, read_analysis

    analyses = [read_analysis(one) for one in analyses_below(folder)]
    able = [one for one in analyses if holds_surface(one.facts)]
    if not able:
        kinds = ", ".join(sorted({one.kind for one in analyses})) or "no analysis"
        raise UsageError(
            f"{folder} holds {kinds}, and no muscle as a surface: give the folder of an analysis that was made with "
            '"pmabench process RUN... --form surface"'
        )
    return able[0]


def described_by(folder: Path, regulator: Regulator) -> Described:
    """The muscle of `analysis_of` a folder behind a regulator."""
    from pmabench.model.identified.library import described

    analysis = analysis_of(folder)
    try:
        return described(analysis.facts, f"analysis of {', '.join(analysis.runs)}", regulator)
    except ValueError as error:
        raise UsageError(f"{folder}: {error}") from error


def surface_model(folder: Path) -> Model:
    """The muscle of `analysis_of` a folder as a model of the library, with how well it predicts."""
    from pmabench.model.identified.library import as_model
    from pmabench.model.regulator import Regulator

    known, facts = described_by(folder, Regulator()), analysis_of(folder).facts
    left_out, lines = (show(facts[name], "force", 2) for name in ("held_out_rms", "straight_form_rms"))
    note = f"Trials that were left out of the fit were predicted to {left_out} rms; by straight lines to {lines}."
    assert known.surface is not None  # noqa: S101  (`described` makes it)
    return as_model(known.surface, str(folder), known.source, note)
