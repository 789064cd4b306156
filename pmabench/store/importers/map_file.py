"""Import maps as strict models: the user's description of old files, with units and open questions.

A value that begins with `??` is an open question; the text after the marks is a provisional value. A comment above it
that begins with `??` is the question in words.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, Union, get_args

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from pmabench.base.errors import InvalidFile, Problem
from pmabench.files.document import Document, Location, Strict
from pmabench.files.quantity import AsText, Force, Frequency, Length, Pressure, Ratio, Time, raw_quantity
from pmabench.store.formats.record import Layout, formats
from pmabench.store.formats.text import Name as Short

_UNITS = {
    "s": ("time", "sec secs second seconds sekunden"),
    "ms": ("time", "msec msecs millisecond milliseconds"),
    "us": ("time", "usec microsecond microseconds µs μs"),
    "ns": ("time", "nsec nanosecond nanoseconds"),
    "min": ("time", "minute minutes minuten"),
    "h": ("time", "hr hrs hour hours stunde stunden std"),
    "d": ("time", "day days tage"),
    "Pa": ("pressure", "pascal pascals"),
    "kPa": ("pressure", "kilopascal kilopascals kpa"),
    "MPa": ("pressure", "megapascal mpa"),
    "hPa": ("pressure", "hectopascal"),
    "mbar": ("pressure", "millibar"),
    "bar": ("pressure", "bars barg bar(g) bar_g"),
    "psi": ("pressure", "psig psi(g) lbf/in2 lb/in2 lbf/in^2 lb/in^2 lbf/in² lb/in²"),
    "kgf/cm2": ("pressure", "kgf/cm^2 kgf/cm² kg/cm2 kg/cm^2 kg/cm² kp/cm2 kp/cm^2 kp/cm² ksc"),
    "N/mm2": ("pressure", "n/mm^2 n/mm²"),
    "atm": ("pressure", "atmosphere atmospheres"),
    "mmHg": ("pressure", "torr mm_hg"),
    "inHg": ("pressure", "in_hg"),
    "N": ("force", "newton newtons"),
    "kN": ("force", "kilonewton kilonewtons kn"),
    "mN": ("force", "millinewton millinewtons"),
    "daN": ("force", "decanewton"),
    "lbf": ("force", "lb lbs pound pounds"),
    "g": ("mass", "gram grams gramm"),
    "kg": ("mass", "kilogram kilograms kgs"),
    "kgf": ("force", "kp kilopond kg-f kg_f"),
    "gf": ("force", "pond g-f"),
    "ozf": ("force", "oz"),
    "mm": ("length", "millimeter millimeters millimetre millimetres"),
    "cm": ("length", "centimeter centimeters centimetre centimetres"),
    "m": ("length", "meter meters metre metres"),
    "um": ("length", "micrometer micron microns µm μm"),
    "in": ("length", "inch inches"),
    "ft": ("length", "foot feet"),
    "kg/s": ("flow", ""),
    "g/s": ("flow", ""),
    "g/min": ("flow", ""),
    "kg/h": ("flow", ""),
    "V": ("reading", "volt volts"),
    "mV": ("reading", "millivolt millivolts mvolt mvolts"),
    "A": ("reading", "amp amps ampere amperes"),
    "mA": ("reading", "milliamp milliamps milliampere milliamperes ma"),
    "count": ("reading", "counts digit digits raw adc lsb"),
    "degC": ("", "°c degc celsius"),
    "Hz": ("", "hertz hz"),
    "%": ("", "percent"),
}
"""Unit -> its quantity (empty: not used here), and other spellings."""
_KNOWN = {name: name for name in _UNITS} | {
    spelling: name for name, (_, spellings) in _UNITS.items() for spelling in spellings.split()
}
QUANTITY = {name: quantity for name, (quantity, _) in _UNITS.items() if quantity}
"""Unit -> its quantity; `reading`: the output of a sensor, which needs a calibration."""


def spelled(text: str) -> str:
    """A unit in pmabench's spelling, or empty if not known; an exact match comes before one that ignores case."""
    text = text.strip().strip("[](){}").strip()
    return _KNOWN.get(text) or _KNOWN.get(text.lower(), "")


