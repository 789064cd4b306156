"""`pmabench tune`: controller settings of every rule, ideal and parallel form.

From an ultimate gain and period, from an analysis, from open-loop steps, or from the fitted muscle and regulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, invalid
from pmabench.base.kind import Kind, load
from pmabench.base.quantities import QUANTITIES, show
from pmabench.cli.common import Ui, common, read_quantity
from pmabench.cli.names import PATH, RunFolder
from pmabench.cli.sources import load_runs, without_analyses
from pmabench.kinds import registry
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.analysis.tuning import Gains
    from pmabench.model.loop import Loop
    from pmabench.model.rules import Rule
    from pmabench.store.analyses.results import Analysis, Estimate


@click.command(name="tune")
@click.argument("runs", nargs=-1, type=RunFolder())
@click.option("--steps", is_flag=True, help="From open-loop steps in RUNS of kind ultimate-gain.")
@click.option("--model", is_flag=True, help="From the muscle and regulator fitted to RUNS of contraction-relaxation.")
@click.option("--ku", help='Ultimate gain, for instance "7.1 bar/cm"; a bare number has no unit.')
@click.option("--tu", help='Ultimate period, for instance "9 s".')
@click.option(
    "--analysis",
    type=PATH,
    help="Analysis folder of kind ultimate-gain, or of contraction-relaxation (processed with --regulator).",
)
@click.option(
    "--setpoint", "setpoints", multiple=True, help="By model: where, for instance 20 mm; repeatable. All rests if none."
)
@click.option("--load", help="By model: what pulls there, 6 kg (its mass counts) or 58.9 N; nothing if not given.")
@click.option("--period", help="By model: sample period of the loop, of which half is dead time; that of the runs.")
@click.option("--rule", help="One rule, for instance ziegler-nichols or PI; all if not given.")
@click.option("--dead-time", help="Dead time of the loop, to see whether the period is possible.")
@click.option("--lag", "lags", multiple=True, help="First-order lag of the loop; repeatable.")
@common
def command(
    ui: Ui,
    runs: tuple[Path, ...],
    steps: bool,
    model: bool,
    ku: str | None,
    tu: str | None,
    analysis: Path | None,
    rule: str | None,
    dead_time: str | None,
    lags: tuple[str, ...],
    **place: Any,
) -> int | None:
    """Gains of the tuning rules from K_u and T_u, from an analysis, or from RUNS in which no loop was closed."""
    from pmabench.analysis.tuning import facts, rules_named
    from pmabench.model.rules import all_rules

    _check_one_source(runs, [ku is not None, tu is not None], analysis, steps=steps, model=model)
    where = Where.read(**place)
    if any(place.values()) and not model and (analysis is None or not holds_model(analysis)):
        raise UsageError("--setpoint, --load and --period are for --model, or an analysis that holds a model")
    try:
        rules = all_rules() if rule is None else rules_named(rule)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if analysis is not None or runs:
        pairs, notes = _measured_pairs(ui, runs, analysis, where, steps=steps)
    else:
        pairs, notes = [(_gain(ui, ku or ""), _time(ui, tu or ""), None)], []
    if dead_time is not None or lags:
        pairs, said = _with_loop(pairs, dead_time, lags)
        notes += said
    found = _tuned(pairs, rules)
    data = {
        "schema": "pmabench.tune/1",
        "ultimate": [estimate.to_dict() for gain, period, _ in found for estimate in (gain, period)],
        "settings": [fact for gain, _, gains in found for fact in facts(gains, gain.at)],
        "findings": notes,
    }

    def human() -> None:
        for gain, period, gains in found:
            if gain.at:
                click.echo(_ultimate_text(gain, period))
            _print(ui, gains)
        for note in notes:
            click.echo(note)

    ui.result(data, human)
    return None if found else 6


def _check_one_source(
    runs: tuple[Path, ...], given: list[bool], analysis: Path | None, *, steps: bool, model: bool
) -> None:
    """Raise UsageError unless there is one source of K_u and T_u; `given`: whether --ku and --tu are."""
    from_runs = steps or model
    if (steps and model) or from_runs != bool(runs) or (from_runs and (any(given) or analysis is not None)):
        way = "--model" if model and not steps else "--steps"
        raise UsageError(f"{way} takes runs and nothing else: pmabench tune {way} RUN...")
    if not from_runs and (any(given) if analysis is not None else not all(given)):
        raise UsageError(
            'give --ku and --tu, for instance --ku "7.1 bar/cm" --tu "9 s", or --analysis FOLDER, or --steps RUN..., '
            "or --model RUN..."
        )


def _measured_pairs(
    ui: Ui, runs: tuple[Path, ...], analysis: Path | None, where: Where, *, steps: bool
) -> tuple[Pairs, list[str]]:
    """K_u, T_u and the loop where it is known, from runs or else from an analysis, with what was found on the way."""
    from pmabench.analysis.tuning import measured_loops
    from pmabench.store.analyses.folder import read_analysis

    if analysis is None:
        reduced = _reduced(ui, runs) if steps else by_runs(ui, runs, where)
    elif holds_model(analysis):
        reduced = _found(analysis, read_analysis(analysis), where, where.period or 0.0)  # without it no hold is counted
    elif pairs := measured_loops(read_analysis(analysis)):
        return pairs, []
    else:
        raise invalid(analysis, "holds no ultimate gain and period")
    return measured_loops(reduced), [f"{finding.level}: {finding.text}" for finding in reduced.findings]


def _tuned(pairs: Pairs, rules: tuple[Rule, ...]) -> list[tuple[Estimate, Estimate, tuple[Gains, ...]]]:
    """Each K_u and T_u with its gains by rule. Raises UsageError."""
    from pmabench.analysis.tuning import tune

    try:
        found = [(gain, time, tune(gain, time, rules, loop)) for gain, time, loop in pairs]
    except ValueError as error:
        raise UsageError(str(error)) from error
    if found and not any(gains for _, _, gains in found):
        ways = "give --dead-time and --lag, --steps RUN... or --analysis FOLDER"
        raise UsageError(f"{rules[0].name} needs the loop itself: {ways}")
    return found


def _reduced(ui: Ui, runs: tuple[Path, ...]) -> Analysis:
    """What the open-loop steps of runs give; other ways to K_u in them are in the findings."""
    loaded = load_runs(without_analyses(ui, runs))
    able = registry.with_part("tune by steps")
    for run in loaded:
        if run.kind not in able:
            also = "; for this kind there is --model" if run.kind in models() else ""
            kinds = ", ".join(able)
            raise invalid(run.path, f'is a run of kind "{run.kind}"; --steps takes kind {kinds} with "open_loop"{also}')
    if len({run.kind for run in loaded}) > 1:
        raise invalid(runs[0], "the runs are of several kinds of test; give those of one")
    reduced: Analysis = load(able[loaded[0].kind].parts["tune by steps"])(loaded)
    if not reduced.estimates:
        raise invalid(runs[0], 'holds no open-loop steps; run a protocol with "open_loop", as ultimate-gain-open-loop')
    return reduced


def _ultimate_text(gain: Estimate, period: Estimate) -> str:
    """Operating point, K_u and T_u with their intervals, and where they come from."""
    from pmabench.store.analyses.results import POINT_QUANTITIES

    where = ", ".join(f"{name} {show(gain.at[name], of)}" for name, of in POINT_QUANTITIES.items() if name in gain.at)
    values = []
    for estimate in (gain, period):
        half = estimate.parts.combined
        width = "" if half is None else f" +- {show(half, estimate.quantity, 2)}"
        values.append(f"{estimate.symbol} = {show(estimate.value or 0.0, estimate.quantity, 4)}{width}")
    return f"at {where}: {', '.join(values)} ({gain.method})"


def _gain(ui: Ui, text: str) -> Estimate:
    from pmabench.store.analyses.results import Estimate

    value, bare = _quantity("--ku", text, "gain", 1e-30)
    if not bare:
        return Estimate("K_u", value, "Pa/m", "gain", "given")
    why = 'K_p comes out in the same unknown unit (write "7.1 bar/cm" to know it)'
    ui.note(f"--ku {text}: taken without a unit; {why}")
    return Estimate("K_u", value, "1", "count", "given")


def _time(ui: Ui, text: str) -> Estimate:
    from pmabench.store.analyses.results import Estimate

    value, bare = _quantity("--tu", text, "time", 1e-6)
    if bare:
        ui.note(f"--tu {text}: taken as seconds")
    return Estimate("T_u", value, "s", "time", "given")


def _quantity(option: str, text: str, quantity: str, least: float) -> tuple[float, bool]:
    """The value [SI], and whether it was written without a unit."""
    try:
        value, bare = float(text), True
    except ValueError:
        value, bare = read_quantity(option, text, quantity), False
    return _within(option, text, quantity, value, least, 1e6 if quantity == "time" else 1e30), bare


def _within(option: str, text: str, quantity: str, value: float, least: float, most: float) -> float:
    """The value, which must lie between both [SI]."""
    if not least <= value <= most:
        expected = f"expected is {least:g} to {most:g} in SI units"
        raise UsageError(f'{option}: "{text}" is no {quantity} that can be; {expected}')
    return value


Pairs = list[tuple["Estimate", "Estimate", "Loop | None"]]
"""Gain, period and the identified loop (where there is one) at each operating point."""


def _with_loop(pairs: Pairs, dead_time: str | None, lags: tuple[str, ...]) -> tuple[Pairs, list[str]]:
    """The pairs, each with the loop of the given dead time and lags where its period fits, and a sentence on each."""
    from pmabench.analysis.tuning import loop_of

    if dead_time is None:
        raise UsageError("--lag is for --dead-time; give both, or neither")
    dead = _quantity("--dead-time", dead_time, "time", 0.0)[0]
    rest = [_quantity("--lag", lag, "time", 0.0)[0] for lag in lags]
    found, notes = [], []
    for gain, period, known in pairs:
        try:
            scaled, finding = loop_of(gain.value or 1.0, period.value or 0.0, dead, rest)
        except ValueError as error:
            raise UsageError(f"--dead-time {dead_time} with --lag {', '.join(lags) or 'none'}: {error}") from error
        notes.append(f"{finding.level}: {finding.text}")
        found.append((gain, period, known or (scaled if gain.value else None)))
    return found, notes


def _print(ui: Ui, gains: tuple[Gains, ...]) -> None:
    def cell(estimate: Any) -> str:
        if estimate is None or estimate.value is None:
            return ""
        quantity = QUANTITIES.get(estimate.quantity)
        if quantity is None or estimate.unit == "1" or quantity.unit != estimate.unit:
            return f"{estimate.value:.4g} {estimate.unit if estimate.unit != '1' else ''}".strip()
        return quantity.show(estimate.value, 4)

    heads = ["rule", "K_p", "T_i", "T_d", "K_i", "K_d"]
    if any(row.margins is not None for row in gains):
        heads += ["M_s", "gain margin", "phase margin"]
    rows = []
    for row in gains:
        cells = [cell(e) for e in (row.K_p, row.T_i, row.T_d, row.K_i, row.K_d)]
        if row.margins is not None:
            cells += [f"{row.margins.M_s:.2f}" if row.margins.stable else "unstable", f"{row.margins.gain_margin:.2f}"]
            cells.append(QUANTITIES["angle"].show(row.margins.phase_margin, 3))
        rows.append([row.rule.title, *cells, *[""] * (len(heads) - 1 - len(cells))])
    print_grid(ui.console(), heads, rows, ("rule",))


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

    @classmethod
    def read(cls, setpoints: Sequence[str], load: str | None, period: str | None) -> Where:
        """From what was typed; UsageError for what cannot be."""
        from pmabench.files.quantity import parse_mass_or_force

        def quantity(option: str, text: str, kind: str, most: float) -> float:
            return _within(option, text, kind, read_quantity(option, text, kind), 0.0, most)

        places = tuple(quantity("--setpoint", text, "length", LONGEST) for text in setpoints)
        try:
            hung, value = ("force", 0.0) if load is None else parse_mass_or_force(load)
        except ValueError as error:
            raise UsageError(f"--load: {error}") from error
        force, mass = (value * G, value) if hung == "mass" else (value, 0.0)
        if not 0 <= force <= MOST:
            raise UsageError(f'--load: "{load}" is no load of a muscle; expected is 0 to {MOST:g} N')
        step = None if period is None else quantity("--period", period, "time", SLOWEST)
        return cls(places, force, mass, step)


def holds_model(folder: Path) -> bool:
    """Whether a folder is an analysis whose coefficients make a loop."""
    from pmabench.store.analyses.folder import read_analysis

    return read_analysis(folder).kind in models()


def models() -> dict[str, Kind]:
    """The kinds of test whose coefficients make a loop."""
    return registry.with_results(*LOOP)


def by_runs(ui: Ui, runs: Sequence[Path], where: Where) -> Analysis:
    """K_u and T_u by the model that is fitted to runs; they must be of one specimen."""
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
    make = load(next(iter(registry.with_part(PART).values())).parts[PART])
    try:
        made: Analysis = make(analysis, where.setpoints, where.load, where.mass, period)
    except ValueError as error:
        raise invalid(path, str(error)) from error
    return made
