"""`pmabench note`: words, pictures and exclusions added to a run; nothing that was recorded is touched."""

from __future__ import annotations

from pathlib import Path

import click

from pmabench.cli.common import Ui, common, login_name
from pmabench.cli.names import PATH, RunFolder


@click.command(name="note")
@click.argument("run", type=RunFolder())
@click.argument("text", default="")
@click.option("--attach", multiple=True, type=PATH, metavar="FILE", help="A copy is kept.")
@click.option(
    "--exclude",
    type=click.IntRange(min=1),
    metavar="TRIAL",
    help="Leave a trial out of fits: its number in `runs show` and on the display, from 1.",
)
@click.option("--because", default="", metavar="TEXT", help="Why it is left out.")
@click.option("--operator", default="", help="Who says so; the login name if not given.")
@common
def command(
    ui: Ui, run: Path, text: str, attach: tuple[Path, ...], exclude: int | None, because: str, operator: str
) -> None:
    """Append a note to RUN, open or closed: TEXT, files, or a trial that is left out of fits and why."""
    from pmabench.store.notes import add_note

    index = None if exclude is None else exclude - 1
    note = add_note(run, text, attach=attach, exclude=index, because=because, operator=operator or login_name())
    data = {"schema": "pmabench.note-added/1", "run": str(run), "note": note.as_data()}

    def human() -> None:
        click.echo(f"note {note.number} of {run}")
        if note.exclude is not None:
            click.echo(f"left out: {_trial(run, note.exclude)}")

    ui.result(data, human)


def _trial(run: Path, index: int) -> str:
    """A trial in words, so that a wrong number is seen."""
    from pmabench.display.wording import point_text
    from pmabench.store.folder import EVENTS, decode_lines, read_file

    lines = decode_lines(read_file(run, EVENTS)).lines
    data = next(line["data"] for line in lines if line["kind"] == "trial-begin" and line["data"].get("trial") == index)
    return f"trial {index + 1} ({point_text(data.get('point') or {})})"
