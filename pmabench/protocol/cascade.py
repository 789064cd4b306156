"""Cascade files: muscles in series, each with its own model and pressure steps; for simulation only."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

from pydantic import AfterValidator, Field, WithJsonSchema

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import show
from pmabench.bench.plant import read_plant
from pmabench.files.document import Document, Location, Strict, read_document, validate
from pmabench.files.quantity import Frequency, Load, Pressure, Time
from pmabench.model.cascade import Member, PlantMuscle, PrintedMuscle, Step
from pmabench.model.library.coefficients import DMSP_ANGLE, DMSP_LENGTH, DMSP_PRESSURE, DMSP_RADIUS
from pmabench.model.muscle import Muscle
from pmabench.model.overrides import Overrides
from pmabench.model.plant import Plant
from pmabench.model.presets import MUSCLES, Setup, changed, preset, setup_of

G = 9.81
CARRIAGE, FORCE_MASS = 2.0, 0.5
"""Moving mass in addition to weights, and moving mass with a load given as a force [kg]."""
MOST_MUSCLES, MOST_VALUES, LONGEST = 100, 2_000_000, 3600.0
FEWEST_ROWS = 10
HIGHEST = 600e3
"""Highest pressure of the presets [Pa]."""
DMSP = "dmsp-40-305"
PLANT_RADIUS, PLANT_ANGLE = 0.010, math.radians(25)
"""Radius [m] and braid angle [rad] with which other plants are drawn."""
NAME = "[A-Za-z0-9][A-Za-z0-9 _.-]{0,39}"


def _plain(name: str) -> str:
    if not re.fullmatch(NAME, name):
        raise ValueError("a name begins with a letter or digit and has at most 40 letters, digits, blanks, _ . or -")
    return name


Name = Annotated[str, AfterValidator(_plain), WithJsonSchema({"type": "string", "pattern": f"^{NAME}$"})]


class PressureStep(Strict):
    """One step of a muscle: from the time `at`, counted from the end of its delay, the pressure `to` is commanded."""

    at: Time
    to: Pressure


class MuscleFile(Strict):
    """One muscle, or `count` equal ones, each `stagger` later than the one before it."""

    name: Name | None = None
    model: Literal["dmsp-40-305"] | None = None
    """Paper 1's printed polynomials, in closed form."""
    plant: str | None = None
    """A plant of the simulated bench, by its name or by the path of a plant file, relative to this file."""
    preset: Literal["ideal", "bench"] | None = None
    count: Annotated[int, Field(ge=1, le=MOST_MUSCLES)] = 1
    delay: Time = 0.0
    stagger: Time = 0.0
    pressure: Annotated[list[PressureStep], Field(min_length=1, max_length=1000)]


class CascadeFile(Strict):
    """A cascade; its muscles in the order from the fixed end to the load."""

    schema_: Annotated[Literal["pmabench.cascade/1"], Field(alias="schema")]
    name: Annotated[str, Field(max_length=120)]
    source: Annotated[str, Field(max_length=400)] = ""
    load: Load = ("force", 0.0)
    fce_eval: Literal["x0", "xmax"] | None = None
    """Contraction at which F_ce of a dmsp-40-305 is evaluated; one convention for the whole chain."""
    sample_rate: Frequency
    duration: Time
    muscles: Annotated[list[MuscleFile], Field(min_length=1, max_length=MOST_MUSCLES)]


@dataclass(frozen=True)
class ChainMuscle:
    """One muscle of a compiled chain: its name, its model, and its shape for the drawing [m, rad]."""

    name: str
    law: str
    steps: tuple[Step, ...]
    length: float
    radius: float
    braid_angle: float
    setup: Setup | None
    """The plant; None for the printed model."""
    load: tuple[float, float]
    fce_eval: str

    def member(self) -> Member:
        """The muscle at rest, ready to be simulated."""
        if self.setup is None:
            return PrintedMuscle(self.steps, self.load[0], self.fce_eval)
        plant = cast("Plant", self.setup.free(*self.load))  # other kinds were refused when the file was read
        return PlantMuscle(plant, self.steps)


