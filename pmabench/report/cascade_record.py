"""The result of a simulated chain as one JSON file and one CSV file, and back: drawings need no second simulation."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmabench.base.errors import invalid
from pmabench.model.cascade import Course
from pmabench.report.writing import write_file
from pmabench.store.json_files import read_json

SCHEMA: Literal["pmabench.cascade-result/1"] = "pmabench.cascade-result/1"
MOST_BYTES = 400_000_000
Positive = Annotated[float, Field(gt=0, lt=1e3)]
Column = list[float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, populate_by_name=True)


class Link(_Strict):
    """One muscle of a result: name and law, shape without contraction [m, rad], and its motion over time [SI]."""

    name: str
    law: str
    length: Positive
    radius: Positive
    braid_angle: Annotated[float, Field(gt=0, lt=math.pi / 2)]
    pressure: Column
    displacement: Column
    force_ce: Column


class Result(_Strict):
    """The simulated motion of a chain; columns over time in SI, all of one length, with their `units`."""

    schema_: Annotated[Literal["pmabench.cascade-result/1"], Field(alias="schema")] = SCHEMA
    simulated: Literal[True] = True
    name: str
    source: str
    load: Annotated[float, Field(ge=0)]
    fce_eval: str
    paced: dict[str, float] | None
    units: dict[str, str]
    muscles: Annotated[list[Link], Field(min_length=1)]
    time: Column
    displacement: Column
    force_ce_sum: Column
    force_ce: Column
    force: Column
    written: list[str] = []
    """Files that a command wrote in addition to what it printed."""


UNITS = {
    "time": "s", "displacement": "m", "force_ce_sum": "N", "force_ce": "N", "force": "N", "pressure": "Pa",
    "length": "m", "radius": "m", "braid_angle": "rad", "load": "N",
}  # fmt: skip
TOTALS = ("time", "displacement", "force_ce_sum", "force_ce", "force")
EACH = ("pressure", "displacement", "force_ce")


def result(
    about: Mapping[str, Any], muscles: Sequence[Mapping[str, Any]], course: Course, paced: dict[str, float] | None
) -> Result:
    """The result of a course; `about` and `muscles` have what describes the chain and each of its links.

    `paced` has the seconds `simulated` and `elapsed` where it was paced.
    """
    columns = zip(muscles, course.P.tolist(), course.x.tolist(), course.F_ce.tolist(), strict=True)
    links = [Link(**muscle, pressure=P, displacement=x, force_ce=F_ce) for muscle, P, x, F_ce in columns]
    totals = {name: getattr(course, name).tolist() for name in TOTALS if name != "time"}
    return Result(**about, paced=paced, units=UNITS, muscles=links, time=course.t.tolist(), **totals)


def write_result(found: Result, folder: Path) -> list[Path]:
    """Write `cascade.json` and `cascade.csv` into the folder, which is made where needed."""
    files = {
        "cascade.json": json.dumps(found.model_dump(by_alias=True), allow_nan=False, separators=(",", ":")) + "\n",
        "cascade.csv": csv_text(found),
    }
    return [write_file(folder / name, text, "the result") for name, text in files.items()]


def csv_text(found: Result) -> str:
    """A row per sample, SI with units in the head, all digits: the chain first, then each muscle by its name."""
    heads = [f"{name} [{UNITS[name]}]" for name in TOTALS]
    columns = [getattr(found, name) for name in TOTALS]
    for link in found.muscles:
        heads += [f"{link.name}: {name} [{UNITS[name]}]" for name in EACH]
        columns += [getattr(link, name) for name in EACH]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([repr(value) for value in row] for row in zip(*columns, strict=True))
    return text.getvalue()


def read_result(path: Path) -> Result:
    """Read a result from its JSON file or its folder. Raises InvalidFile."""
    file = path / "cascade.json" if path.is_dir() else path
    missing = "there is no result here; pmabench model cascade simulate FILE --out FOLDER writes one"
    try:
        found = Result.model_validate(read_json(file, SCHEMA, "result of a cascade", MOST_BYTES, missing))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise invalid(file, f"is a damaged result of a cascade, at {where or 'its end'}: {first['msg']}") from error
    lengths = {len(getattr(found, name)) for name in TOTALS}
    lengths |= {len(getattr(link, name)) for link in found.muscles for name in EACH}
    rising = len(found.time) >= 2 and bool((np.diff(found.time) > 0).all())
    shorter = all(max(link.displacement, default=0.0) < link.length for link in found.muscles)
    if len(lengths) != 1 or not rising or not shorter:
        raise invalid(file, "is damaged: columns of unlike length, times that do not rise, or muscles of no length")
    return found
