"""`pmabench campaign`: several protocols on one specimen, all checked before the first is run; `demo`: on the mock."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.quantities import in_words
from pmabench.cli.common import Ui, common, recorded_options, say, session_options
from pmabench.cli.names import CAMPAIGN, FOLDER, next_lines, short
from pmabench.cli.outcome import cut, outcome_json, show_next
from pmabench.files.shipped import find_file

if TYPE_CHECKING:
    from pmabench.engine.run import Outcome


@click.command(name="campaign")
@click.argument("file", type=CAMPAIGN)
@recorded_options
@click.option("--yes", is_flag=True, help="Every prompt counts as answered; the record says so.")
@click.option("--resume", is_flag=True, help="Leave out what is finished in --out, and go on with what is not.")
@session_options
@common
def command(
    ui: Ui, file: str, out: Path, operator: str, session: dict[str, Any], *, yes: bool, resume: bool
) -> int | None:
    """Run every protocol of the campaign FILE in order; the first run that does not finish ends it."""
    done: list[Path] = []
    outcomes = run_campaign(ui, file, out, done=done, operator_name=operator, yes=yes, resume=resume, session=session)
    data = {"schema": "pmabench.campaign-outcome/1", "runs": [outcome_json(outcome) for outcome in outcomes]}
    brief = [str(outcome.folder) for outcome in outcomes]
    again = ["pmabench", "campaign", shlex.quote(file), "--out", shlex.quote(str(out)), "--resume"]
    ui.result(data, lambda: click.echo("\n".join(_end(outcomes, done, again))), brief)
    return max((outcome.exit_code for outcome in outcomes), key=severity, default=0)


MOST_RUNS = 16
"""Runs that are listed at the end."""


def _end(outcomes: Sequence[Outcome], done: Sequence[Path], again: Sequence[str]) -> Iterator[str]:
    """At most 25 lines: how the campaign ended, its runs, what to type next; `again` goes on with what is left.

    `done` are the folders of runs that had come to their end before.
    """
    good = [outcome for outcome in outcomes if outcome.exit_code in {0, 6}]
    count, every = len(done) + len(good), len(done) + len(outcomes)
    word = "FINISHED" if len(good) == len(outcomes) else outcomes[-1].status.upper()
    seconds = sum(outcome.bench_seconds for outcome in outcomes)
    yield f"{word}  campaign: {count} of {every} runs came to their end, {in_words(seconds)}"
    for outcome in outcomes[-MOST_RUNS:]:
        place = short(outcome.folder) if outcome.folder is not None else "not recorded"
        yield cut(f"   {outcome.status:9} {place}  {outcome.why}".rstrip())
    if len(good) < len(outcomes):
        yield from next_lines(*again)
    elif folders := [short(one) for one in (*done, *(outcome.folder for outcome in good)) if one is not None]:
        yield from next_lines("pmabench", "process", *folders)


SEVERITY = (0, 6, 2, 129, 143, 130, 1, 4, 7, 5)
"""Exit codes from the harmless to the worst."""


def severity(code: int) -> int:
    """Rank of an exit code; unknown ones are the worst."""
    return SEVERITY.index(code) if code in SEVERITY else len(SEVERITY)


def run_campaign(
    ui: Ui, file: str, out: Path, *, seed: int | None = None, resume: bool = False, done: list[Path] | None = None,
    **how: Any,
) -> list[Outcome]:  # fmt: skip
    """Run the campaign `file`; `seed` replaces that of simulated devices; `resume` goes on with what `out` holds.

    Folders of runs that had come to their end before are added to `done`.

    `how`: operator_name, yes and session of `execute`; the options of the session are for the first run alone.
    """
    from pmabench.cli.prepare import seeded
    from pmabench.cli.run import execute
    from pmabench.cli.runs import ended_early
    from pmabench.kinds.compile import plan_campaign
    from pmabench.store.reader import open_run

    name, planned = plan_campaign(find_file("campaign", file))
    outcomes: list[Outcome] = []
    for number, run in enumerate(planned):
        mounted = run.mounted if seed is None else seeded(run.mounted, seed + number)
        title = f"{number + 1} of {len(planned)}: {run.plan.name} on {mounted.bench.name}"
        continues = None
        before = _before(out, name, number, run.plan.sha256) if resume else None
        if before is not None and not before[2]:
            say(f"{title}: {_of_another_plan(*before[:2])}")
        elif before is not None:
            folder, status, _ = before
            if status == "finished" or (status == "failed" and not ended_early(open_run(folder))):
                ui.note(f"{title}: {status} already, in {folder.name}")
                if done is not None:
                    done.append(folder)
                continue
            from pmabench.engine.resume import continue_run

            title += f", going on after {folder.name}"
            continues = continue_run(folder, run.plan, mounted, run.protocol_text)
        ui.note(title)
        about = {"campaign": {"name": name, "number": number, "of": len(planned)}}
        outcome = execute(ui, replace(run, mounted=mounted), out, continues=continues, about=about, **how)
        how["session"] = None
        outcomes.append(outcome)
        if outcome.exit_code not in {0, 6}:
            say(f"the campaign ends here: {outcome.status}: {outcome.why}")
            show_next(ui, outcome, mounted.bench, trials=False)
            break
    return outcomes


def _of_another_plan(folder: Path, status: str) -> str:
    """What becomes of a run that `--resume` cannot use: nothing is dropped without a word (R7)."""
    changed = "the campaign, a file that it names or pmabench has changed since"
    text = f"{folder.name} ({status}) is of another plan: {changed}"
    left = "" if status == "finished" else f"; what is left of it:  pmabench continue {short(folder)}"
    return f"{text}. It is not used, and all trials begin anew{left}"


def _before(out: Path, campaign: str, number: int, plan_sha256: str) -> tuple[Path, str, bool] | None:
    """The newest run of this place in the campaign, its status, and whether it has this plan.

    One of another plan only where `out` holds none of this one.
    """
    from pmabench.store.catalogue import catalogue
    from pmabench.store.folder import read_manifest

    found = []
    for row in sorted(catalogue(out), key=lambda row: row.date, reverse=True):
        manifest = {} if row.status == "damaged" else read_manifest(out / row.folder)
        place = manifest.get("campaign") or {}
        if (place.get("name"), place.get("number")) == (campaign, number):
            found.append((out / row.folder, row.status, manifest.get("plan_sha256") == plan_sha256))
    return max(found, key=lambda one: one[2], default=None)


@click.command(name="demo")
@click.option("--out", default="pmabench-demo", show_default=True, type=FOLDER)
@click.option("--seed", default=1, show_default=True, help="Seed of the simulated noise.")
@common
def demo(ui: Ui, out: Path, seed: int) -> int | None:
    """Characterise a simulated muscle: run four of the shipped protocols, fit, and write the report."""
    from pmabench.cli.process import print_analyses
    from pmabench.cli.report import characterise, characterised_lines

    started = time.monotonic()
    outcomes = run_campaign(ui, "demo", out / "runs", operator_name="demo", yes=True, seed=seed)
    worst = max((outcome.exit_code for outcome in outcomes), key=severity)
    if worst:
        say("\n".join(f"{outcome.folder}: {outcome.status}: {outcome.why}" for outcome in outcomes))
        return worst
    recorded = sum(outcome.rows for outcome in outcomes)
    recorded_in = [outcome.folder for outcome in outcomes if outcome.folder is not None]
    place = out / "analyses" / recorded_in[0].name
    title = "Characterisation of a simulated MAS-20-250"
    page = out / "report.html"
    found = characterise(recorded_in, place, page, title)
    elapsed = time.monotonic() - started
    data = {
        "schema": "pmabench.demo/1",
        "runs": [str(outcome.folder) for outcome in outcomes],
        "folders": [str(folder) for folder in found.folders],
        "report": str(page),
        "rows": recorded,
        "seconds": round(elapsed, 3),
        "analyses": [analysis.to_dict() for analysis in found.analyses],
    }

    def human() -> None:
        if ui.verbose:
            print_analyses(ui, found.analyses)
        click.echo("\n".join(characterised_lines(found, page)))
        seconds = sum(outcome.bench_seconds for outcome in outcomes)
        ui.note(f"{seconds / 60:.0f} min at the simulated bench, {recorded:,} rows, in {elapsed:.1f} s")
        click.echo("next    pmabench init our-lab    the same for a bench of your own")

    ui.result(data, human, [str(page)])
    return None