OPEN = "??"
"""Mark of an open question at the beginning of a value."""


@dataclass(frozen=True)
class Question:
    """An open question of a map or an import."""

    what: str
    """Key in the map, for instance `columns.F.unit`."""
    where: str
    """`path:line:column`."""
    question: str
    used: str
    """Provisional value until it is answered; empty for none."""


def settle(
    document: Document, answers: Sequence[tuple[str, str]] = (), *, unresolved: bool = False
) -> tuple[Question, ...]:
    """Put the answers (key, value) into a map's data; returns the questions for which provisional values were used.

    An answer may also change a key that is no question. Raises InvalidFile with every unanswered question; with
    `unresolved` only with those without a provisional value.
    """
    asked = {question.what: (location, question) for location, question in _asked(document)}
    for key, text in answers:
        location = asked.pop(key)[0] if key in asked else _located(document.data, key)
        document.put(location, text, f"--set {key}")
    left, problems = list[Question](), list[Problem]()
    for key, (location, question) in asked.items():
        if unresolved and question.used:
            left.append(question)
            quoted = "'" + question.used.replace("'", "''") + "'"
            document.put(location, quoted, document.path)
            continue
        more = f"; --unresolved takes {question.used} until then" if question.used and not unresolved else ""
        sentence = f"not answered: {question.question}; write the answer here, or give --set '{key}=...'{more}"
        problems.append(document.problem(location, sentence))
    if problems:
        raise InvalidFile(problems)
    return tuple(left)


def _located(data: Any, key: str) -> Location:
    """Location of a dotted key; names of columns may contain dots."""
    if isinstance(data, Mapping):
        for name in sorted(map(str, data), key=len, reverse=True):
            if key == name:
                return (name,)
            if key.startswith(f"{name}."):
                return (name, *_located(data[name], key[len(name) + 1 :]))
    first, _, rest = key.partition(".")
    part = int(first) if isinstance(data, list) and first.isdecimal() else first
    inside = data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else None
    return (part, *(_located(inside, rest) if rest else ()))


def questions_of(document: Document) -> list[Question]:
    """Every open question of a map, in order."""
    return [question for _, question in _asked(document)]


def _asked(document: Document) -> Iterator[tuple[Location, Question]]:
    for location in left_open(document.data, ()):
        used = str(_at(document.data, location))[len(OPEN) :].strip()
        yield location, Question(dotted(location), document.where(location), _question(document, location), used)


def left_open(value: Any, location: Location) -> Iterator[Location]:
    """Locations of values that begin with `??`."""
    if isinstance(value, str) and value.startswith(OPEN):
        yield location
    elif isinstance(value, Mapping | list):
        for key, inside in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from left_open(inside, (*location, key))


def dotted(location: Location) -> str:
    """A location in the form that users type: `columns.F.unit`."""
    return ".".join(str(part) for part in location)


def _question(document: Document, location: Location) -> str:
    """The question in the `??` comments right above a location; a default text without one."""
    path, line, _ = document.place(location)
    lines = document.texts.get(path, "").split("\n")[: line - 1]
    found: list[str] = []
    while lines and (text := lines.pop().strip()).startswith("#"):
        if text.removeprefix("#").strip().startswith(OPEN):
            found.insert(0, text.removeprefix("#").strip()[len(OPEN) :].strip())
    return " ".join(found) or "no file gives it"


def _at(data: Any, location: Location) -> Any:
    for part in location:
        data = data[part]
    return data


