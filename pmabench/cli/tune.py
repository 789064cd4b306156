"""`pmabench tune`: controller settings of every rule from an ultimate gain and period, ideal and parallel form."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from pmabench.analysis.results import Estimate
    from pmabench.analysis.tuning import Gains, Rule
    from pmabench.model.loop import Loop


@click.command(name="tune")
@click.option("--ku", help='Ultimate gain, for instance "7.1 bar/cm"; a bare number has no unit.')
@click.option("--tu", help='Ultimate period, for instance "9 s".')
@click.option("--analysis", type=click.Path(path_type=Path), help="Analysis folder of an ultimate-gain run.")
@click.option("--rule", help="One rule, for instance ziegler-nichols or PI; all if not given.")
@click.option("--dead-time", help="Dead time of the loop, to see whether the period is possible.")
@click.option("--lag", "lags", multiple=True, help="First-order lag of the loop; repeatable.")
@common
def command(
    ui: Ui,
    ku: str | None,
    tu: str | None,
    analysis: Path | None,
    rule: str | None,
    dead_time: str | None,
    lags: tuple[str, ...],
) -> int | None:
    """Gains of the tuning rules from K_u and T_u, or from an analysis."""
    from pmabench.analysis.tuning import RULES, facts, rules_named, tune
    from pmabench.base.errors import UsageError

    given = [value is not None for value in (ku, tu)]
    if any(given) if analysis is not None else not all(given):
        raise UsageError('give --ku and --tu, for instance --ku "7.1 bar/cm" --tu "9 s", or --analysis FOLDER')
    try:
        rules: tuple[Rule, ...] = RULES if rule is None else rules_named(rule)
    except ValueError as error:
        raise UsageError(str(error)) from error
    pairs = _measured(analysis) if analysis is not None else [(_gain(ui, ku or ""), _time(ui, tu or ""), None)]
    found: list[tuple[dict[str, float], tuple[Gains, ...]]] = []
    for gain, period, loop in pairs:
        try:
            found.append((dict(gain.at), tune(gain, period, rules, loop)))
        except ValueError as error:
            raise UsageError(str(error)) from error
    notes = _plausible(pairs[0][1], dead_time, lags)
    data = {
        "schema": "pmabench.tune/1",
        "settings": [fact for at, gains in found for fact in facts(gains, at)],
        "findings": notes,
    }

    def human() -> None:
        for at, gains in found:
            if at:
                click.echo("at " + ", ".join(f"{name} {value:g}" for name, value in at.items()))
            _print(ui, gains)
        for note in notes:
            click.echo(note)

    ui.result(data, human)
    return None


def _gain(ui: Ui, text: str) -> Estimate:
    from pmabench.analysis.results import Estimate

    value, bare = _quantity("--ku", text, "gain", 1e-30)
    if not bare:
        return Estimate("K_u", value, "Pa/m", "gain", "given")
    ui.note(
        f'--ku {text}: taken without a unit; K_p comes out in the same unknown unit (write "7.1 bar/cm" to know it)'
    )
    return Estimate("K_u", value, "1", "count", "given")


def _time(ui: Ui, text: str) -> Estimate:
    from pmabench.analysis.results import Estimate

    value, bare = _quantity("--tu", text, "time", 1e-6)
    if bare:
        ui.note(f"--tu {text}: taken as seconds")
    return Estimate("T_u", value, "s", "time", "given")


def _seconds(option: str, text: str) -> float:
    return _quantity(option, text, "time", 0.0)[0]


def _quantity(option: str, text: str, quantity: str, least: float) -> tuple[float, bool]:
    """The value [SI], and whether it was written without a unit."""
    from pmabench.base.errors import UsageError
    from pmabench.files.quantity import parse_quantity

    bare = True
    try:
        value = float(text)
    except ValueError:
        bare = False
        try:
            value = parse_quantity(text, quantity)
        except ValueError as error:
            raise UsageError(f"{option}: {error}") from error
    most = 1e6 if quantity == "time" else 1e30
    if not least <= value <= most:
        raise UsageError(
            f'{option}: "{text}" is no {quantity} that can be; expected is {least:g} to {most:g} in SI units'
        )
    return value, bare


def _measured(folder: Path) -> list[tuple[Estimate, Estimate, Loop | None]]:
    """Gain, period and the identified loop (where there is one) at each operating point."""
    from pmabench.base.errors import invalid
    from pmabench.model.loop import Loop
    from pmabench.report.analysis_folder import read_analysis

    analysis = read_analysis(folder)
    loops = {
        _point(fact["at"]): Loop(fact["gain"], fact["dead_time"], tuple(fact["lags"]))
        for fact in analysis.facts.get("loops", [])
        if all(isinstance(lag, int | float) for lag in fact["lags"])
    }
    known = [e for e in analysis.estimates if e.value is not None]
    periods = {(e.method, _point(e.at)): e for e in known if e.symbol == "T_u"}
    gains = [e for e in known if e.symbol == "K_u" and (e.method, _point(e.at)) in periods]
    first = {_point(e.at): e for e in reversed(gains)}  # of several ways the first one told
    found = [(e, periods[e.method, point], loops.get(point)) for point, e in sorted(first.items())]
    if not found:
        raise invalid(folder, "holds no ultimate gain and period")
    return found


def _point(at: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(at.items()))


def _plausible(period: Estimate, dead_time: str | None, lags: tuple[str, ...]) -> list[str]:
    from pmabench.base.errors import UsageError

    if dead_time is None and lags:
        raise UsageError("--lag is for --dead-time; give both, or neither")
    if dead_time is None or period.value is None:
        return []
    from pmabench.analysis.tuning import plausibility
    from pmabench.model.loop import Loop

    loop = Loop(1.0, _seconds("--dead-time", dead_time), tuple(_seconds("--lag", lag) for lag in lags))
    try:
        finding = plausibility(period.value, loop)
    except ValueError as error:
        raise UsageError(f"--dead-time {dead_time} with --lag {', '.join(lags) or 'none'}: {error}") from error
    return [f"{finding.level}: {finding.text}"]


def _print(ui: Ui, gains: tuple[Gains, ...]) -> None:
    from pmabench.base.quantities import QUANTITIES
    from pmabench.report.terminal import print_grid

    def cell(estimate: Any) -> str:
        if estimate is None or estimate.value is None:
            return ""
        quantity = QUANTITIES.get(estimate.quantity)
        if quantity is None or estimate.unit == "1" or quantity.unit != estimate.unit:
            return f"{estimate.value:.4g} {estimate.unit if estimate.unit != '1' else ''}".strip()
        return quantity.show(estimate.value, 4)

    known = any(row.margins is not None for row in gains)
    heads = ["rule", "K_p", "T_i", "T_d", "K_i", "K_d"]
    heads += ["M_s", "gain margin", "phase margin", "overshoot"] if known else []
    rows = []
    for row in gains:
        cells = [cell(e) for e in (row.K_p, row.T_i, row.T_d, row.K_i, row.K_d)]
        if known and row.margins is None:
            cells += [""] * 4
        elif row.margins is not None:
            cells += [f"{row.margins.M_s:.2f}", f"{row.margins.gain_margin:.2f}"]
            cells.append(QUANTITIES["angle"].show(row.margins.phase_margin, 3))
            cells.append("" if row.overshoot is None else f"{100 * row.overshoot:.0f} %")
        rows.append([row.rule.title, *cells])
    print_grid(ui.console(), heads, rows, ("rule",))
