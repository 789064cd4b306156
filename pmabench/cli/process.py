"""`pmabench process`: runs to coefficients, in an analysis folder; never touches a run.

Of a folder of runs each on its own, by several processes, with progress and one table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.text import clean
from pmabench.cli.common import Ui, common
from pmabench.cli.names import FOLDER, RunFolder, next_lines, short
from pmabench.cli.sources import (
    campaign_folder,
    chains,
    holds_analyses,
    load_runs,
    place_of,
    since_lines,
    without_analyses,
)
from pmabench.kinds import registry
from pmabench.store.catalogue import ANALYSES, holds_runs, tasks_below

if TYPE_CHECKING:
    from pmabench.analysis.many import Pool
    from pmabench.report.foremost import Verdict
    from pmabench.report.many import Many
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.records import RunData


MOST_RUNS = 6
"""Runs that the next command names."""
MOST_SINCE = 2
"""Lines about what came to runs after they were closed; with -v all."""


@click.command(name="process")
@click.argument("runs", nargs=-1, required=True, type=RunFolder(), metavar="RUN...|FOLDER...")
@click.option(
    "--out",
    type=FOLDER,
    help="Analysis folder.  [default: in analyses/ next to runs/, or in a folder of runs of another name]",
)
@click.option("--each", is_flag=True, help="Each run on its own and one table, as for a folder of runs.")
@click.option("--jobs", type=click.IntRange(1, 256), metavar="N", help="So many processes share a folder of runs.")
@click.option("--cluster", metavar="ADDRESS", help="A Dask scheduler whose workers share a folder of runs.")
@click.option(
    "--form", metavar="FORM", help="`surface`: all slow tests together as one muscle with hysteresis and creep."
)
@click.option("--regulator", is_flag=True, help="Contraction runs: dead time and lags from command to pressure.")
@click.option("--fresh", is_flag=True, help="A folder of runs: compute also what has not changed.")
@common
def command(
    ui: Ui,
    runs: tuple[Path, ...],
    out: Path | None,
    each: bool,
    jobs: int | None,
    cluster: str | None,
    form: str | None,
    fresh: bool,
    **options: Any,
) -> int | None:
    """Fit the coefficients of RUNS, each with its 95 % interval.

    RUNS named one by one are taken together: one analysis for each kind of test of each specimen.

    Of a FOLDER of runs each run is taken on its own, with those that it continues: an analysis folder for each in
    analyses/each, and one table over all of them next to those (all-runs.csv, .json). Runs that have not
    changed since the last time are not computed again. A run that cannot be used is named at the end; the others go on.
    """
    if form is not None:
        from pmabench.kinds.reduce import FORM

        if form not in (forms := registry.with_part(FORM)):
            raise UsageError(f"there is no form {form[:40]!r}{did_you_mean(form, forms)}")
        if any(options.values()) or each or any(holds_runs(path) for path in runs):
            what = f"--form {form} takes all runs that are named into one muscle, and no other option"
            raise UsageError(f"{what}: name run folders, for instance with /*")
        return _process_together(ui, runs, out, {}, form)
    asked = registry.options_for(options)
    below = [path for path in runs if holds_runs(path)]
    if each or below:
        if jobs is not None and cluster is not None:
            raise UsageError("--jobs is for this machine and --cluster for others: give one of the two")
        start = runs[0].resolve()
        place = out or campaign_folder(start if runs[0] in below else start.parent) / ANALYSES / "each"
        wanted = [path for path in runs if path in below or not holds_analyses(path)]
        return process_folders(ui, wanted, place, jobs or 1, cluster, asked, fresh=fresh)
    if jobs is not None or cluster is not None:
        what = "--jobs and --cluster share out runs that are processed each on its own"
        raise UsageError(f"{what}: give their folder, or --each; runs named one by one make one fit together")
    return _process_together(ui, runs, out, asked)


@dataclass(frozen=True)
class Processed:
    """What came of runs that were processed together."""

    given: Sequence[Path]
    """Run folders, as they were named."""
    runs: list[RunData]
    analyses: list[Analysis]
    folders: list[Path]
    """Of the analyses."""
    failed: list[str]
    """Why results are not accepted."""

    @cached_property
    def verdict(self) -> Verdict:
        """As the first page of the report has it."""
        from pmabench.report.foremost import verdict_of

        return verdict_of(self.analyses, self.runs, self.failed, accepted=bool(self._limits))

    @property
    def _limits(self) -> list[str]:
        from pmabench.analysis.verdict.acceptance import limits_of

        return list(dict.fromkeys(limit.short for run in self.runs for limit in limits_of(run)))

    @property
    def refusals(self) -> list[str]:
        """A line for each reason why results are not accepted."""
        return [clean(f"NOT ACCEPTED: {text}") for text in self.failed]

    def glance(self) -> list[str]:
        """The results at a glance."""
        from pmabench.report.foremost import glance

        return glance(self.analyses, self.verdict, self.failed)

    def verdict_lines(self) -> list[str]:
        """The verdict, then each reason why results are not accepted."""
        kept = f" ({', '.join(self._limits)})" if self._limits and not self.failed else ""
        return [clean(f"{self.verdict.word}{kept}: {self.verdict.text}"), *self.refusals]

    def described_by(self) -> list[str]:
        """The command that describes a muscle which does not follow the form of its test; empty where it does."""
        from pmabench.kinds.reduce import FORM

        facts = [analysis.facts.get("form") for analysis in self.analyses]
        withheld = any(isinstance(fact, Mapping) and fact.get("state") == "withheld" for fact in facts)
        if not (self.failed and withheld) or len(self.given) > MOST_RUNS:
            return []
        return ["pmabench", "process", *map(short, self.given), "--form", next(iter(registry.with_part(FORM)))]


def processed(
    given: Sequence[Path], out: Path | None, asked: Mapping[str, Any] | None = None, form: str = ""
) -> Processed:
    """Process runs together into `out`, else next to them; `asked` are options by kind of test.

    An analysis for each kind of test of each specimen; with a `form` of all tests one for each specimen, in a folder
    next to those of the tests.
    """
    from pmabench.kinds.reduce import reduce_runs, reduce_together, verdicts
    from pmabench.store.analyses.folder import key_of

    asked = asked or {}
    key = "" if form else key_of(chains(given), asked)  # before the runs are read: what is added meanwhile is a change
    runs = load_runs(given)
    if asked and not any(run.kind in asked for run in runs):
        raise UsageError(f"--regulator is for runs of kind {', '.join(asked)}; none of these is one")
    analyses = reduce_together(form, runs) if form else reduce_runs(runs, asked)
    if out is None:
        out = place_of(given[0])
        out = out.with_name(f"{out.name}-{form}") if form else out
    return Processed(given, runs, analyses, write(analyses, runs, out, key, asked), verdicts(runs, analyses))


def _process_together(
    ui: Ui, runs: Sequence[Path], out: Path | None, asked: Mapping[str, Mapping[str, object]], form: str = ""
) -> int | None:
    """Process runs as `processed` does, and show what came of them; the exit code."""
    ui.begin(f"processing {len(runs)} {'run' if len(runs) == 1 else 'runs'}")
    from pmabench.report.many import added_to

    given = without_analyses(ui, runs)
    found = processed(given, out, asked, form)
    folders = [str(path) for path in found.folders]
    added = added_to(found.runs)
    data: dict[str, Any] = {
        "schema": "pmabench.process/1",
        "folders": folders,
        "analyses": [analysis.to_dict() for analysis in found.analyses] if ui.json else [],
        "verdicts": found.failed,
        **added,
    }

    def human() -> None:
        left_out = "{run}: trial {trial} is left out by {operator}: {because}"
        since = [*since_lines(found.runs), *(clean(left_out.format(**entry)) for entry in added["excluded"])]
        if ui.verbose:
            print_analyses(ui, found.analyses)
            click.echo("\n".join([*since, *folders, *found.verdict_lines()]))
            return
        place = short(found.folders[0].parent)
        then = found.described_by() or ["pmabench", "report", place, "-o", "report.html"]
        more = [f"{len(since) - MOST_SINCE} more: -v"] if len(since) > MOST_SINCE else []
        lines = [*found.glance(), *since[:MOST_SINCE], *more]
        click.echo("\n".join([*lines, f"analysis  {place}", *next_lines(*then, indent=10)]))

    ui.result(data, human, [*found.refusals, *folders])
    return 6 if found.failed else None


def write(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    folder: Path,
    key: str = "",
    options: Mapping[str, Any] | None = None,
) -> list[Path]:
    """An analysis folder for each analysis below `folder`; kinds that come twice are numbered.

    With the `key` of runs and `options` they are used again as long as it is the same.
    """
    from pmabench.report.files.csv_files import write_with_tables
    from pmabench.store.analyses.folder import file_names, keep

    named = zip(analyses, file_names([analysis.kind for analysis in analyses]), strict=True)
    written = [write_with_tables(analysis, folder / name) for analysis, name in named]
    keep(folder, key, [Path(run.path) for run in runs], options or {}, written)
    return written


def print_analyses(ui: Ui, analyses: Sequence[Analysis]) -> None:
    """The coefficient table, what was left out, and the findings."""
    from pmabench.plotting.wording import printed
    from pmabench.report.foremost import print_coefficients

    console = ui.console()
    print_coefficients(analyses, console)
    for analysis in analyses:
        if analysis.dropped:
            count = len(analysis.dropped)
            trials = f"{count} trial{'s'[: count > 1]} not used"
            console.print(f"{analysis.kind}: {trials}; the report lists each with its reason")
        for finding in analysis.findings:
            text = clean(f"{finding.level}: {printed(finding.text)}").replace(" ± ", "\u00a0±\u00a0")
            kept = fill(text, console.width, break_long_words=False, break_on_hyphens=False)
            console.print(kept.replace("\u00a0±\u00a0", " ± "), soft_wrap=True)  # a value stays with its half width


MOST_LINES = 20
"""Lines of one kind on the screen; the rest is in the table."""


def process_folders(
    ui: Ui, given: Sequence[Path], out: Path, jobs: int, cluster: str | None, options: Mapping[str, Any], *, fresh: bool
) -> int | None:
    """Process each run below `given` on its own, with options by kind; the exit code."""
    from pmabench.cli.outcome import bar_line
    from pmabench.report.many import process_many, write_table

    tasks = tasks_below(given)
    with _pool(jobs, cluster) as pool, bar_line(ui, "runs") as show:

        def progress(done: int, total: int, unchanged: int) -> None:
            show((done - unchanged) / max(total - unchanged, 1), f"{done:,} of {total:,}")

        many = process_many(tasks, out, pool, progress, options, fresh=fresh)
    paths = write_table(many)
    ui.result(_data(many, paths), lambda: _human(many, paths), _failures(many) + [str(path) for path in paths])
    return many.exit_code or None


def _pool(jobs: int, cluster: str | None) -> AbstractContextManager[Pool | None]:
    """Who does the work; None is this process."""
    from pmabench.analysis.many import Cluster, Processes

    if cluster is not None:
        return closing(Cluster(cluster))
    return closing(Processes(jobs)) if jobs > 1 else nullcontext()


def _data(many: Many, paths: Sequence[Path]) -> dict[str, Any]:
    from pmabench.report.many import SCHEMA, plain_entry

    return {
        "schema": SCHEMA,
        "out": str(many.out),
        "table": [str(path) for path in paths],
        "computed": many.count("computed"),
        "unchanged": many.count("unchanged"),
        "runs": [plain_entry(entry) for entry in many.results()],
        "skipped": [{"run": entry["path"], "because": entry["skipped"]} for entry in many.of("skipped")],
        "failed": [{"run": e["path"], "error": e["error"], "exit_code": e["exit_code"]} for e in many.of("failed")],
    }


def _human(many: Many, paths: Sequence[Path]) -> None:
    kinds = Counter(entry["kind"] for entry in many.results())
    for kind, count in sorted(kinds.items()):
        click.echo(f"{kind}: {count:,} {'run' if count == 1 else 'runs'}")
    if many.count("unchanged"):
        click.echo(f"{many.count('unchanged'):,} had not changed and were not computed again")
    if many.count("skipped"):
        click.echo(f"{many.count('skipped'):,} without trials (sessions, calibrations) were left out")
    since = [
        f"{run}: {len(additions['added'])} added and {len(additions['late'])} late files since it was closed, not used"
        for entry in many.results()
        for run, additions in entry["since"].items()
    ]
    click.echo("\n".join([*_first(since, "that something was added to; the table names them"), *map(str, paths)]))
    refused = sum(bool(entry["verdicts"]) for entry in many.results())
    done = many.count("computed", "unchanged")
    click.echo(
        f"Not accepted: {refused:,} of {done:,} runs" if refused else f"None of {done:,} runs is refused acceptance"
    )
    click.echo("".join(f"{line}\n" for line in _failures(many)), nl=False)


def _failures(many: Many) -> list[str]:
    """A line for each run that is not accepted or could not be processed."""
    refused = [f"NOT ACCEPTED: {entry['run']}: {verdict}" for entry in many.results() for verdict in entry["verdicts"]]
    failed = [entry["error"] for entry in many.of("failed")]
    lines = _first(refused, "not accepted; the table names them")
    if failed:
        what = "1 run could" if len(failed) == 1 else f"{len(failed):,} runs could"
        lines += [f"{what} not be processed:", *failed]
    return [clean(line) for line in lines]


def _first(lines: list[str], rest: str) -> list[str]:
    more = len(lines) - MOST_LINES
    return [*lines[:MOST_LINES], f"and {more:,} more {rest}"] if more > 0 else lines
