"""`pmabench init --like BENCH`: a lab folder as a copy of a shipped bench, for devices that `init` does not ask about.

Of a simulated bench it passes `check`. Of a bench with devices, what is true at one lab only (calibrations, the muscle)
is written as `??`, and `check` refuses each until it is filled in.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pmabench.base.errors import invalid
from pmabench.cli.prepare import Prepared, prepare
from pmabench.files.document import Document
from pmabench.files.shipped import shipped_folder

SCHEMAS = "schemas"
ROLES = ("protocol", "bench", "specimen")
CHECK = "protocol.yaml --bench bench.yaml --specimen specimen.yaml"
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


def copy_of(like: str) -> tuple[dict[str, str], bool]:
    """Path -> text of a lab folder with the shipped bench `like`, and whether that bench is simulated."""
    prepared = prepare("contraction-relaxation", like, "mas-20-250-paper0")
    return dict(_files(prepared)), _simulated(prepared)


def _files(prepared: Prepared) -> Iterator[tuple[str, str]]:
    """Path in the lab folder and text of each file."""
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
    yield "README.md", _readme(prepared, paths["bench"].stem)


def _shipped(role: str, path: Path) -> bool:
    return shipped_folder(role).resolve() in path.resolve().parents


def _included(path: Path) -> Iterator[tuple[str, str]]:
    """What a file includes, and what that includes."""
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


def _simulated(prepared: Prepared) -> bool:
    return all(device.driver.startswith("mock") for device in prepared.mounted.bench_file.devices.values())


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
pmabench check {CHECK}    # nothing moves
pmabench run {CHECK}      # records into runs/
pmabench process runs/*          # coefficients, into analyses/
pmabench report runs/* -o report.html
```

Before air is on: `pmabench check` names what the bench lacks, `pmabench bench card bench.yaml -o card.html` is the page
to hang at the rig, `pmabench bench probe bench.yaml` asks the devices who they are. Keep this folder under version
control, all but `runs/` and `analyses/`. pmabench is not a safety function.
"""
