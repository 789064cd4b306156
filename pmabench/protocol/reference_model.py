"""The model that a run is compared with: of the specimen file, of a preset, of a plant file or of an analysis folder.

It is put into the plan as plain numbers, so that a run does not depend on a file that changes later.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from pmabench.base.errors import InvalidFile, PmaError, did_you_mean
from pmabench.bench.plant import read_plant
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Force, Pressure, Time
from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import MUSCLES, Described, changed, preset, setup_of, tabulated_force
from pmabench.model.regulator import Regulator
from pmabench.protocol.common import Compilation

if TYPE_CHECKING:
    from pmabench.store.analyses.results import Analysis, Estimate

SPECIMEN = "specimen"


class RegulatorFile(Strict):
    """How the pressure follows its command."""

    dead_time: Time = 0.0
    lag: Time = 0.0
    vent_ratio: Annotated[float, Field(gt=0, le=100)] = 1.0
    dead_band: Pressure = 0.0


class FrictionFile(Strict):
    """Coulomb friction inside the muscle: until motion, and while it moves."""

    static: Force
    kinetic: Force


class ReferenceModel(Strict):
    """Which model is simulated next to the measurement.

    `coefficients` is `specimen` (what its file expects), the name of a preset or a plant file with its kind (`paper0
    ideal`, `muscle.yaml bench`), or the folder of an analysis that gives F_ce, K and B_c over pressure, or of one of
    kind surface.
    """

    coefficients: Annotated[str, Field(min_length=1, max_length=400)]
    regulator: RegulatorFile | None = None
    friction: FrictionFile | None = None


def described(c: Compilation, model: ReferenceModel, at: Location) -> dict[str, Any] | None:
    """The model as plain data for the plan's settings; None with a problem noted where there is none."""
    name, place = model.coefficients, (*at, "coefficients")
    try:
        if name == SPECIMEN:
            table = _of_specimen(c)
        elif name.split()[0] in MUSCLES or _plant_file(name):
            return _of_preset(c, model, at)
        else:
            if (folder := _surface_folder(c, name)) is not None:
                return _of_surface(folder, model)
            table = _of_analysis(c, name)
    except (PmaError, ValueError, IndexError) as error:
        c.fault(place, str(error) or f'"{name}" names no model')
        return None

    def through(symbol: str) -> Curve:
        points = table["points"][symbol]
        return Curve.through([P for P, _ in points], [value for _, value in points])

    force = table["points"]["F_ce"]
    bad = [s for s in ("K", "B_c", "B_r") if any(value <= 0 for _, value in table["points"][s])]
    if bad or any(P <= 0 for P, _ in force):
        c.fault(place, f"{', '.join(bad) or 'pressure'} of {table['source']} is not above zero everywhere")
        return None
    regulator, friction = model.regulator, model.friction
    try:
        slip = Friction(friction.static, friction.kinetic) if friction else Friction(table["F_c"], table["F_c"])
        before = Regulator(**regulator.model_dump()) if regulator else Regulator(*table["regulator"])
    except ValueError as error:
        c.fault((*at, "friction") if friction else at, str(error))
        return None
    length = c.mounted.bench.length
    muscle = Muscle(
        name=table["source"],
        F_ce=tabulated_force([P for P, _ in force], [F for _, F in force]),
        K=through("K"),
        B_c=through("B_c"),
        B_r=through("B_r"),
        friction=slip,
        length=length,
        stop=0.4 * length,
    )
    pressures = [P for P, _ in force]
    return Described(muscle, before, table["source"], (min(pressures), max(pressures))).to_dict()


def _of_preset(c: Compilation, model: ReferenceModel, at: Location) -> dict[str, Any] | None:
    name, _, kind = model.coefficients.partition(" ")
    source, domain = f"preset {name} {kind.strip() or 'ideal'}", (0.0, 1e7)
    try:
        if file := _plant_file(model.coefficients):
            name, kind = file
            numbers = _read_plant(c, name)
            setup = changed(setup_of(numbers), kind)
            source, domain = f"plant file {name}, {kind}: {numbers['name']}", (0.0, float(numbers["highest_pressure"]))
        else:
            setup = preset(name, kind.strip() or "ideal")
        muscle, regulator, air = setup.muscle, setup.regulator, setup.air
        if not isinstance(muscle, Muscle) or not isinstance(regulator, Regulator):
            raise ValueError(f'the plant "{name}" is no three-element muscle with a free end')
        if model.friction is not None:
            muscle = replace(muscle, friction=Friction(model.friction.static, model.friction.kinetic))
        if model.regulator is not None:
            regulator, air = Regulator(**model.regulator.model_dump()), None
    except InvalidFile as error:
        c.problems += error.problems
        return None
    except ValueError as error:
        c.fault((*at, "coefficients"), str(error))
        return None
    return Described(muscle, regulator, source, domain, air).to_dict()


def _plant_file(text: str) -> tuple[str, str] | None:
    """Path and kind where a plant file is named: `muscle.yaml` or `muscle.yaml bench`."""
    path, _, kind = text.rpartition(" ") if text.endswith((" ideal", " bench")) else (text, "", "ideal")
    return (path.strip(), kind) if path.strip().endswith(".yaml") else None


def _read_plant(c: Compilation, name: str) -> dict[str, Any]:
    """The numbers of a plant file, looked for from the current folder, then next to the protocol."""
    places = [Path(name), Path(str(c.document.path)).parent / name]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise ValueError(f'there is no plant file "{name}" here or next to the protocol')
    return read_plant(path).numbers


