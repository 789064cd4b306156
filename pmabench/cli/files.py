"""`pmabench list` and `schema`: the files that people write, by name, and the JSON Schemas of their kinds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any, Union

import click

from pmabench.base.errors import RecordError, UsageError
from pmabench.base.kind import load
from pmabench.cli.common import Ui, common
from pmabench.cli.names import FOLDER, head_of, own_files, shipped_files
from pmabench.report.terminal import print_texts

LISTED = {
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
@click.argument("what", required=False, type=click.Choice(list(LISTED)))
@common
def list_(ui: Ui, what: str | None) -> None:
    """List the files of this folder and those that come with pmabench, of one kind or of all.

    A shipped file is given to other commands by its name, one of this folder by its path.
    """
    rows: list[dict[str, Any]] = []
    for asked in [what] if what else LISTED:
        kind = LISTED[asked]
        rows += [_row(kind, path, str(path), "here") for path in own_files(kind)]
        rows += [_row(kind, path, path.stem, "shipped") for path in shipped_files(kind)]

    def human() -> None:
        table = [[row["kind"], row["name"], row["title"], row["from"]] for row in rows]
        print_texts(ui.console(columns=120), ["kind", "name", "what it is", "where"], table)

    ui.result({"schema": "pmabench.files/1", "files": rows}, human, (row["name"] for row in rows))


def _row(kind: str, path: Path, name: str, origin: str) -> dict[str, Any]:
    known = dict(KEY.findall(head_of(path)))
    title = known.get("name") or ", ".join(known[key] for key in ("make", "type", "nominal_length") if key in known)
    return {"kind": kind, "name": name, "title": title.strip("\"'"), "from": origin, "path": str(path)}


KINDS = {
    "protocol": "",
    "bench": "pmabench.bench.files.bench:BenchFile",
    "specimen": "pmabench.bench.files.specimen:SpecimenFile",
    "calibration": "pmabench.bench.files.specimen:CalibrationFile",
    "campaign": "pmabench.kinds.compile:CampaignFile",
    "cascade": "pmabench.protocol.cascade:CascadeFile",
    "map": "pmabench.store.importers.map_file:MapFile",
    "registers": "",
    "plant": "pmabench.bench.files.plant:AnyPlant",
    "truth": "pmabench.bench.truth:TruthFile",
}
"""Kind of file -> its model; of protocols every kind of test has one, and that of registers is its driver's."""


@click.command(name="schema")
@click.argument("kind", required=False, type=click.Choice(list(KINDS)))
@click.option("--all", "write_all", is_flag=True, help="Write every schema into the folder given with --out.")
@click.option("--out", type=FOLDER, help="Folder for --all.")
@common
def schema(ui: Ui, kind: str | None, out: Path | None, *, write_all: bool) -> None:
    """Print the JSON Schema of KIND, or write all of them into a folder."""
    if write_all and out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name in KINDS:
                (out / f"{name}.schema.json").write_text(schema_text(name), encoding="utf-8")
        except OSError as error:
            raise RecordError(f"{out}: no schemas can be written here: {error.strerror or error}") from error
        ui.note(f"{len(KINDS)} schemas in {out}")
        return
    if kind is None or write_all or out is not None:
        raise UsageError(f"say which: {', '.join(KINDS)}; or --all --out FOLDER")
    ui.result(_schema(kind), lambda: click.echo(schema_text(kind), nl=False))


def schema_text(kind: str) -> str:
    """The schema of one kind of file as JSON text."""
    return json.dumps(_schema(kind), indent=1, sort_keys=True) + "\n"


def _schema(kind: str) -> dict[str, Any]:
    """The model's schema, with `include` allowed, whose files need not hold every key themselves."""
    from pydantic import Field, TypeAdapter

    from pmabench.bench.driver_options import driver_class
    from pmabench.kinds.compile import kind_class
    from pmabench.kinds.registry import importable, protocols

    schema: dict[str, Any]
    if kind == "registers":
        schema = load(driver_class("modbus")).map_schema()
    else:
        kinds: Any = Union[tuple(map(kind_class, protocols()))]  # noqa: UP007
        model: Any = load(KINDS[kind]) if KINDS[kind] else Annotated[kinds, Field(discriminator="kind")]
        schema = TypeAdapter[Any](model).json_schema()
    if kind == "map":
        schema["properties"]["kind"]["enum"] = list(importable())
    for part in (schema, *schema.get("$defs", {}).values()):
        if "schema" in part.get("properties", {}):
            part["properties"]["include"] = {"type": "string", "description": "a file that this one is based on"}
            part["if"] = {"not": {"required": ["include"]}}
            part["then"] = {"required": part.pop("required", [])}
            if "anyOf" in part:
                part["then"]["anyOf"] = part.pop("anyOf")
    return schema
