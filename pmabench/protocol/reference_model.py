"""The model that a run is compared with: from the specimen file, a preset or an analysis folder.

It is stored in the plan as plain numbers, so that a run does not depend on a file that may change later.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from pmabench.base.errors import InvalidFile, PmaError, did_you_mean
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Force, Pressure, Time
from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import MUSCLES, Described, preset, tabulated_force
from pmabench.model.regulator import Regulator
from pmabench.protocol.common import Compilation

if TYPE_CHECKING:
    from pmabench.store.analyses.results import Analysis, Estimate

SPECIMEN = "specimen"
SYMBOLS = ("F_ce", "K", "B_c", "B_r")


class RegulatorFile(Strict):
    """How the pressure follows its command."""

    dead_time: Time = 0.0
    lag: Time = 0.0
    vent_ratio: Annotated[float, Field(gt=0, le=100)] = 1.0
    dead_band: Pressure = 0.0


class FrictionFile(Strict):
    """Coulomb friction inside the muscle, at rest and in motion."""

    static: Force
    kinetic: Force


class ReferenceModel(Strict):
    """Which model is simulated next to the measurement.

    `coefficients` is `specimen` (the expected values of its file), the name of a preset with its kind (`paper0 ideal`),
    or the folder of an analysis: one that gives F_ce, K and B_c over pressure, or one of kind surface.
    """

    coefficients: Annotated[str, Field(min_length=1, max_length=400)]
    regulator: RegulatorFile | None = None
    friction: FrictionFile | None = None


def described(c: Compilation, model: ReferenceModel, at: Location) -> dict[str, Any] | None:
    """The model as plain data for the plan's settings; None with a problem noted where there is none."""
    before = len(c.problems)
    try:
        found = _found(c, model.coefficients)
    except InvalidFile as error:
        c.problems += error.problems
        return None
    except (PmaError, ValueError) as error:
        c.fault((*at, "coefficients"), str(error))
        return None
    if model.friction is not None:
        with c.noting((*at, "friction")):
            if found.surface is not None:
                raise ValueError("a muscle as a surface has its own hysteresis; leave friction out")
            friction = Friction(model.friction.static, model.friction.kinetic)
            found = replace(found, muscle=replace(found.muscle, friction=friction))
    if model.regulator is not None:
        with c.noting((*at, "regulator")):
            found = replace(found, regulator=Regulator(**model.regulator.model_dump()), air=None)
    return found.to_dict() if len(c.problems) == before else None


def _found(c: Compilation, name: str) -> Described:
    """The specimen's model, or that in the preset or folder of that name; raises ValueError or `InvalidFile`."""
    if name == SPECIMEN:
        return _of_specimen(c)
    if name.partition(" ")[0] in MUSCLES:
        return _of_preset(name)
    return _of_surface(c, name) or _of_analysis(c, name)


def _straight(
    c: Compilation, source: str, points: dict[str, list[tuple[float, float]]], F_c: float, regulator: Regulator
) -> Described:
    """A model with coefficients linear between `points` (pressure [Pa], value); ValueError if one is not above 0."""
    lines = {symbol: tuple(zip(*sorted(dict(known).items()), strict=True)) for symbol, known in points.items()}
    pressures, forces = lines["F_ce"]
    bad = [symbol for symbol in ("K", "B_c", "B_r") if min(lines[symbol][1]) <= 0]
    if bad or min(pressures) <= 0:
        raise ValueError(f"{', '.join(bad) or 'pressure'} of {source} is not above zero everywhere")
    length = c.mounted.bench.length
    muscle = Muscle(
        name=source,
        F_ce=tabulated_force(pressures, forces),
        K=Curve.through(*lines["K"]),
        B_c=Curve.through(*lines["B_c"]),
        B_r=Curve.through(*lines["B_r"]),
        friction=Friction(F_c, F_c),
        length=length,
        stop=0.4 * length,
    )
    return Described(muscle, regulator, source, (min(pressures), max(pressures)))