def _of_specimen(c: Compilation) -> dict[str, Any]:
    expected = c.mounted.specimen_file.expected
    if expected is None:
        raise ValueError(
            'the specimen file has no "expected" coefficients; name a preset '
            f"({', '.join(MUSCLES)}) or the folder of an analysis"
        )
    points = sorted(expected.points, key=lambda point: point.pressure)
    table = {
        symbol: [(p.pressure, float(getattr(p, symbol))) for p in points] for symbol in ("F_ce", "K", "B_c", "B_r")
    }
    return {
        "source": f"specimen file, expected: {expected.source}",
        "points": _rising(table),
        "F_c": expected.F_c,
        "regulator": (0.0, 0.0),
    }


def _of_analysis(c: Compilation, name: str) -> dict[str, Any]:
    analysis = read_folder(c, name, ("F_ce", "K", "B_c"))
    primary = analysis.estimates[0].method if analysis.estimates else ""

    def known(symbol: str) -> list[tuple[float, float]]:
        return [
            (e.at["pressure"], e.value)
            for e in analysis.estimates
            if e.symbol == symbol and e.method == primary and set(e.at) == {"pressure"} and e.value is not None
        ]

    table = {symbol: known(symbol) for symbol in ("F_ce", "K", "B_c", "B_r")}
    table["B_r"] = table["B_r"] or table["B_c"]
    missing = [symbol for symbol, points in table.items() if not points]
    if missing:
        raise ValueError(f'the analysis "{name}" gives no {", ".join(missing)}')
    return {
        "source": f"analysis of {', '.join(analysis.runs)}",
        "points": _rising(table),
        "F_c": max(0.0, _overall(analysis, "F_c", "") or 0.0),
        "regulator": (_first(analysis, "t_d", "dead time", "command-to-pressure"), _first(analysis, "tau_P", "lag")),
    }


def _surface_folder(c: Compilation, name: str) -> Path | None:
    """The first analysis in a folder that holds a muscle as a surface."""
    from pmabench.model.identified.library import holds_surface
    from pmabench.store.analyses.folder import read_analysis

    return next((one for one in _folders(c, name) if holds_surface(read_analysis(one).facts)), None)


def _of_surface(folder: Path, model: ReferenceModel) -> dict[str, Any]:
    """The muscle of an analysis of kind surface; ValueError in words."""
    from pmabench.model.identified.library import described as surface
    from pmabench.store.analyses.folder import read_analysis

    analysis = read_analysis(folder)
    if model.friction is not None:
        raise ValueError("a muscle as a surface has its own hysteresis; leave friction out")
    regulator = Regulator(**model.regulator.model_dump()) if model.regulator else Regulator(dead_time=0.0)
    return surface(analysis.facts, f"analysis of {', '.join(analysis.runs)}", regulator).to_dict()


def _first(analysis: Analysis, symbol: str, *coordinates: str) -> float:
    """The first of several estimates of a time that is known [s]; 0 where none is."""
    found = (_overall(analysis, symbol, coordinate) for coordinate in coordinates)
    return max(0.0, next((value for value in found if value is not None), 0.0))


def _overall(analysis: Analysis, symbol: str, coordinate: str) -> float | None:
    """A value that holds for the whole campaign, else the mean over pressures."""
    matching: list[Estimate] = [e for e in analysis.estimates if e.symbol == symbol and e.coordinate == coordinate]
    whole = [e.value for e in matching if e.value is not None and not e.at]
    if whole:
        return whole[0]
    values = [e.value for e in matching if e.value is not None]
    return sum(values) / len(values) if values else None


def _rising(table: dict[str, list[tuple[float, float]]]) -> dict[str, list[tuple[float, float]]]:
    """Points by pressure, each pressure once."""
    return {symbol: sorted(dict(points).items()) for symbol, points in table.items()}


def read_folder(c: Compilation, name: str, needed: tuple[str, ...]) -> Analysis:
    """The analysis in a folder that a protocol names (or in the one folder inside it) that gives what is needed.

    A relative path is looked for from the current folder, then next to the protocol. Raises ValueError in words.
    """
    from pmabench.store.analyses.folder import read_analysis

    symbols = ", ".join(needed)
    found = _folders(c, name)
    if not found:
        known = [SPECIMEN, *MUSCLES]
        raise ValueError(
            f'"{name}" is no analysis folder{did_you_mean(name, known)}; '
            f"process a run that gives {symbols} and name its folder"
        )
    try:
        analyses = [read_analysis(folder) for folder in found]
    except InvalidFile as error:
        raise ValueError(str(error)) from error
    for analysis in analyses:
        if {*needed} <= {e.symbol for e in analysis.estimates}:
            return analysis
    raise ValueError(f'"{name}" is an analysis of kind {analyses[0].kind} and gives no {symbols}')


def _folders(c: Compilation, name: str) -> list[Path]:
    """The folders of analyses that a name in a protocol means: the folder itself, or those inside it."""
    from pmabench.store.analyses.folder import ANALYSIS

    places = [Path(name), Path(str(c.document.path)).parent / name]
    folders = [file.parent for place in places for file in (place / ANALYSIS, *sorted(place.glob(f"*/{ANALYSIS}")))]
    return [folder for folder in folders if (folder / ANALYSIS).is_file()]
