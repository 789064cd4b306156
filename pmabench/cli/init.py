"""`pmabench init`: a lab folder to begin with, of shipped files that belong together.

Of a simulated bench it passes `check`. Of a bench with devices, what is true at one lab only (calibrations, the muscle)
is written as `??`, and `check` refuses each until it is filled in.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import InvalidFile, RecordError, UsageError, invalid
from pmabench.cli.common import Ui, common
from pmabench.cli.names import BENCH, PROTOCOL, SPECIMEN
from pmabench.files.shipped import shipped_folder

if TYPE_CHECKING:
    from pmabench.cli.prepare import Prepared

SCHEMAS = "schemas"
ROLES = ("protocol", "bench", "specimen")
BLANK_SPECIMEN = """\
# yaml-language-server: $schema=schemas/specimen.schema.json
# `check` refuses this file until every ?? is what is true of your muscle.
schema: pmabench.specimen/1
make: ??
type: ??                                       # as on its label
serial: ??
nominal_length: ??                             # between the fittings, as ordered: 250 mm
inner_diameter: ??                             # 20 mm
mounted: {date: "??", length: "??", at: {load: 0 kg, pressure: 0 kPa}}  # in the rig, with that load
limits: {pressure: {command: "??", never_above: "??"}, contraction: "??", source: "??"}   # by the maker's data sheet
"""
CALIBRATION = """\
# yaml-language-server: $schema=../schemas/calibration.schema.json
# `check` refuses this file until every ?? is filled in: by the sensor's certificate or data sheet at first, later by
# `pmabench calibrate`, which compares the sensor with a reference at the bench and writes a file like this one.
schema: pmabench.calibration/1
id: {id}
quantity: {quantity}
reference: ??                                  # what the sensor was compared with, with its serial or certificate
date: ??                                       # 2026-11-23
points: ??                                     # readings, true values: [[0 V, 0 N], [10 V, 500 N]]
expanded_uncertainty: ??                       # k = 2, with a unit
"""


@click.command(name="init")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--bench", type=BENCH, default="mock", help="Bench to begin with: the name of a shipped one, or a file.")
@click.option("--specimen", type=SPECIMEN, default="mas-20-250-paper0", help="Specimen to begin with, as above.")
@click.option("--protocol", type=PROTOCOL, default="contraction-relaxation", help="Protocol to begin with, as above.")
@common
def command(ui: Ui, folder: Path, bench: str, specimen: str, protocol: str) -> int | None:
    """Write a lab folder: bench, specimen and protocol with all that they need, and a README. DIR must be empty."""
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
    from pmabench.files.document import Document

    paths = {role: Path(prepared.sources[role]) for role in ROLES}
    own = not _simulated(prepared)
    for role, path in paths.items():
        if own and role == "specimen" and _shipped(role, path):
            yield f"{role}.yaml", BLANK_SPECIMEN
            continue
        yield f"{role}.yaml", _text(path)
        yield from _included(path)
    bench_folder = paths["bench"].parent
    for name in prepared.mounted.documents:
        if own and name.startswith("calibrations/") and _shipped("bench", paths["bench"]):
            shipped = Document(name, _text(bench_folder / name)).data  # of another sensor: only its quantity counts
            yield name, CALIBRATION.format(id=Path(name).stem, quantity=shipped["quantity"])
        elif "/" in name:
            yield name, _text(bench_folder / name, depth=name.count("/"))
    for kind in (*ROLES, "calibration"):
        yield f"{SCHEMAS}/{kind}.schema.json", schema_text(kind)
    yield "README.md", _readme(prepared, paths["bench"].stem)


def _shipped(role: str, path: Path) -> bool:
    return shipped_folder(role).resolve() in path.resolve().parents


def _included(path: Path) -> Iterator[tuple[str, str]]:
    """What a file includes, and what that includes."""
    from pmabench.files.document import Document

    name = Document(str(path), path.read_text()).data.get("include")
    if not isinstance(name, str):
        return
    if Path(name).parent != Path() or name in {f"{role}.yaml" for role in ROLES}:
        raise invalid(path, f'includes "{name}", which cannot lie in a lab folder; name a file next to it')
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
    from pmabench.cli.prepare import prepare

    there = folder.exists()
    try:
        for name, text in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        protocol, bench, specimen = (str(folder / f"{role}.yaml") for role in ROLES)
        _refuse_faulty(lambda: prepare(protocol, bench, specimen))
    except BaseException as error:
        with suppress(OSError):
            for name in {Path(name).parts[0] for name in files}:  # it was empty before
                shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink(missing_ok=True)
            if not there:
                folder.rmdir()
        if isinstance(error, OSError):
            raise RecordError(f"{folder}: no lab folder can be written here: {error.strerror or error}") from error
        raise


def _refuse_faulty(prepare: Callable[[], object]) -> None:
    """Raise what is wrong with the files, apart from what is to be filled in."""
    from pmabench.bench.compile import OPEN

    try:
        prepare()
    except InvalidFile as error:
        if not all(f"({OPEN})" in problem.message for problem in error.problems):
            raise


def _check() -> str:
    return "protocol.yaml --bench bench.yaml --specimen specimen.yaml"


def _simulated(prepared: Prepared) -> bool:
    return all(device.driver.startswith("mock") for device in prepared.mounted.bench_file.devices.values())


def _next(folder: Path, prepared: Prepared) -> str:
    kind_of_bench = "simulated" if _simulated(prepared) else "devices at the addresses in bench.yaml"
    fill = (
        ""
        if _simulated(prepared)
        else "\nto be filled in where ?? is written: specimen.yaml and calibrations/; check names each place"
    )
    first = f"{folder}: bench ({kind_of_bench}), specimen, protocol, README.md{fill}"
    return f"{first}\nnext: cd {folder} && pmabench check {_check()}"


def _readme(prepared: Prepared, bench: str) -> str:
    mounted, plan = prepared.mounted, prepared.plan
    kind = "A simulated muscle: write your devices in its place, or copy the shipped bench that is most like yours"
    muscle = f": {mounted.specimen_file.type}" if _simulated(prepared) else ""
    if not _simulated(prepared):
        kind = "Addresses, ranges and limits are examples: put in yours"
    return f"""# Lab folder

| file | what |
| --- | --- |
| `bench.yaml` | what is wired where, limits, safe state; the shipped bench `{bench}`. {kind} |
| `calibrations/` | of the bench's channels; fill in what is `??`. `pmabench calibrate CHANNEL ...` writes new ones |
| `specimen.yaml` | the muscle{muscle}. Put in type, serial, lengths and limits of yours |
| `protocol.yaml` | what is tested: {plan.name} (kind {plan.kind}) |
| `schemas/` | for editors, which complete and check the files with them |

```
pmabench check {_check()}    # nothing moves
pmabench run {_check()}      # records into runs/
pmabench process runs/*          # coefficients, into analyses/
pmabench report runs/* -o report.html
```

Before air is on: `pmabench check` names what the bench lacks, `pmabench bench card bench.yaml -o card.html` is the page
to hang at the rig, `pmabench bench probe bench.yaml` asks the devices who they are. Keep this folder under version
control, all but `runs/` and `analyses/`. pmabench is not a safety function.
"""
