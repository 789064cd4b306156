"""The muscle of a dry run by an earlier analysis of the same specimen, or by a plant file; `check --simulate` asks."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.bench.dry_run import PredictedMuscle, as_expected, by_surface, nearest_surface
from pmabench.bench.files.specimen import ExpectedFile, ExpectedPoint
from pmabench.bench.plant import read_plant
from pmabench.report.bends import slopes_of
from pmabench.store.analyses.folder import analyses_below, read_analysis
from pmabench.store.folder import run_name

if TYPE_CHECKING:
    from pmabench.bench.files.specimen import SpecimenFile
    from pmabench.model.real.muscle import Surface
    from pmabench.store.analyses.results import Analysis

SYMBOLS = ("F_ce", "K", "B_c", "B_r")
FEWEST_POINTS = 2
FEWEST_FORCES = 8
"""Values of a surface from which its five factors are found."""


def newest_of(folder: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle | None:
    """The muscle of the newest analysis of this type and serial number on a real bench; None where there is none."""
    name = run_name(datetime.now(UTC), f"{specimen.type}-{specimen.serial}", "any", simulated=False).split("_")[1]
    found = [place for place in folder.glob(f"*_{name}_*") if "_SIMULATED_" not in place.name and place.is_dir()]
    for place in sorted(found, reverse=True):
        try:
            return of_analysis(place, specimen, highest)
        except (InvalidFile, UsageError):
            continue  # nothing that describes the muscle, or damaged: an older one may
    return None


def of_file(path: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle:
    """The muscle of a folder of analyses, or of a plant file, up to `highest` [Pa]."""
    if path.is_dir():
        return of_analysis(path, specimen, highest)
    plant = read_plant(path)
    return PredictedMuscle({**plant.numbers, "file": path.name}, None, f"plant file {path}")


def of_analysis(folder: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle:
    """The muscle of the analyses in a folder: a surface where one was fitted, else coefficients over pressure.

    Raises UsageError where none has enough values.
    """
    analyses = [read_analysis(place) for place in analyses_below(folder)]
    if not analyses:
        raise UsageError(f"{folder} holds no analysis; `pmabench process` makes one")
    mark = "SIMULATED " if any(analysis.simulated for analysis in analyses) else ""
    for analysis in analyses:
        if (found := _surface(analysis, specimen)) is not None:
            source = f"{mark}analysis {folder.name}: surface of {len(analysis.runs)} runs"
            return by_surface(found, specimen, highest, source)
    for analysis in analyses:
        expected = _expected(analysis, folder.name)
        if expected is not None:
            return as_expected(expected, specimen, highest, f"{mark}analysis {folder.name}: {analysis.kind}")
    raise UsageError(
        f"{folder} says too little of the muscle: F_ce, K, B_c and B_r at two pressures are needed, or a surface"
    )


def _expected(analysis: Analysis, name: str) -> ExpectedFile | None:
    """F_ce, K, B_c and B_r at each pressure at which F_ce and K are known; a damping that is not is the other one. Of a
    bent muscle they are the tangent where K is the slope.
    """
    table: dict[float, dict[str, float]] = {}
    friction = 0.0
    for e in analysis.estimates:
        if e.value is None or e.withheld or e.coordinate:
            continue
        if e.symbol == "F_c" and not e.at:
            friction = e.value
        elif e.symbol in SYMBOLS and set(e.at) == {"pressure"}:
            table.setdefault(e.at["pressure"], {}).setdefault(e.symbol, e.value)
    methods = [e.method for e in analysis.estimates if e.symbol == "K"]
    for pressure, (x, force) in slopes_of([analysis], methods[:1]).items():
        if {"F_ce", "K"} <= set(table.get(pressure, ())):
            table[pressure]["F_ce"] = force + table[pressure]["K"] * x
    points = []
    for pressure, row in sorted(table.items()):
        damping = [row[symbol] for symbol in ("B_c", "B_r") if symbol in row]
        if {"F_ce", "K"} <= set(row) and damping:
            points.append(
                ExpectedPoint.model_construct(
                    pressure=pressure, F_ce=row["F_ce"], K=row["K"], B_c=damping[0], B_r=damping[-1]
                )
            )
    if len(points) < FEWEST_POINTS:
        return None
    return ExpectedFile.model_construct(source=f"analysis {name}", F_c=friction, points=points)


def _surface(analysis: Analysis, specimen: SpecimenFile) -> Surface | None:
    """The force surface nearest to the values of F at pressures and contractions, by least squares."""
    known = [e for e in analysis.estimates if e.symbol == "F" and e.value is not None and not e.withheld]
    known = [e for e in known if {"pressure", "contraction"} == set(e.at)]
    if len(known) < FEWEST_FORCES:
        return None
    places = [(e.at["pressure"], e.at["contraction"] / specimen.mounted.length, e.value or 0.0) for e in known]
    return nearest_surface(places)
