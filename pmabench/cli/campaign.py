"""`pmabench campaign`: several protocols on one specimen, all checked before the first is run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.cli.common import Ui, common, say

if TYPE_CHECKING:
    from pmabench.engine.run import Outcome


@click.command(name="campaign")
@click.argument("file")
@click.option("--out", default="runs", show_default=True, type=click.Path(path_type=Path), help="Where run folders go.")
@click.option("--operator", default="", help="Who is at the bench; the login name if not given.")
@click.option("--yes", is_flag=True, help="Every prompt counts as answered; the record says so.")
@common
def command(ui: Ui, file: str, out: Path, operator: str, *, yes: bool) -> int | None:
    """Run every protocol of the campaign FILE in order; the first run that does not finish ends it."""
    from pmabench.cli.run import outcome_json
    from pmabench.files.shipped import find_file

    outcomes = run_campaign(ui, find_file("campaign", file), out, operator_name=operator, yes=yes)
    data = {"schema": "pmabench.campaign-outcome/1", "runs": [outcome_json(outcome) for outcome in outcomes]}
    ui.result(data, lambda: click.echo("\n".join(str(outcome.folder) for outcome in outcomes)))
    return max((outcome.exit_code for outcome in outcomes), key=severity)


SEVERITY = (0, 6, 2, 129, 143, 130, 1, 4, 7, 5)
"""Exit codes from the harmless to the worst."""


def severity(code: int) -> int:
    """Rank of an exit code; unknown ones are the worst."""
    return SEVERITY.index(code) if code in SEVERITY else len(SEVERITY)


def run_campaign(
    ui: Ui, file: Path, out: Path, *, operator_name: str = "", yes: bool = False, seed: int | None = None
) -> list[Outcome]:
    """Run the campaign; `seed` replaces that of simulated devices."""
    from pmabench.cli.prepare import Prepared, seeded
    from pmabench.cli.run import execute
    from pmabench.protocol.campaign import plan_campaign

    _, planned = plan_campaign(file)
    outcomes: list[Outcome] = []
    for number, run in enumerate(planned):
        mounted = run.mounted if seed is None else seeded(run.mounted, seed + number)
        ui.note(f"{number + 1} of {len(planned)}: {run.plan.name} on {mounted.bench.name}")
        prepared = Prepared(run.plan, mounted, run.protocol_text, run.deviations)
        outcome = execute(ui, prepared, out, operator_name=operator_name, yes=yes)
        outcomes.append(outcome)
        if outcome.exit_code not in {0, 6}:
            say(f"the campaign ends here: {outcome.status}: {outcome.why}")
            break
    return outcomes
