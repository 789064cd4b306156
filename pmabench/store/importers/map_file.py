"""Import maps as strict models: what people write about an old file, checked by itself; reads no data."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, Union

from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from pmabench.files.document import Strict
from pmabench.files.quantity import Force, Frequency, Length, Pressure, Ratio, Time, raw_quantity
from pmabench.store.formats.record import Layout
from pmabench.store.formats.registry import formats
from pmabench.store.formats.text import Name as Short

Reading = Annotated[
    tuple[float, str],
    BeforeValidator(raw_quantity),
    WithJsonSchema({"type": "string", "description": "a number with its unit", "examples": ["4 mA", "0.683 N/count"]}),
]
"""A number with its unit, kept apart."""
PLACE = "{test}"
"""In the name of a column: the name of the test."""
Text = Annotated[str, Field(max_length=600)]
Role = Literal[
    "time", "date", "pressure", "displacement", "force", "pressure_command", "displacement_command", "supply", "angle",
    "phase", "trial", "point", "flags", "simulated", "ignore",
]  # fmt: skip
Written = Literal[
    "number", "index", "header step", "clock", "date and time", "epoch", "serial days", "matlab days", "labview"
]
SCALES = {"points", "line", "recorded_with", "contraction", "range", "dropout", "blip", "spike"}
"""What only a column that is measured or commanded has."""
Confirmable = Literal["counts", "gain", "jump", "lag", "magnitude", "pressure-unit", "sibling", "swap", "time-unit"]
NUMBERS = frozenset(("phase", "trial", "flags", "simulated", "ignore"))
"""Roles of columns that measure nothing: they have no unit and no scale."""
PointName = Literal[
    "contraction", "load", "mass", "pressure", "frequency", "speed", "lower", "upper", "start", "step", "mean",
    "amplitude", "cycles", "side", "setpoint", "bias", "tip_mass",
]  # fmt: skip


def _format(value: Any) -> str:
    return str(value.get("format", "text") if isinstance(value, dict) else getattr(value, "format", "text"))


if TYPE_CHECKING:
    AnyLayout: TypeAlias = Layout
else:
    AnyLayout = Annotated[
        Union[tuple(Annotated[each.layout, Tag(name)] for name, each in formats().items())],  # noqa: UP007
        Discriminator(_format),
    ]
    """How a file is laid out: what its format takes."""


class Line(Strict):
    """A straight line: value = slope x reading + offset."""

    slope: Reading
    """For instance `0.683 N/count`."""
    offset: Reading


class Contraction(Strict):
    """How a displacement sensor shows contraction, which is positive when the muscle shortens."""

    reading: Literal["falls", "rises"]
    """What the reading does while the muscle shortens."""
    zero: Reading
    """The reading at no contraction."""


class ColumnFile(Strict):
    """What one column is, and how its numbers become SI."""

    is_: Annotated[Role, Field(alias="is")]
    of: PointName | None = None
    """With `is: point`: which coordinate of the operating point."""
    unit: Short = ""
    """Unit of the raw reading: `mA`, `count`, `ms`, `kPa` ..."""
    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)] | None = None
    line: Line | None = None
    recorded_with: Line | None = None
    """The file does not hold the reading but what somebody made of it with this line; it is turned back first."""
    whole: bool = False
    """The reading is a whole number of counts."""
    contraction: Contraction | None = None
    range: tuple[Reading, Reading] | None = None
    dropout: Reading | None = None
    """What a cut wire reads."""
    blip: Reading | None = None
    """Nonsense where a single sample between two others reads so."""
    stale_after: Time | None = None
    spike: Reading | None = None
    """How far a lone sample may lie from its neighbours; otherwise that follows from the scatter of the channel."""
    late_by: tuple[Time, Time] = (0.0, 0.0)
    """How much older a value may be than its time stamp, least and most."""
    expanded_uncertainty: Reading | None = None
    gain_uncertainty: Ratio = 0.0
    sensor_lag: Annotated[Time, Field(ge=0.0)] = 0.0
    """Time constant of the sensor."""
    reference: Text = ""
    """Where the scale comes from."""
    written: Written = "number"
    """How a column of time is written: `number` counts units from any zero; `index` counts samples, `period` apart;
    `header step` counts samples, whose Start and Increment the header gives; `clock` is HH:MM:SS, of one day or with a
    column `is: date`; `date and time` both in one text; `epoch` counts units from 1970, `labview` seconds from 1904;
    `serial days` and `matlab days` count days, as spreadsheets and datenum do.
    """
    order: Literal["year first", "day first", "month first"] = "year first"
    """Order of a date whose year comes last, as in 01/03/2024."""
    period: Annotated[Time, Field(gt=0.0)] | None = None
    """Distance of the samples that `written: index` counts."""
    marks: Annotated[dict[Short, Annotated[int, Field(ge=-1000, le=1000)]], Field(max_length=20)] = {}
    """Of a phase column: name of the phase -> its number."""
    optional: bool = False
    """Absent in some files."""

    @model_validator(mode="after")
    def _fits(self) -> ColumnFile:
        measured = self.is_ not in {"time", "date", "point"} | NUMBERS
        if self.points is not None and self.line is not None:
            raise ValueError('give "points" or "line", not both')
        counts = self.is_ == "time" and self.written in ("number", "epoch")
        if (measured or counts) and not self.unit:
            raise ValueError(f'"{self.is_}" needs "unit", the unit of its raw reading')
        if (self.is_ == "point") != (self.of is not None):
            raise ValueError('"is: point" and "of" belong together, for instance {is: point, of: load, unit: N}')
        if self.is_ == "point" and not self.unit and self.of not in {"cycles", "side"}:
            raise ValueError(f'the point "{self.of}" needs "unit"')
        if (self.is_ == "phase") != bool(self.marks):
            raise ValueError('"is: phase" and "marks" belong together')
        if self.is_ != "time" and (self.written != "number" or self.period is not None):
            raise ValueError(f'"{self.is_}" takes no "written" and no "period"')
        if (self.written == "index") != (self.period is not None):
            raise ValueError('"written: index" and "period" belong together, for instance "period: 1 ms"')
        if self.contraction is not None and self.is_ != "displacement":
            raise ValueError('"contraction" is for "is: displacement" only')
        given = SCALES & self.model_fields_set
        if not measured and given:
            raise ValueError(f'"{self.is_}" takes no "{min(given)}"')
        if self.late_by[0] > self.late_by[1]:
            raise ValueError('"late_by" is [least, most]')
        return self


def _column(value: Any) -> Any:
    return {"is": "ignore"} if value == "ignore" else value


Column = Annotated[ColumnFile, BeforeValidator(_column, json_schema_input_type=ColumnFile | Literal["ignore"])]
"""A column may be just `ignore`."""


class NameFile(Strict):
    """What the name of the file or folder contains, as forms with {placeholders} for numbers; `*` is any text."""

    of: Literal["file", "folder"] = "file"
    forms: Annotated[list[Annotated[str, Field(min_length=1, max_length=200)]], Field(min_length=1, max_length=20)]
    decimal: Literal["point", "comma"] = "point"
    units: dict[PointName, Short] = {}
    otherwise: dict[PointName, Reading] = {}
    """Values where the form that fits does not hold the placeholder."""


class Sampling(Strict):
    """What the time stamps should look like."""

    rate: tuple[Frequency, Frequency]
    gap: Time
    """Samples further apart have others missing between them."""
    leap: Time = 60.0
    """Further apart than this the clock itself leapt."""


class Trials(Strict):
    """How a file is cut into trials."""

    by: Literal["file", "step", "ramp", "sine", "gap", "column", "command", "record"]
    """The whole file; every step, or sine, of the command (of the measured pressure where none was recorded); every
    rise of the measured pressure with the fall after it; or between gaps in time. `column`: where the column of trials
    has the same number, not 0. `command`: from each rise of the pressure command out of its lowest level to the next.
    `record`: as run.json next to the file says, which `pmabench export` writes.
    """
    smallest: Pressure | None = None
    """Smallest change of pressure that is a step or a ramp; smallest sine, from peak to peak."""
    lead: Time = 0.0
    """A trial begins so long before its step."""
    longer_than: Time | None = None
    """Shortest gap that parts two trials."""
    point: dict[PointName, Reading] = {}
    phases: Annotated[dict[Short, Time], Field(max_length=20)] = {}
    """Name of each phase -> when it begins, where no column marks it."""

    @model_validator(mode="after")
    def _fits(self) -> Trials:
        if self.by in {"step", "ramp", "sine", "command"} and not self.smallest:
            raise ValueError(f'"by: {self.by}" needs "smallest", for instance "10 kPa"')
        if (self.by == "gap") != (self.longer_than is not None):
            raise ValueError('"by: gap" and "longer_than" belong together')
        return self


class TestFile(Strict):
    """One of several tests in a file; each becomes a run with a clock of its own."""

    name: Short
    """What takes the place of {test} in the names of the columns; where the header is repeated any name."""
    point: dict[PointName, Reading] = {}


class SpecimenText(Strict):
    """What is known of the muscle."""

    make: Text = ""
    type: Text
    serial: Text = "unknown"
    nominal_length: Length | None = None
    inner_diameter: Length | None = None


class AnalysisRule(Strict):
    """Which samples enter the fit, written down before anyone looks at the result."""

    force_above: Force = 0.0
    also_at: Annotated[list[Force], Field(max_length=20)] = []
    """Other thresholds, shown next to it."""
    phases: Annotated[list[Short], Field(max_length=20)] = []
    """Empty: all."""
    why: Text = ""


class MapFile(Strict):
    """The map of one layout of old files."""

    schema_: Annotated[Literal["pmabench.map/1"], Field(alias="schema")]
    name: Text
    source: Text
    """Who recorded such files, and where they are to be found."""
    kind: Annotated[str, Field(max_length=80)]
    """Kind of test: then the file is reduced as a run of this program is; or a kind of recording."""
    simulated: bool = False
    """The file holds no measurement but what a simulation made."""
    settings: Annotated[dict[Short, float | Text], Field(max_length=40)] = {}
    """Settings of the reduction in SI, as the protocol of the kind has them: `discard`, `turn`, `nominal_length` ..."""
    bench: Text = ""
    recorded: datetime.date | None = None
    """Day of the recording, where the name of the file does not contain it."""
    file: AnyLayout
    columns: Annotated[dict[Short, Column], Field(max_length=200)]
    tests: Annotated[list[TestFile], Field(max_length=200)] = []
    """Several tests in each file: names of columns that hold {test} are those of each test in turn; else in the order
    in which the header is repeated.
    """
    name_tells: NameFile | None = None
    notes: Annotated[str, Field(pattern=r"^[^/\\]{1,80}$")] | None = None
    """File next to it that holds notes, `*` is any text."""
    sampling: Sampling
    trials: Trials
    siblings: dict[Literal["pressure", "displacement", "force", "supply"], Ratio] = {}
    """How far the peak of a file may lie from those of other files at the same point."""
    specimen: SpecimenText
    analysis: AnalysisRule = AnalysisRule()
    confirmed: Annotated[list[Confirmable], Field(max_length=20)] = []
    """Kinds of findings that somebody has looked at and found right: they withhold nothing any more."""

    @model_validator(mode="after")
    def _roles(self) -> MapFile:
        roles = [f"point of {c.of}" if c.of else c.is_ for c in self.columns.values() if c.is_ != "ignore"]
        twice = sorted({role for role in roles if roles.count(role) > 1})
        if twice:
            raise ValueError(f'two columns are "{twice[0]}"')
        for role in ("time", "pressure"):
            if role not in roles:
                raise ValueError(f'no column is "{role}"')
        if self.trials.by == "column" and "trial" not in roles:
            raise ValueError('"by: column" needs a column that "is: trial"')
        (time,) = (column for column in self.columns.values() if column.is_ == "time")
        if "date" in roles and time.written != "clock":
            raise ValueError('a column of dates belongs to a time that is "written: clock"')
        if not self.file.holds_texts and time.written in ("clock", "date and time", "header step"):
            raise ValueError(f'"written: {time.written}" is for text; {self.file.format} holds numbers')
        if self.tests:
            placed = any(PLACE in name for name in self.columns)
            if placed == self.file.repeats:
                raise ValueError('"tests" needs either "{test}" in names of columns or "repeated_header: new test"')
            if len({test.name for test in self.tests}) < len(self.tests):
                raise ValueError("two tests have the same name")
        elif any(PLACE in name for name in self.columns):
            raise ValueError('"{test}" in the name of a column needs "tests"')
        return self
