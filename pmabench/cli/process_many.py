"""`pmabench process` of folders of runs: each run on its own, by several processes, with progress and one table."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from pmabench.analysis.many import Cluster, Pool, Processes
from pmabench.cli.common import Ui
from pmabench.plotting.wording import clean
from pmabench.report.many import SCHEMA, Many, plain_entry, process_many, write_table
from pmabench.store.catalogue import tasks_below

LINE_EVERY = 10.0
"""Seconds between lines of progress where there is no terminal."""
MOST_LINES = 20
"""Lines of one kind on the screen; the rest is in the table."""


def process_folders(
    ui: Ui, given: Sequence[Path], out: Path, jobs: int, cluster: str | None, options: Mapping[str, Any], *, fresh: bool
) -> int | None:
    """Process each run below `given` on its own, with options by kind; the exit code."""
    tasks = tasks_below(given)
    with _pool(ui, jobs, cluster) as pool, _progress(ui) as progress:
        many = process_many(tasks, out, pool, progress, options, fresh=fresh)
    paths = write_table(many)
    ui.result(_data(many, paths), lambda: _human(many, paths), _failures(many) + [str(path) for path in paths])
    return many.exit_code or None


@contextmanager
def _pool(ui: Ui, jobs: int, cluster: str | None) -> Iterator[Pool | None]:
    """Who does the work; None is this process."""
    pool: Pool | None = None
    if cluster is not None:
        pool = Cluster(cluster)
        for doubt in pool.doubts():
            ui.note(doubt)
    elif jobs > 1:
        pool = Processes(jobs)
    try:
        yield pool
    finally:
        if pool is not None:
            pool.close()


@contextmanager
def _progress(ui: Ui) -> Iterator[Callable[[int, int, int], None] | None]:
    """A bar with the time left on a terminal, a line now and then elsewhere; both on stderr."""
    if ui.quiet or ui.json:
        yield None
        return
    began = last = time.monotonic()
    if not sys.stderr.isatty():

        def line(done: int, total: int, unchanged: int) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last >= LINE_EVERY:
                last = now
                left = (now - began) * (total - done) / max(done - unchanged, 1)
                length = f"{left:.0f} s" if left < 100 else f"{left / 60:.0f} min"
                ui.note(f"{done:,} of {total:,} runs, {length} left")

        yield line
        return

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("left"))
    with Progress(*columns, console=ui.console(err=True), transient=True) as bar:
        task = bar.add_task("runs", total=None)

        def show(done: int, total: int, unchanged: int) -> None:
            bar.update(task, total=total - unchanged, completed=done - unchanged)

        yield show


def _data(many: Many, paths: Sequence[Path]) -> dict[str, Any]:
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