Reading = Annotated[tuple[float, str], AsText(raw_quantity, "a number with its unit", "4 mA", "0.683 N/count")]
"""A number and its unit, not converted."""
PLACE = "{test}"
"""Placeholder for the name of the test in the name of a column."""
Text = Annotated[str, Field(max_length=600)]
Role = Literal[
    "time", "date", "pressure", "displacement", "force", "pressure_command", "displacement_command", "supply", "flow",
    "angle", "phase", "trial", "point", "flags", "simulated", "ignore",
]  # fmt: skip
Written = Literal[
    "number", "index", "header step", "clock", "date and time", "epoch", "serial days", "matlab days", "labview"
]
SCALES = {"points", "line", "recorded_with", "contraction", "range", "dropout", "spike"}
"""Entries that only a measured or commanded column can have."""
Confirmable = Literal[
    "absolute", "counts", "force-unit", "gain", "jump", "lag", "length-unit", "magnitude", "pressure-unit", "scale",
    "sibling", "swap", "time-unit",
]  # fmt: skip
NUMBERS = frozenset(("phase", "trial", "flags", "simulated", "ignore"))
"""Roles of columns that are not measured, and have neither unit nor scale."""
PointName = Literal[
    "contraction", "load", "mass", "pressure", "frequency", "speed", "lower", "upper", "start", "step", "mean",
    "amplitude", "cycles", "side", "setpoint", "bias", "tip_mass",
]  # fmt: skip


def made(column: str) -> str:
    """The coordinate for a constant column that no file has (`@pressure` -> `pressure`); else empty."""
    return column[1:] if column.startswith("@") and column[1:] in get_args(PointName) else ""


def _format(value: Any) -> str:
    return str(value.get("format", "text") if isinstance(value, dict) else getattr(value, "format", "text"))


if TYPE_CHECKING:
    AnyLayout: TypeAlias = Layout
else:
    _layouts = tuple(Annotated[each.layout, Tag(name)] for name, each in formats().items())
    AnyLayout = Annotated[Union[_layouts], Discriminator(_format)]  # noqa: UP007
    """Layout of a file, with the options of its format."""


class Line(Strict):
    """A straight line: value = slope x reading + offset."""

    slope: Reading
    """For instance `0.683 N/count`."""
    offset: Reading


class Contraction(Strict):
    """How a displacement sensor shows contraction, which is positive when the muscle shortens."""

    reading: Literal["falls", "rises"]
    """Direction of the reading while the muscle shortens."""
    zero: Reading
    """Reading at zero contraction."""


class ColumnFile(Strict):
    """Role of one column, and conversion of its numbers to SI."""

    is_: Annotated[Role, Field(alias="is")]
    of: PointName | None = None
    """With `is: point`: which coordinate of the operating point."""
    unit: Short = ""
    """Unit of the raw reading: `mA`, `count`, `ms`, `kPa` ..."""
    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)] | None = None
    line: Line | None = None
    recorded_with: Line | None = None
    """Line with which the values in the file were computed from readings; the readings are recovered first."""
    whole: bool = False
    """Whether the reading is a whole number of counts."""
    contraction: Contraction | None = None
    range: tuple[Reading, Reading] | None = None
    dropout: Reading | None = None
    """Reading of a broken wire."""
    stale_after: Time | None = None
    spike: Reading | None = None
    """Largest distance of a single sample from its neighbours; by default from the scatter of the channel."""
    late_by: tuple[Time, Time] = (0.0, 0.0)
    """Least and largest delay of a value relative to its time stamp."""
    expanded_uncertainty: Reading | None = None
    gain_uncertainty: Ratio = 0.0
    sensor_lag: Annotated[Time, Field(ge=0.0)] = 0.0
    """Time constant of the sensor."""
    reference: Text = ""
    """Source of the scale."""
    written: Written = "number"
    """Form of a column of time.

    `number` counts units from any zero; `index` counts samples, `period` apart; `header step` counts samples with Start
    and Increment from the header; `clock` is HH:MM:SS, within one day or with a column
    `is: date`; `date and time` has both in one text; `epoch` counts units since 1970, `labview` seconds since 1904;
    `serial days` and `matlab days` count days, as in spreadsheets and datenum.
    """
    order: Literal["year first", "day first", "month first"] = "year first"
    """Order of a date whose year comes last, as in 01/03/2024."""
    period: Annotated[Time, Field(gt=0.0)] | None = None
    """Sampling period for `written: index`."""
    marks: Annotated[dict[Short, Annotated[int, Field(ge=-1000, le=1000)]], Field(max_length=20)] = {}
    """For a phase column: name of the phase -> its number."""
    optional: bool = False
    """Whether the column may be missing in some files."""

    @model_validator(mode="after")
    def _fits(self) -> ColumnFile:
        measured = self.is_ not in {"time", "date", "point"} | NUMBERS
        if self.points is not None and self.line is not None:
            raise ValueError('give "points" or "line", not both')
        if (measured or (self.is_ == "time" and self.written in ("number", "epoch"))) and not self.unit:
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
"""A column; the word `ignore` may replace its entries."""


