"""The part of `pmabench tune` that takes K_u and T_u from the muscle and regulator of a campaign of contractions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pmabench.base.kind import load
from pmabench.cli.common import Ui

if TYPE_CHECKING:
    from pmabench.analysis.results import Analysis
    from pmabench.base.kind import Kind

PART = "tune by model"
LOOP = ("F_ce", "K", "B_c", "tau_P")
"""Coefficients that make a loop, with the lag of the regulator."""
G = 9.80665
LONGEST, MOST, SLOWEST = 10.0, 1e5, 10.0
"""Set-points [m], loads [N] and sample periods [s] above which nothing is believed."""


@dataclass(frozen=True)
class Where:
    """Where the loop is to be known: set-points [m], load [N], its mass [kg], sample period [s] (None: the runs')."""

    setpoints: tuple[float, ...]
    load: float
    mass: float
    period: float | None
    given: bool
    """Whether any of it was given."""

    @classmethod
    def read(cls, setpoints: Sequence[str], load: str | None, period: str | None) -> Where:
        """From what was typed; UsageError for what cannot be."""
        from pmabench.base.errors import UsageError
        from pmabench.files.quantity import parse_mass_or_force, parse_quantity

        def quantity(option: str, text: str, kind: str, most: float) -> float:
            try:
                value = parse_quantity(text, kind)
            except ValueError as error:
                raise UsageError(f"{option}: {error}") from error
            if not 0 <= value <= most:
                raise UsageError(f'{option}: "{text}" is no {kind} that can be; expected is 0 to {most:g} in SI units')
            return value

        places = tuple(quantity("--setpoint", text, "length", LONGEST) for text in setpoints)
        try:
            hung, value = ("force", 0.0) if load is None else parse_mass_or_force(load)
        except ValueError as error:
            raise UsageError(f"--load: {error}") from error
        force, mass = (value * G, value) if hung == "mass" else (value, 0.0)
        if not 0 <= force <= MOST:
            raise UsageError(f'--load: "{load}" is no load of a muscle; expected is 0 to {MOST:g} N')
        step = None if period is None else quantity("--period", period, "time", SLOWEST)
        return cls(places, force, mass, step, bool(setpoints) or load is not None or period is not None)


def holds_model(folder: Path) -> bool:
    """Whether a folder is an analysis whose coefficients make a loop."""
    from pmabench.store.analyses.folder import read_analysis

    return read_analysis(folder).kind in models()


def models() -> dict[str, Kind]:
    """The kinds of test whose coefficients make a loop."""
    from pmabench.kinds import registry

    return registry.with_results(*LOOP)


def by_folder(folder: Path, where: Where) -> Analysis:
    """K_u and T_u by the model of an analysis; without `--period` no hold is counted."""
    from pmabench.store.analyses.folder import read_analysis

    return _found(folder, read_analysis(folder), where, where.period or 0.0)


def by_runs(ui: Ui, runs: Sequence[Path], where: Where) -> Analysis:
    """K_u and T_u by the model that is fitted to runs; they must be of one specimen."""
    from pmabench.base.errors import invalid
    from pmabench.cli.process import load_runs, without_analyses
    from pmabench.kinds import registry
    from pmabench.kinds.reduce import reduce_runs, reduction_of

    loaded = load_runs(without_analyses(ui, runs))
    able = models()
    for run in loaded:
        if reduction_of(run) not in able:
            raise invalid(run.path, f'is a run of kind "{reduction_of(run)}"; --model takes kind {", ".join(able)}')
    reduced = [a for a in reduce_runs(loaded, registry.options_for({"regulator": True})) if a.kind in able]
    if len(reduced) != 1:
        raise invalid(runs[0], "the runs are of several specimens; give those of one")
    period = max(1 / run.rate for run in loaded) if where.period is None else where.period
    return _found(runs[0], reduced[0], where, period)


def _found(path: Path, analysis: Analysis, where: Where, period: float) -> Analysis:
    from pmabench.base.errors import invalid
    from pmabench.kinds import registry

    try:
        made: Analysis = load(next(iter(registry.with_part(PART).values())).parts[PART])(
            analysis, where.setpoints, where.load, where.mass, period
        )
    except ValueError as error:
        raise invalid(path, str(error)) from error
    return made
