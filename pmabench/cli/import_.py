"""`pmabench import`: old files of other programs become runs, by a map; doubts are reported, nothing is mended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError
from pmabench.base.text import printable
from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from pmabench.store.importers.importing import ImportedRun


@click.command(name="import")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE...")
@click.option("--map", "map_name", help="Map file, or the name of a shipped one.")
@click.option("--guess", "guessing", is_flag=True, help="Propose a map with its reasons, and import nothing.")
@click.option(
    "--span",
    multiple=True,
    metavar="CHANNEL=LOW..HIGH",
    help='With --guess: what a sensor measures, "pressure=0 bar..12 bar".',
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="With --guess: where the map is written.")
@click.option("--set", "answers", multiple=True, metavar="KEY=VALUE", help="The answer to a question (??) of the map.")
@click.option(
    "--unresolved",
    is_flag=True,
    help="Take what the map proposes where its questions are not answered; no result is accepted then.",
)
@click.option("--out", default="runs", show_default=True, type=click.Path(path_type=Path), help="Where run folders go.")
@common
def command(
    ui: Ui,
    files: tuple[Path, ...],
    map_name: str | None,
    guessing: bool,
    span: tuple[str, ...],
    output: Path | None,
    answers: tuple[str, ...],
    out: Path,
    *,
    unresolved: bool,
) -> int | None:
    """Make one run of each FILE, as the map says; the files themselves are never touched."""
    if guessing == (map_name is not None) or (not guessing and (span or output)) or (guessing and answers):
        raise UsageError("give --map to import, or --guess (with --span and -o) to have a map proposed")
    if guessing or map_name is None:
        from pmabench.cli.guess import guess

        return guess(ui, files, span, output)
    from pmabench.files.shipped import find_file
    from pmabench.kinds.registry import importable
    from pmabench.store.importers.importing import import_files

    split = [tuple(text.split("=", 1)) for text in answers if "=" in text]
    if len(split) < len(answers):
        raise UsageError("--set needs KEY=VALUE, for instance --set columns.F.unit=N")
    pairs = [(key, value) for key, value in split]
    runs = import_files(files, find_file("map", map_name), out, importable(), pairs, unresolved=unresolved)
    asked = list(dict.fromkeys(question for run in runs for question in run.unresolved))
    data = {
        "schema": "pmabench.import/1",
        "runs": [_plain(run) for run in runs],
        "unresolved": [vars(question) for question in asked],
    }

    def human() -> None:
        names = [run.source.name for run in runs]
        for run in runs:
            flagged = ", ".join(
                f"{count} {name.replace('_', ' ')}" for name, count in sorted(run.flagged.items()) if count
            )
            folder = f"{run.source.resolve().parent.name}/" if names.count(run.source.name) > 1 else ""
            name = printable(f"{folder}{run.source.name}")
            trials = f"{run.trials} trial{'' if run.trials == 1 else 's'}"
            click.echo(f"{name}: {run.rows:,} rows, {trials}; flagged: {flagged or 'nothing'}")
            for finding in run.findings:
                if ui.verbose or finding.level != "note":
                    click.echo(printable(f"  {finding.level}: {finding.text}"))
            click.echo(f"  {run.path}")
        for question in asked:
            click.echo(printable(f"not answered: {question.what}: {question.question}; taken: {question.used}"))

    ui.result(data, human, [str(run.path) for run in runs])
    return None


def _plain(run: ImportedRun) -> dict[str, Any]:
    return {
        "run": str(run.path),
        "id": run.id,
        "source": str(run.source),
        "kind": run.kind,
        "rows": run.rows,
        "trials": run.trials,
        "flagged": dict(run.flagged),
        "findings": [vars(finding) for finding in run.findings],
    }