class NameFile(Strict):
    """Data in the name of the file or folder: forms with {placeholders} for numbers; `*` is any text."""

    of: Literal["file", "folder"] = "file"
    forms: Annotated[list[Annotated[str, Field(min_length=1, max_length=200)]], Field(min_length=1, max_length=20)]
    decimal: Literal["point", "comma"] = "point"
    units: dict[PointName, Short] = {}
    otherwise: dict[PointName, Reading] = {}
    """Values for placeholders that the matching form does not have."""


class Sampling(Strict):
    """Expected properties of the time stamps."""

    rate: tuple[Frequency, Frequency]
    gap: Time
    """Longest interval without missing samples."""
    leap: Time = 60.0
    """A longer interval is a jump of the clock."""


class Trials(Strict):
    """How a file is cut into trials."""

    by: Literal["file", "step", "level", "ramp", "sine", "gap", "column", "command"]
    """`file`: the whole file. `step`, `sine`: every step or sine of the command (of the measured pressure if none was
    recorded). `level`: every stretch between such steps, at one pressure. `ramp`: every rise of the measured pressure
    with the fall after it. `gap`: between gaps in time. `column`: while the column of trials has one number, not 0.
    `command`: from each rise of the pressure command out of its lowest level to the next.
    """
    smallest: Pressure | None = None
    """Smallest change of pressure that counts as a step or ramp; smallest sine, peak to peak."""
    lead: Time = 0.0
    """Time before its step at which a trial begins."""
    longer_than: Time | None = None
    """Shortest gap that separates two trials."""
    point: dict[PointName, Reading] = {}
    phases: Annotated[dict[Short, Time], Field(max_length=20)] = {}
    """Name of each phase -> when it begins, where no column marks it."""

    @model_validator(mode="after")
    def _fits(self) -> Trials:
        if self.by in {"step", "level", "ramp", "sine", "command"} and not self.smallest:
            raise ValueError(f'"by: {self.by}" needs "smallest", for instance "10 kPa"')
        if (self.by == "gap") != (self.longer_than is not None):
            raise ValueError('"by: gap" and "longer_than" belong together')
        return self


class Meter(Strict):
    """Data to calculate a volume from the mass measured by a flow meter; SI, half widths of 95 %."""

    dead: Annotated[float, Field(ge=0.0, le=0.1)]
    """Volume between meter and muscle."""
    dead_half: Annotated[float, Field(ge=0.0, le=0.1)]
    temperature: Annotated[float, Field(ge=250.0, le=350.0)] = 293.15
    """Temperature [K]; values in degrees Celsius are out of range."""
    temperature_half: Annotated[float, Field(ge=0.0, lt=50.0)] = 3.0


def _form(value: object) -> str:
    """Form of a setting, so that a mistake in it is reported once and not once for each form."""
    return "meter" if isinstance(value, dict | Meter) else "text" if isinstance(value, str) else "number"


Setting = Annotated[
    Annotated[float, Tag("number")] | Annotated[Text, Tag("text")] | Annotated[Meter, Tag("meter")],
    Discriminator(_form),
]


class TestFile(Strict):
    """One of several tests in a file; each becomes a run with its own clock."""

    name: Short
    """Text for {test} in the names of columns; any name where the header is repeated."""
    point: dict[PointName, Reading] = {}


