"""`pmabench import`: old files of other programs become runs, by a map; `--guess` proposes the map and makes no run.

Doubts are reported, nothing is mended.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import UsageError
from pmabench.base.text import printable
from pmabench.cli.common import Ui, common, fields, no_overwriting
from pmabench.cli.names import FOLDER, PATH
from pmabench.files.shipped import find_file

if TYPE_CHECKING:
    from pmabench.store.importers.guess.columns import Guess


@click.command(name="import")
@click.argument("files", nargs=-1, required=True, type=PATH, metavar="FILE...")
@click.option("--map", "map_name", help="Map file, or the name of a shipped one.")
@click.option("--guess", "guessing", is_flag=True, help="Propose a map with its reasons, and import nothing.")
@click.option("-o", "--output", type=PATH, help="With --guess: where the map is written.")
@click.option(
    "--set",
    "answers",
    multiple=True,
    metavar="KEY=VALUE",
    help="Answer a question (??) of the map, or change any key of it for this call.",
)
@click.option(
    "--unresolved",
    is_flag=True,
    help="Take what the map proposes where its questions are not answered; no result is accepted then.",
)
@click.option("--out", default="runs", show_default=True, type=FOLDER, help="Where run folders go.")
@common
def command(
    ui: Ui,
    files: tuple[Path, ...],
    map_name: str | None,
    guessing: bool,
    output: Path | None,
    answers: tuple[str, ...],
    out: Path,
    *,
    unresolved: bool,
) -> None:
    """Make one run of each FILE, as the map says; the files themselves are never touched."""
    if guessing == (map_name is not None) or (not guessing and output) or (guessing and answers):
        raise UsageError("give --map to import, or --guess (with -o) to have a map proposed")
    ui.begin(f"reading {len(files)} {'file' if len(files) == 1 else 'files'}")
    if guessing or map_name is None:
        guess(ui, files, output)
        return
    from pmabench.kinds.registry import importable
    from pmabench.store.importers.importing import import_files

    if any("=" not in text for text in answers):
        raise UsageError("--set needs KEY=VALUE, for instance --set columns.F.unit=N")
    pairs = [(key, value) for key, _, value in (text.partition("=") for text in answers)]
    runs = import_files(files, find_file("map", map_name), out, importable(), pairs, unresolved=unresolved)
    asked = list(dict.fromkeys(question for run in runs for question in run.unresolved))
    data = {
        "schema": "pmabench.import/1",
        "runs": [
            {"run": str(run.path), "source": str(run.source), "findings": [vars(finding) for finding in run.findings]}
            | fields(run, "id", "kind", "rows", "trials", "flagged")
            for run in runs
        ],
        "unresolved": [vars(question) for question in asked],
    }

    def human() -> None:
        names = [run.source.name for run in runs]
        for run in runs:
            marks = [f"{count} {name.replace('_', ' ')}" for name, count in sorted(run.flagged.items()) if count]
            folder = f"{run.source.resolve().parent.name}/" if names.count(run.source.name) > 1 else ""
            name = printable(f"{folder}{run.source.name}")
            trials = f"{run.trials} trial{'' if run.trials == 1 else 's'}"
            click.echo(f"{name}: {run.rows:,} rows, {trials}; flagged: {', '.join(marks) or 'nothing'}")
            for finding in run.findings:
                if ui.verbose or finding.level != "note":
                    click.echo(printable(f"  {finding.level}: {finding.text}"))
            click.echo(f"  {run.path}")
        for question in asked:
            click.echo(printable(f"not answered: {question.what}: {question.question}; taken: {question.used}"))

    ui.result(data, human, [str(run.path) for run in runs])


def guess(ui: Ui, files: Sequence[Path], output: Path | None) -> None:
    """Report what the files seem to hold, and write the map where `output` says."""
    from pmabench.files.document import Document
    from pmabench.kinds.registry import importable
    from pmabench.report.writing import write_file
    from pmabench.store.importers.guess.guess import guess_files
    from pmabench.store.importers.guess.write import map_text, still_open
    from pmabench.store.importers.map_file import questions_of

    no_overwriting(output)
    found = guess_files(files, importable())
    text = map_text(found)
    left = still_open(text)
    questions = questions_of(Document("map" if output is None else str(output), text))
    if output is not None:
        write_file(output, text, "the map")
    data = {
        "schema": "pmabench.import-guess/1",
        "files": [str(path) for path in files],
        "format": found.layout.format,
        "kind": found.kind,
        "rate": list(found.rate),
        "columns": [{"is": c.role, **fields(c, "name", "unit", "reasons", "doubts")} for c in found.columns],
        "left_out": found.left_out,
        "reasons": found.reasons,
        "doubts": found.doubts,
        "open": left,
        "questions": [vars(question) for question in questions],
        "map": text,
        "written": None if output is None else str(output),
    }

    def human() -> None:
        _show(found)
        if output is None:
            click.echo(f"\n{text}" if ui.verbose else "\nnothing was written; -o MAP writes the map, -v shows it here")
        else:
            click.echo(f"\nmap: {output}")
        if questions:
            many = "1 question" if len(questions) == 1 else f"{len(questions)} questions"
            what = "write each answer into the map, or give it with import --set:"
            click.echo(f"{many} that no file answers (??); {what}")
            for question in questions:
                taken = f" [until then: {question.used}]" if question.used else ""
                place = question.what if output is None else f"{question.where}  {question.what}"
                click.echo(printable(f"  {place}: {question.question}{taken}"))
        elif output is not None:
            click.echo(f"then: pmabench import FILE... --map {output}")

    ui.result(data, human, [] if output is None else [str(output)])


def _show(found: Guess) -> None:
    """Layout, columns, and what is doubtful."""
    click.echo(printable(f"{found.files[0]}{f' and {len(found.files) - 1} more' if len(found.files) > 1 else ''}"))
    for key in ("file", "sampling", "trials", "name_tells"):
        for reason in found.reasons.get(key, []):
            click.echo(printable(f"  {reason}"))
    for column in found.columns:
        role = column.role.replace("_", " ") + (f" [{column.unit}]" if column.unit and column.role != "ignore" else "")
        click.echo("\n" + printable(f"{column.name}: {role}"))
        said = [f"  because: {text}" for text in column.reasons] + [f"  DOUBT: {text}" for text in column.doubts]
        click.echo("".join(f"{printable(text)}\n" for text in said), nl=False)
    for text in found.doubts:
        click.echo("\n" + printable(f"DOUBT: {text}"))