@dataclass(frozen=True)
class _Law:
    """Model of the muscles of an entry: name, plant (None: the printed model), length [m], highest pressure [Pa]."""

    name: str
    setup: Setup | None
    length: float
    highest: float


@dataclass(frozen=True)
class ChainPlan:
    """A checked cascade, SI: `load` is the force F_L [N] and the mass that moves with it [kg]."""

    name: str
    source: str
    load: tuple[float, float]
    fce_eval: str
    rate: float
    duration: float
    muscles: tuple[ChainMuscle, ...]

    @property
    def rows(self) -> int:
        """Number of samples per column."""
        return int(self.rate * self.duration * (1 + 1e-12)) + 1


def read_cascade(path: Path) -> ChainPlan:
    """The chain of a file; raises `InvalidFile` with every problem."""
    document = read_document(path)
    return _Reading(document, validate(CascadeFile, document), path.parent).plan()


class _Reading:
    """Checks a cascade file and collects all its problems."""

    def __init__(self, document: Document, file: CascadeFile, folder: Path) -> None:
        self.document, self.file, self.folder = document, file, folder
        self.problems: list[Problem] = []

    def fault(self, message: str, *location: str | int, key: bool = False) -> None:
        self.problems.append(self.document.problem(location, message, key=key))

    def plan(self) -> ChainPlan:
        """The checked chain; raises InvalidFile with every problem."""
        file = self.file
        kind, value = file.load
        if not 0 <= value <= 1e5:
            self.fault("no load of a chain; expected is 0 N or more", "load")
        force, mass = (value * G, value + CARRIAGE) if kind == "mass" else (value, FORCE_MASS)
        if not 0 < file.duration <= LONGEST:
            self.fault(f"must be above zero and at most {LONGEST:g} s", "duration")
        if not 1 <= file.sample_rate <= 1e4:
            self.fault("must be 1 Hz to 10 kHz", "sample_rate")
        self._sizes()
        self._convention()
        muscles: list[ChainMuscle] = []
        taken: set[str] = set()
        for index, muscle in enumerate(file.muscles):
            before = len(self.problems)
            law = self._law(muscle, ("muscles", index))
            self._check(index, muscle, law)
            if law is not None and len(self.problems) == before:
                for number in range(muscle.count):
                    one = self._one(muscle, law, number, len(muscles), (force, mass))
                    if one.name in taken:
                        self.fault(f'a second muscle is called "{one.name}"', "muscles", index, "name")
                    taken.add(one.name)
                    muscles.append(one)
        if self.problems:
            raise InvalidFile(self.problems)
        return ChainPlan(
            file.name, file.source, (force, mass), file.fce_eval or "", file.sample_rate, file.duration, tuple(muscles)
        )

    def _sizes(self) -> None:
        count = sum(muscle.count for muscle in self.file.muscles)
        rows = self.file.sample_rate * self.file.duration
        if 0 < rows < FEWEST_ROWS:
            self.fault(
                f"makes {rows:.3g} samples; at least {FEWEST_ROWS} are needed: take a higher rate", "sample_rate"
            )
        if count > MOST_MUSCLES:
            self.fault(f"makes {count} muscles; at most {MOST_MUSCLES} are simulated", "muscles")
        elif count * rows > MOST_VALUES:
            self.fault(
                f"makes {count} x {rows:.0f} samples; at most {MOST_VALUES} are kept: take a lower rate", "sample_rate"
            )

    def _convention(self) -> None:
        asked = any(DMSP in (muscle.model, muscle.plant) for muscle in self.file.muscles)
        if asked and self.file.fce_eval is None:
            self.fault(
                f'"fce_eval" is missing: x0 takes F_ce of a {DMSP} without contraction, xmax at the final contraction '
                "as paper 1 does; they give 76 and 42 mm of one muscle at 6 bar"
            )
        if not asked and self.file.fce_eval is not None:
            self.fault(f"no muscle here is a {DMSP}, for which this is", "fce_eval", key=True)

    def _law(self, muscle: MuscleFile, at: Location) -> _Law | None:
        """The model of a muscle; None with a problem noted where it has none."""
        if (muscle.model is None) == (muscle.plant is None):
            self.fault(f'needs either "model: {DMSP}" or "plant: NAME", one of both', *at)
            return None
        if muscle.plant is None:
            if muscle.preset is not None:
                self.fault("goes with a plant; the printed model has none", *at, "preset", key=True)
            return _Law(DMSP, None, DMSP_LENGTH, DMSP_PRESSURE.high)
        kind = muscle.preset or "ideal"
        if muscle.plant.endswith(".yaml"):
            return self._plant_of_a_file(muscle.plant, kind, at)
        if muscle.plant not in MUSCLES:
            self.fault(f'no plant "{muscle.plant}"{did_you_mean(muscle.plant, MUSCLES)}', *at, "plant")
            return None
        change = Overrides(fce_eval=self.file.fce_eval if muscle.plant == DMSP else None)
        setup = preset(muscle.plant, kind, change)
        return _Law(f"{muscle.plant}, {kind}", setup, setup.muscle.length, HIGHEST)

    def _plant_of_a_file(self, name: str, kind: str, at: Location) -> _Law | None:
        path = self.folder / name
        if not path.is_file():
            self.fault(f'there is no plant file "{name}" next to this file', *at, "plant")
            return None
        try:
            numbers = read_plant(path).numbers
        except InvalidFile as error:
            self.problems += [problem for problem in error.problems if problem not in self.problems]
            return None
        setup = changed(setup_of(numbers), kind)
        if not isinstance(setup.muscle, Muscle):
            self.fault("has no F_ce and K over pressure, which a chain needs", *at, "plant")
            return None
        return _Law(f"{numbers['name']}, {kind}", setup, setup.muscle.length, float(numbers["highest_pressure"]))

    def _check(self, index: int, muscle: MuscleFile, law: _Law | None) -> None:
        at: Location = ("muscles", index)
        if muscle.stagger and muscle.count == 1:
            self.fault('is from one muscle to the next, and "count" is 1; a single one has a "delay"', *at, "stagger")
        last = muscle.delay + (muscle.count - 1) * muscle.stagger
        before = -1.0
        for number, step in enumerate(muscle.pressure):
            place: Location = (*at, "pressure", number)
            if step.at <= before:
                self.fault("must be later than the step before it", *place, "at")
            before = max(before, step.at)
            if not last + step.at < self.file.duration:
                when = "of the last of them " if muscle.count > 1 else ""
                self.fault(
                    f"{when}comes at {last + step.at:g} s, and the simulation ends at {self.file.duration:g} s",
                    *place, "at",
                )  # fmt: skip
            if law is not None:
                self._pressure(step.to, law, (*place, "to"))

    def _pressure(self, pressure: float, law: _Law, place: Location) -> None:
        shown, highest = show(pressure, "pressure"), show(law.highest, "pressure")
        slack = 1e-6
        if law.setup is not None:
            if not 0 <= pressure <= law.highest + slack:
                self.fault(f"{shown} is outside 0 to {highest}, for which {law.name} is described", *place)
        elif pressure != 0 and not DMSP_PRESSURE.low - slack <= pressure <= law.highest + slack:
            low = show(DMSP_PRESSURE.low, "pressure")
            self.fault(f"{shown} is neither 0 nor {low} to {highest}: {DMSP_PRESSURE.reason}", *place)

    def _one(self, muscle: MuscleFile, law: _Law, number: int, place: int, load: tuple[float, float]) -> ChainMuscle:
        """The muscle `number` of an entry, at `place` in the chain."""
        name = muscle.name or f"muscle {place + 1}"
        begin = muscle.delay + number * muscle.stagger
        dmsp = DMSP in (muscle.model, muscle.plant)
        radius, angle = (DMSP_RADIUS, DMSP_ANGLE) if dmsp else (PLANT_RADIUS, PLANT_ANGLE)
        return ChainMuscle(
            name=name if muscle.name is None or muscle.count == 1 else f"{name} {number + 1}",
            law=law.name,
            steps=tuple(Step(round(begin + step.at, 9), step.to) for step in muscle.pressure),
            length=law.length,
            radius=radius,
            braid_angle=angle,
            setup=law.setup,
            load=load,
            fce_eval=self.file.fce_eval or "x0",
        )
