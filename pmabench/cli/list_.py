"""`pmabench list`: benches, protocols, specimens, campaigns, plants and maps that a command takes by name or path."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from pmabench.cli.common import Ui, common
from pmabench.cli.names import head_of, own_files, shipped_files
from pmabench.report.terminal import print_texts

KINDS = {
    "benches": "bench",
    "protocols": "protocol",
    "specimens": "specimen",
    "campaigns": "campaign",
    "plants": "plant",
    "maps": "map",
}
"""What is asked for -> kind of file."""
KEY = re.compile(r"^(name|make|type|nominal_length): *(.*?) *(?:  #.*)?$", re.MULTILINE)


@click.command(name="list")
@click.argument("what", required=False, type=click.Choice(list(KINDS)))
@common
def command(ui: Ui, what: str | None) -> None:
    """List the files of this folder and those that come with pmabench, of one kind or of all.

    A shipped file is given to other commands by its name, one of this folder by its path.
    """
    rows: list[dict[str, Any]] = []
    for asked in [what] if what else KINDS:
        kind = KINDS[asked]
        rows += [_row(kind, path, str(path), "here") for path in own_files(kind)]
        rows += [_row(kind, path, path.stem, "shipped") for path in shipped_files(kind)]

    def human() -> None:
        table = [[row["kind"], row["name"], row["title"], row["from"]] for row in rows]
        print_texts(ui.console(columns=120), ["kind", "name", "what it is", "where"], table)

    ui.result({"schema": "pmabench.files/1", "files": rows}, human, (row["name"] for row in rows))


def _row(kind: str, path: Path, name: str, origin: str) -> dict[str, Any]:
    told = dict(KEY.findall(head_of(path)))
    title = told.get("name") or ", ".join(told[key] for key in ("make", "type", "nominal_length") if key in told)
    return {"kind": kind, "name": name, "title": title.strip("\"'"), "from": origin, "path": str(path)}
