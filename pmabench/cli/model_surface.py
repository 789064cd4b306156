"""The muscle of an analysis of kind surface, as the commands of `pmabench model` take it; and a run next to it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.cli.common import Ui
from pmabench.cli.model_inputs import column_of, show_columns

if TYPE_CHECKING:
    from pmabench.analysis.surface.replay import Replay
    from pmabench.model.library import Model
    from pmabench.model.presets import Described
    from pmabench.model.regulator import Regulator
    from pmabench.store.analyses.results import Analysis

MOST_SAMPLES = 20_000
SHOWN = ("pressure", "load", "contraction", "mean", "amplitude", "frequency", "upper", "step", "setpoint")
"""What is printed of the operating point of a trial."""


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


def next_to(ui: Ui, folder: Path, run_folder: Path, number: int | None, *, as_csv: bool) -> None:
    """Print how far the muscle of an analysis, and straight lines, are off each trial of a run.

    With the `number` of a trial its samples, measured and simulated.
    """
    from pmabench.analysis.surface.replay import replayed
    from pmabench.model.regulator import Regulator
    from pmabench.store.reader import open_run

    model = described_by(folder, Regulator(dead_time=0.0))
    run = open_run(run_folder)
    trials = [trial for trial in run.trials if number in (None, trial.number)]
    if not trials:
        raise UsageError(f"--trial {number}: {run_folder} has trials 1 to {len(run.trials)}")
    replays = [(trial, replayed(model, run, trial)) for trial in trials]
    found = [one for _, one in replays if not isinstance(one, str)]
    refused = [f"trial {trial.number} is left out: {one}" for trial, one in replays if isinstance(one, str)]
    if not found:
        raise UsageError(f"{run_folder}: " + "; ".join(dict.fromkeys(refused)))
    columns = _samples(found[0]) if number is not None else _errors(found)
    data: dict[str, Any] = {"schema": "pmabench.model-replay/1", "simulated": run.simulated, "run": run.id}
    data |= {"model": model.source, "left_out": refused, "columns": columns}

    show_columns(ui, data, as_csv=as_csv, above="SIMULATED" if run.simulated else "", below=[*refused, *_in_all(found)])


def _errors(replays: list[Replay]) -> list[dict[str, Any]]:
    """A row per trial: its point, and how far both are off."""
    from pmabench.store.analyses.results import POINT_QUANTITIES

    columns = [column_of("trial", "count", [float(one.trial.number) for one in replays])]
    for name, of in POINT_QUANTITIES.items():
        if name in SHOWN and any(name in one.trial.point for one in replays):
            columns.append(column_of(name, of, [one.trial.point.get(name) for one in replays]))
    quantity = "length" if replays[0].quantity == "displacement" else "force"
    for place, name in enumerate(("surface_rms", "straight_rms")):
        columns.append(column_of(name, quantity, [one.off[place] for one in replays]))
    return columns


def _samples(one: Replay) -> list[dict[str, Any]]:
    """Time, pressure, and what was measured and simulated."""
    quantity = "length" if one.quantity == "displacement" else "force"
    step = max(1, -(-len(one.t) // MOST_SAMPLES))
    columns = (
        ("time", "time", one.t - one.t[0]),
        ("pressure", "pressure", one.P),
        (f"{one.quantity}_measured", quantity, one.measured),
        ("of_surface", quantity, one.surface),
        ("of_straight_lines", quantity, one.straight),
    )
    return [column_of(name, unit, [float(value) for value in values[::step]]) for name, unit, values in columns]


def _in_all(replays: list[Replay]) -> list[str]:
    """Both errors over everything, and where the surface was used beyond its tests."""
    from pmabench.analysis.surface.replay import together

    surface, lines = together(replays)
    quantity = "length" if replays[0].quantity == "displacement" else "force"
    full = max(float(one.measured[one.counts].max()) for one in replays)
    lines_of = [
        f"rms over {len(replays)} trials, {replays[0].quantity}: surface {show(surface, quantity, 3)} "
        f"({100 * surface / full:.2g} % of {show(full, quantity, 3)}), straight form of the same tests "
        f"{show(lines, quantity, 3)} ({100 * lines / full:.2g} %)"
    ]
    if beyond := [str(one.trial.number) for one in replays if one.beyond]:
        lines_of.append(
            f"trial {', '.join(beyond)}: beyond the pressures or contractions that the surface was found from; "
            "it goes on there as straight lines"
        )
    return lines_of