class SpecimenText(Strict):
    """Data of the muscle."""

    make: Text = ""
    type: Text
    serial: Text = "unknown"
    nominal_length: Length | None = None
    inner_diameter: Length | None = None


class AnalysisRule(Strict):
    """Samples that enter the fit, decided before the result is known."""

    force_above: Force = 0.0
    also_at: Annotated[list[Force], Field(max_length=20)] = []
    """Other thresholds, whose results are shown for comparison."""
    phases: Annotated[list[Short], Field(max_length=20)] = []
    """Phases that enter the fit; empty for all."""
    why: Text = ""


class MapFile(Strict):
    """The map of one layout of old files."""

    schema_: Annotated[Literal["pmabench.map/1"], Field(alias="schema")]
    name: Text
    source: Text
    """Who recorded these files, and where they are available."""
    kind: Annotated[str, Field(max_length=80)]
    """Kind of test, with the same reduction as runs of this program; or a kind of recording."""
    simulated: bool = False
    """Whether the file contains simulated data."""
    settings: Annotated[dict[Short, Setting], Field(max_length=40)] = {}
    """Settings of the reduction in SI, as in the protocol of this kind: `discard`, `turn`, `nominal_length` ..."""
    bench: Text = ""
    recorded: datetime.date | None = None
    """Day of the recording, if the name of the file does not contain it."""
    file: AnyLayout
    columns: Annotated[dict[Short, Column], Field(max_length=200)]
    tests: Annotated[list[TestFile], Field(max_length=200)] = []
    """Several tests in each file: by names of columns with {test}, or in the order of the repeated headers.
    """
    from_name: Annotated[NameFile | None, Field(alias="name_tells")] = None
    notes: Annotated[str, Field(pattern=r"^[^/\\]{1,80}$")] | None = None
    """File with notes next to the data file; `*` is any text."""
    sampling: Sampling
    trials: Trials
    siblings: dict[Literal["pressure", "displacement", "force", "supply"], Ratio] = {}
    """Largest relative difference of a file's peak from other files at the same operating point."""
    specimen: SpecimenText
    analysis: AnalysisRule = AnalysisRule()
    confirmed: Annotated[list[Confirmable], Field(max_length=20)] = []
    """Kinds of findings that were checked and confirmed as correct: they no longer withhold results."""

    @model_validator(mode="after")
    def _roles(self) -> MapFile:
        roles = [f"point of {c.of}" if c.of else c.is_ for c in self.columns.values() if c.is_ != "ignore"]
        twice = sorted({role for role in roles if roles.count(role) > 1})
        if twice:
            raise ValueError(f'two columns are "{twice[0]}"')
        for role in ("time", "pressure"):
            if role not in roles:
                hint = "; one that was constant, and that no column has, is said with a column of its own: "
                hint += '"@pressure": {is: pressure, unit: kPa}, and trials: {point: {pressure: 300 kPa}}'
                raise ValueError(f'no column is "{role}"{hint if role == "pressure" else ""}')
        if self.trials.by == "column" and "trial" not in roles:
            raise ValueError('"by: column" needs a column that "is: trial"')
        (time,) = (column for column in self.columns.values() if column.is_ == "time")
        if "date" in roles and time.written != "clock":
            raise ValueError('a column of dates belongs to a time that is "written: clock"')
        if not self.file.holds_texts and time.written in ("clock", "date and time", "header step"):
            raise ValueError(f'"written: {time.written}" is for text; {self.file.format} holds numbers')
        if self.tests:
            if any(PLACE in name for name in self.columns) == self.file.repeats:
                raise ValueError('"tests" needs either "{test}" in names of columns or "repeated_header: new test"')
            if len({test.name for test in self.tests}) < len(self.tests):
                raise ValueError("two tests have the same name")
        elif any(PLACE in name for name in self.columns):
            raise ValueError('"{test}" in the name of a column needs "tests"')
        return self
