"""`pmabench init`: a lab folder to begin with, of shipped files that belong together; what it writes passes `check`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from pmabench.cli.prepare import Prepared

SCHEMAS = "schemas"
ROLES = ("protocol", "bench", "specimen")


@click.command(name="init")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--bench", default="mock", help="Bench to begin with: the name of a shipped one, or a file.")
@click.option("--specimen", default="mas-20-250-paper0", help="Specimen to begin with, as above.")
@click.option("--protocol", default="contraction-relaxation", help="Protocol to begin with, as above.")
@common
def command(ui: Ui, folder: Path, bench: str, specimen: str, protocol: str) -> int | None:
    """Write a lab folder: bench, specimen and protocol with all that they need, and a README. DIR must be empty."""
    from pmabench.base.errors import UsageError
    from pmabench.cli.prepare import prepare

    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder} is there and not an empty folder; give a new one")
    except OSError as error:
        raise UsageError(f"{folder} cannot be looked into: {error.strerror or error}") from error
    prepared = prepare(protocol, bench, specimen)
    files = dict(_files(prepared))
    _write(folder, files)
    data = {"schema": "pmabench.init/1", "folder": str(folder), "files": sorted(files)}
    ui.result(data, lambda: click.echo(_next(folder, prepared)))
    return None


def _files(prepared: Prepared) -> Iterator[tuple[str, str]]:
    """Path in the lab folder and text of each file."""
    from pmabench.cli.schema import schema_text

    paths = {role: Path(prepared.sources[role]) for role in ROLES}
    for role, path in paths.items():
        yield f"{role}.yaml", _text(path)
        yield from _included(path)
    beside = paths["bench"].parent
    for name in prepared.mounted.documents:
        if "/" in name:
            yield name, _text(beside / name, depth=name.count("/"))
    for kind in (*ROLES, "calibration"):
        yield f"{SCHEMAS}/{kind}.schema.json", schema_text(kind)
    yield "README.md", _readme(prepared, paths["bench"].stem)


def _included(path: Path) -> Iterator[tuple[str, str]]:
    """What a file includes, and what that includes."""
    from pmabench.base.errors import invalid
    from pmabench.files.document import Document

    name = Document(str(path), path.read_text()).data.get("include")
    if not isinstance(name, str):
        return
    if Path(name).parent != Path() or name in {f"{role}.yaml" for role in ROLES}:
        raise invalid(path, f'includes "{name}", which cannot lie in a lab folder; name a file beside it')
    yield name, _text(path.parent / name)
    yield from _included(path.parent / name)


def _text(path: Path, depth: int = 0) -> str:
    """A file's text; editors find its schema in the lab folder."""
    lines = path.read_text().splitlines(keepends=True)
    mark = "yaml-language-server: $schema="
    for i, line in enumerate(lines):
        if line.startswith("#") and mark in line:
            lines[i] = f"# {mark}{'../' * depth}{SCHEMAS}/{line.strip().rsplit('/', 1)[-1]}\n"
    return "".join(lines)


def _write(folder: Path, files: dict[str, str]) -> None:
    """Write them and check them where they lie; nothing is left where that fails."""
    import shutil

    from pmabench.base.errors import RecordError
    from pmabench.cli.prepare import prepare

    there = folder.exists()
    try:
        for name, text in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        protocol, bench, specimen = (str(folder / f"{role}.yaml") for role in ROLES)
        prepare(protocol, bench, specimen)
    except BaseException as error:
        with suppress(OSError):
            for name in {Path(name).parts[0] for name in files}:  # it was empty before
                shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink(missing_ok=True)
            if not there:
                folder.rmdir()
        if isinstance(error, OSError):
            raise RecordError(f"{folder}: no lab folder can be written here: {error.strerror or error}") from error
        raise


def _check() -> str:
    return "protocol.yaml --bench bench.yaml --specimen specimen.yaml"


def _simulated(prepared: Prepared) -> bool:
    return all(device.driver.startswith("mock") for device in prepared.mounted.bench_file.devices.values())


def _next(folder: Path, prepared: Prepared) -> str:
    told = "simulated" if _simulated(prepared) else "devices at the addresses in bench.yaml"
    return f"{folder}: bench ({told}), specimen, protocol, README.md\nnext: cd {folder} && pmabench check {_check()}"


def _readme(prepared: Prepared, bench: str) -> str:
    mounted, plan = prepared.mounted, prepared.plan
    kind = "A simulated muscle: write your devices in its place, or copy the shipped bench that is most like yours"
    if not _simulated(prepared):
        kind = "Addresses, ranges, limits and calibrations are examples: put in yours"
    return f"""# Lab folder

| file | what |
| --- | --- |
| `bench.yaml` | what is wired where, limits, safe state; the shipped bench `{bench}`. {kind} |
| `calibrations/` | of the bench's channels; `pmabench calibrate CHANNEL --bench bench.yaml ...` writes new ones |
| `specimen.yaml` | the muscle: {mounted.specimen_file.type}. Put in type, serial, lengths and limits of yours |
| `protocol.yaml` | what is tested: {plan.name} (kind {plan.kind}) |
| `schemas/` | for editors, which complete and check the files with them |

```
pmabench check {_check()}    # nothing moves
pmabench run {_check()}      # records into runs/
pmabench process runs/*          # coefficients, into analyses/
pmabench report runs/* -o report.html
```

Before air is on: `pmabench check` names what the bench lacks, `pmabench bench card bench.yaml -o card.html` is the page
to hang at the rig, `pmabench devices probe bench.yaml` asks the devices who they are. Keep this folder under version
control, all but `runs/` and `analyses/`. pmabench is not a safety function.
"""