def _of_preset(text: str) -> Described:
    name, _, kind = text.partition(" ")
    kind = kind.strip() or "ideal"
    setup = preset(name, kind)
    if not isinstance(setup.muscle, Muscle):
        raise ValueError(f'the plant "{name}" is no three-element muscle with a free end')
    return Described(setup.muscle, setup.regulator, f"preset {name} {kind}", (0.0, 1e7), setup.air)


def _of_specimen(c: Compilation) -> Described:
    expected = c.mounted.specimen_file.expected
    if expected is None:
        raise ValueError(
            'the specimen file has no "expected" coefficients; name a preset '
            f"({', '.join(MUSCLES)}) or the folder of an analysis"
        )
    points = {
        symbol: [(point.pressure, float(getattr(point, symbol))) for point in expected.points] for symbol in SYMBOLS
    }
    source = f"specimen file, expected: {expected.source}"
    return _straight(c, source, points, expected.F_c, Regulator(dead_time=0.0))


def _of_analysis(c: Compilation, name: str) -> Described:
    analysis = read_folder(c, name, ("F_ce", "K", "B_c"))
    primary = analysis.estimates[0].method if analysis.estimates else ""
    points: dict[str, list[tuple[float, float]]] = {symbol: [] for symbol in SYMBOLS}
    for e in analysis.estimates:
        if e.symbol in points and e.method == primary and set(e.at) == {"pressure"} and e.value is not None:
            points[e.symbol].append((e.at["pressure"], e.value))
    points["B_r"] = points["B_r"] or points["B_c"]
    if missing := [symbol for symbol, known in points.items() if not known]:
        raise ValueError(f'the analysis "{name}" gives no {", ".join(missing)}')
    F_c = max(0.0, _overall(analysis, "F_c", "") or 0.0)
    dead_time = _first(analysis, "t_d", "dead time", "command-to-pressure")
    return _straight(c, _source(analysis), points, F_c, Regulator(dead_time, _first(analysis, "tau_P", "lag")))


def _of_surface(c: Compilation, name: str) -> Described | None:
    """The muscle of the first analysis in a folder that contains a surface; None where none does."""
    from pmabench.model.identified.library import described as surface
    from pmabench.model.identified.library import holds_surface
    from pmabench.store.analyses.folder import read_analysis

    analyses = (read_analysis(one) for one in _folders(c, name))
    analysis = next((one for one in analyses if holds_surface(one.facts)), None)
    return None if analysis is None else surface(analysis.facts, _source(analysis), Regulator(dead_time=0.0))


def _source(analysis: Analysis) -> str:
    return f"analysis of {', '.join(analysis.runs)}"


def _first(analysis: Analysis, symbol: str, *coordinates: str) -> float:
    """The first known estimate of a time [s], over several coordinates; 0 where none is known."""
    found = (_overall(analysis, symbol, coordinate) for coordinate in coordinates)
    return max(0.0, next((value for value in found if value is not None), 0.0))


def _overall(analysis: Analysis, symbol: str, coordinate: str) -> float | None:
    """The value for the whole campaign, else the mean over operating points; None where there is none."""
    matching: list[Estimate] = [e for e in analysis.estimates if e.symbol == symbol and e.coordinate == coordinate]
    whole = [e.value for e in matching if e.value is not None and not e.at]
    if whole:
        return whole[0]
    values = [e.value for e in matching if e.value is not None]
    return sum(values) / len(values) if values else None


def read_folder(c: Compilation, name: str, needed: tuple[str, ...]) -> Analysis:
    """The first analysis that gives the `needed` symbols, in a folder that a protocol names or in a folder inside it.

    A relative path is searched from the current folder, then next to the protocol. Raises ValueError with the reason.
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
    """Analysis folders for a name in a protocol: the folder itself, and those directly inside it."""
    from pmabench.store.analyses.folder import ANALYSIS

    places = [Path(name), Path(str(c.document.path)).parent / name]
    folders = [file.parent for place in places for file in (place / ANALYSIS, *sorted(place.glob(f"*/{ANALYSIS}")))]
    return [folder for folder in folders if (folder / ANALYSIS).is_file()]
