"""An import map as plain SI rules, with scales, ranges, limits and names resolved; mistakes have their place.

Reads only the map, no data.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, get_args

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.kind import Imported
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.files.document import Document, Location, read_document, validate
from pmabench.files.quantity import unit_factor
from pmabench.store.analyses.results import POINT_QUANTITIES
from pmabench.store.formats.record import TIME
from pmabench.store.formats.text import Stamps
from pmabench.store.importers import map_file
from pmabench.store.importers.map_file import NUMBERS, PLACE, ColumnFile, MapFile, Question, Trials, made, settle

POINT_QUANTITY = {name: POINT_QUANTITIES[name] for name in get_args(map_file.PointName)}
"""Coordinate of an operating point that a map can name -> its quantity."""
G = 9.80665
"""Standard gravity [m/s2], for a load that is given as a mass."""
NUMBER = r"(?<![\d.,])(?<!\dp)(?:(?<![^_ =(])-)?\d+(?:[.,p]\d+)?"
"""A number in a name: `8`, `0.5`, `0,5`, `0p5`; also `-8` after a separator, else the minus is a separator."""
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}|(\*)")
_SPECIAL = {"test": r"\d{1,6}", "date": r"\d{4}-\d{2}-\d{2}", "clock": r"\d{6}"}


@dataclass(frozen=True)
class ColumnRule:
    """One column: raw reading = (number in the file - back[1]) / back[0]; SI = slope x raw + offset."""

    column: str
    role: str
    raw_unit: str = ""
    slope: float = 1.0
    offset: float = 0.0
    back: tuple[float, float] = (1.0, 0.0)
    whole: bool = False
    low: float = -inf
    high: float = inf
    dropout: float | None = None
    """Raw reading of a broken wire."""
    stale_after: float | None = None
    spike: float | None = None
    """Largest distance of a single sample from its neighbours [SI]; None: from the scatter of the channel."""
    late_by: tuple[float, float] = (0.0, 0.0)
    optional: bool = False
    marks: Mapping[float, str] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantity(self) -> str:
        """Key of `QUANTITIES`."""
        return CHANNEL_QUANTITY[self.role]

    @property
    def is_channel(self) -> bool:
        """Whether it is measured or commanded, and so is stored as a channel of the run."""
        return self.role in CHANNEL_QUANTITY

    def record(self, whole: bool) -> dict[str, Any]:
        """The column for `RunWriter.open_stream`; `whole`: stored as int32 counts."""
        return {
            "name": self.role,
            "quantity": self.quantity,
            "device": "imported",
            "input": self.column,
            "raw_type": "int32" if whole else "float64",
            "raw_unit": self.raw_unit,
            "scale": {"slope": self.slope, "offset": self.offset},
            "low": None if self.low == -inf else self.low,
            "high": None if self.high == inf else self.high,
            "reference": "gauge",
            "calibration": dict(self.calibration),
        }


@dataclass(frozen=True)
class NameRule:
    """Rules for the name of a file or folder: forms as patterns of bounded time, and factors to SI."""

    of: str
    forms: tuple[re.Pattern[str], ...]
    factors: Mapping[str, float]
    otherwise: Mapping[str, float]


@dataclass(frozen=True)
class ImportMap:
    """A map ready to use: `file` as written, and all values with units in SI."""

    path: str
    texts: Mapping[str, str]
    file: MapFile
    test: Imported
    """What the kind of test needs from a file."""
    columns: tuple[ColumnRule, ...]
    """Columns that are not ignored."""
    ignored: tuple[str, ...]
    name_rule: NameRule | None
    point: Mapping[str, float]
    stamps: Stamps
    tests: Mapping[str, Mapping[str, float]]
    """Name of each of several tests in a file -> its operating point [SI]."""
    unresolved: tuple[Question, ...]
    """Open questions, with the provisional values used."""

    @property
    def trials(self) -> Trials:
        """How a file is cut into trials."""
        return self.file.trials

    def each_test(self) -> list[ImportMap]:
        """A map for each test, if column names contain {test}; else the map itself."""
        if not any(PLACE in column.column for column in self.columns):
            return [self]
        return [self._named(test) for test in self.tests]

    def of_test(self, number: int, rules: ImportMap) -> ImportMap:
        """`rules` with the operating point of a test added."""
        points = list(self.tests.values())
        return replace(rules, point={**rules.point, **points[number]}) if points else rules

    def _named(self, test: str) -> ImportMap:
        """The map for the columns of one test; those of the others are ignored."""

        def named(column: str) -> str:
            return column.replace(PLACE, test)

        columns = tuple(replace(column, column=named(column.column)) for column in self.columns)
        every = (*(column.column for column in self.columns), *self.ignored)
        others = dict.fromkeys(name.replace(PLACE, each) for name in every for each in self.tests)
        ignored = tuple(name for name in others if name not in {column.column for column in columns})
        stamps = replace(self.stamps, column=named(self.stamps.column), date=named(self.stamps.date))
        return replace(self, columns=columns, ignored=ignored, stamps=stamps)

    def column(self, role: str) -> ColumnRule | None:
        """The column with a role; None without one."""
        return next((column for column in self.columns if column.role == role), None)


def read_map(
    path: Path, kinds: Mapping[str, Imported], answers: Sequence[tuple[str, str]] = (), *, unresolved: bool = False
) -> ImportMap:
    """Read a map file; raises InvalidFile with every mistake, or every open question, at file:line:column.

    `kinds`: kind of test -> what it needs from a file. `answers`: (key, value) for open questions. With `unresolved`
    the map's provisional values are used for the other questions, which `ImportMap.unresolved` lists.
    """
    document = read_document(path)
    left = settle(document, answers, unresolved=unresolved)
    kind, unknown = str(document.data.get("kind", "")), list[Problem]()
    if kind and kind not in kinds:
        unknown.append(document.problem(("kind",), f'"{kind}" is not known here{did_you_mean(kind, kinds)}'))
    try:
        file = validate(MapFile, document)
    except InvalidFile as error:
        raise InvalidFile([*error.problems, *unknown]) from None
    return _Rules(document, file, unknown).build(kinds.get(kind, Imported()), left)


class _Rules:
    """Converts one validated map into rules and collects its problems."""

    def __init__(self, document: Document, file: MapFile, problems: list[Problem]) -> None:
        self.document, self.file, self.problems = document, file, problems

    def fault(self, location: Location, message: str) -> None:
        self.problems.append(self.document.problem(location, message))

    def si(self, reading: tuple[float, str], quantity: str, location: Location) -> float:
        try:
            return reading[0] * factor_of(reading[1], quantity)
        except ValueError as error:
            self.fault(location, str(error))
            return 0.0

    def build(self, test: Imported, unresolved: tuple[Question, ...]) -> ImportMap:
        file = self.file
        self.check_names()
        columns = [self.column(name, c) for name, c in file.columns.items() if c.is_ != "ignore"]
        self.check_columns(columns)
        built = ImportMap(
            path=self.document.path,
            texts=dict(self.document.texts),
            file=file,
            test=test,
            columns=tuple(columns),
            ignored=tuple(name for name, column in file.columns.items() if column.is_ == "ignore"),
            name_rule=self.name_rule(),
            point=self.point(file.trials.point, ("trials", "point")),
            stamps=self.stamps(),
            tests={each.name: self.point(each.point, ("tests", k, "point")) for k, each in enumerate(file.tests)},
            unresolved=unresolved,
        )
        if self.problems:
            raise InvalidFile(self.problems)
        return built

    def check_names(self) -> None:
        """Report names that appear only in the layout or only in the columns."""
        layout, columns = self.file.file, self.file.columns
        for name in columns if layout.given else ():
            if not (layout.period and name == TIME) and not made(name) and name not in layout.given:
                self.fault(("columns", name), f'no column is called "{name}"{did_you_mean(name, layout.given)}')
        for index, name in enumerate(layout.given):
            if name not in columns:
                self.fault(("file", "names", index), f'"columns" does not say what "{name}" is; it may be "ignore"')

    def check_columns(self, columns: Sequence[ColumnRule]) -> None:
        """Report phases and channels that other parts of the map name but no column has, and a wrong rate."""
        file = self.file
        phases = {*file.trials.phases, *(mark for c in columns for mark in c.marks.values())}
        phases |= {"fill", "exhaust"} if file.trials.by == "ramp" else set()
        for index, phase in enumerate(file.analysis.phases):
            if phase not in phases:
                self.fault(("analysis", "phases", index), f'no phase is called "{phase}"{did_you_mean(phase, phases)}')
        if file.sampling.rate[0] > file.sampling.rate[1]:
            self.fault(("sampling", "rate"), "is [least, most]")
        for channel in set(file.siblings) - {column.role for column in columns}:
            self.fault(("siblings", channel), f'no column is "{channel}"')

    def point(self, given: Mapping[Any, tuple[float, str]], at: Location) -> dict[str, float]:
        """An operating point [SI]."""
        return {name: number * self.of_point(name, unit, (*at, name)) for name, (number, unit) in given.items()}

    def column(self, name: str, file: ColumnFile) -> ColumnRule:
        at: Location = ("columns", name)
        if file.is_ in NUMBERS or file.is_ == "date":
            marks = {float(mark): name for name, mark in file.marks.items()}
            return ColumnRule(name, file.is_, optional=file.optional and file.is_ != "date", marks=marks)
        if file.of is not None:
            slope = self.of_point(file.of, file.unit, (*at, "unit"))
            return ColumnRule(name, f"point of {file.of}", file.unit, slope, optional=file.optional)
        if file.is_ == "time":
            slope = self.si((1.0, file.unit), "time", (*at, "unit")) if file.written == "number" else 1.0
            return ColumnRule(name, "time", file.unit, slope, optional=False)
        return self.channel(name, file, CHANNEL_QUANTITY[file.is_], at)

    def channel(self, name: str, file: ColumnFile, quantity: str, at: Location) -> ColumnRule:
        """The rule of a measured or commanded column."""
        slope, offset, bend = self.scale(file, quantity, at)
        if slope == 0:
            self.fault(at, "has a scale of slope 0: every reading would be the same")
            slope = 1.0
        if file.contraction is not None:
            zero = self.raw(file.contraction.zero, file.unit, (*at, "contraction", "zero")) or 0.0
            slope = abs(slope) * (-1.0 if file.contraction.reading == "falls" else 1.0)
            offset = -slope * zero
        known = file.expanded_uncertainty
        uncertainty = 0.0 if known is None else self.si(known, quantity, (*at, "expanded_uncertainty"))
        if bend > uncertainty:
            text = f"bend away from a straight line by {show(bend, quantity, 3)}, more than expanded_uncertainty"
            self.fault((*at, "points"), text)
        scale = file.unit, quantity, slope, offset
        ends = [self.limit(end, scale, (*at, "range", k)) for k, end in enumerate(file.range or ())] or [-inf, inf]
        return ColumnRule(
            column=name,
            role=file.is_,
            raw_unit=file.unit,
            slope=slope,
            offset=offset,
            back=self.back(file, at),
            low=min(ends),
            high=max(ends),
            dropout=self.raw(file.dropout, file.unit, (*at, "dropout")),
            spike=None if file.spike is None else abs(self.limit(file.spike, (*scale[:3], 0.0), (*at, "spike"))),
            **{key: getattr(file, key) for key in ("whole", "stale_after", "late_by", "optional")},
            calibration={
                "id": f"{Path(self.document.path).name}: {name}",
                "reference": file.reference,
                "date": "",
                "valid_until": "",
                "offset_uncertainty": uncertainty,
                "gain_uncertainty": file.gain_uncertainty,
                "sensor_lag": file.sensor_lag,
                "sha256": "",
            },
        )

    def stamps(self) -> Stamps:
        """Form of the time column, and the column of its dates."""
        names = {c.is_: name for name, c in self.file.columns.items() if c.is_ in ("time", "date")}
        time = self.file.columns[names["time"]]
        dated = self.file.columns.get(names.get("date", ""), time)
        counted = time.written == "epoch"
        unit = self.si((1.0, time.unit), "time", ("columns", names["time"], "unit")) if counted else 1.0
        return Stamps(names["time"], time.written, unit, names.get("date", ""), dated.order, time.period or 0.0)

    def of_point(self, name: str, unit: str, location: Location) -> float:
        """Factor from `unit` to SI for a coordinate of the operating point; a load in kg or g counts as its weight."""
        if name == "load" and unit in ("kg", "g"):
            return G * self.si((1.0, unit), "mass", location)
        if POINT_QUANTITY[name] == "count" and unit in ("", "1"):
            return 1.0
        return self.si((1.0, unit), POINT_QUANTITY[name], location)

    def scale(self, file: ColumnFile, quantity: str, at: Location) -> tuple[float, float, float]:
        """Slope [SI per raw unit], offset [SI], and largest distance of a calibration point from that line [SI]."""
        if file.line is not None:
            slope = self.per(file.line.slope, file.unit, (*at, "line", "slope"))
            si = self.si(slope, quantity, (*at, "line", "slope")) if slope[1] else 0.0
            return si, self.si(file.line.offset, quantity, (*at, "line", "offset")), 0.0
        if file.points is None:
            return self.si((1.0, file.unit), quantity, (*at, "unit")), 0.0, 0.0
        raw = [self.raw(p[0], file.unit, (*at, "points", i, 0)) or 0.0 for i, p in enumerate(file.points)]
        value = [self.si(p[1], quantity, (*at, "points", i, 1)) for i, p in enumerate(file.points)]
        if len(set(raw)) < 2:
            self.fault((*at, "points"), "need two different readings")
            return 1.0, 0.0, 0.0
        mean = sum(raw) / len(raw)
        slope_si, middle = np.polyfit(np.array(raw) - mean, value, 1)
        offset = float(middle - slope_si * mean)
        bend = float(np.abs(np.array(raw) * slope_si + offset - value).max())
        return float(slope_si), offset, 0.0 if bend < 1e-9 * max(map(abs, value)) else bend

    def raw(self, reading: tuple[float, str] | None, unit: str, at: Location) -> float | None:
        """A reading, which must be in the raw unit of its column; None where none is given."""
        if reading is not None and reading[1] != unit:
            self.fault(at, f'is a reading in {unit}, not in {reading[1]}; write for instance "{reading[0]:g} {unit}"')
        return None if reading is None else reading[0]

    def per(self, slope: tuple[float, str], unit: str, at: Location) -> tuple[float, str]:
        """Number and numerator unit of a slope such as `0.683 N/count`."""
        upper = slope[1].removesuffix(unit).rstrip()
        if upper == slope[1] or not upper.removesuffix("/") or not upper.endswith("/"):
            self.fault(at, f'is so much per {unit}, for instance "0.683 N/{unit}"')
            return slope[0], ""
        return slope[0], upper[:-1].strip()

    def back(self, file: ColumnFile, at: Location) -> tuple[float, float]:
        if file.recorded_with is None:
            return (1.0, 0.0)
        line = file.recorded_with
        slope, unit = self.per(line.slope, file.unit, (*at, "recorded_with", "slope"))
        if unit and line.offset[1] != unit:
            self.fault((*at, "recorded_with", "offset"), f"is in {unit}, as the slope is, not in {line.offset[1]}")
        if slope == 0:
            self.fault((*at, "recorded_with", "slope"), "of 0 cannot be turned back")
            slope = 1.0
        return (slope, line.offset[0])

    def limit(self, reading: tuple[float, str], scale: tuple[str, str, float, float], at: Location) -> float:
        """A value [SI] from the raw unit or a unit of the quantity; `scale`: raw unit, quantity, slope and offset."""
        unit, quantity, slope, offset = scale
        return slope * reading[0] + offset if reading[1] == unit else self.si(reading, quantity, at)

    def name_rule(self) -> NameRule | None:
        file = self.file.from_name
        if file is None:
            return None
        forms = []
        for index, form in enumerate(file.forms):
            try:
                forms.append(form_pattern(form, file.decimal == "comma"))
            except ValueError as error:
                self.fault(("name_tells", "forms", index), str(error))
        for name in sorted({name for form in forms for name in form.groupindex} - {*_SPECIAL, *file.units}):
            self.fault(("name_tells", "units"), f'the unit of "{name}" is missing')
        factors = {str(of): self.of_point(of, unit, ("name_tells", "units", of)) for of, unit in file.units.items()}
        return NameRule(file.of, tuple(forms), factors, self.point(file.otherwise, ("name_tells", "otherwise")))


def factor_of(unit: str, quantity: str) -> float:
    """Factor from `unit` to SI; raises ValueError where the unit is unknown or ambiguous."""
    if quantity == "frequency" and unit.replace(" ", "") == "1/s":
        raise ValueError('"1/s" may mean Hz or rad/s; write which')
    return unit_factor(unit, quantity)


def number_in(text: str) -> float:
    """Value of a number in a name, where `p` or a comma may stand for the point: `8p5` is 8.5."""
    return float(re.sub("[,p]", ".", text))


def form_pattern(form: str, comma: bool) -> re.Pattern[str]:
    """A form such as `Kinked{contraction}mm_Test{test}` as a pattern with a group for each placeholder.

    At most two `*`, and text between placeholders, so that the time for matching is bounded; else ValueError.
    """
    number = rf"[+-]?\d{{1,9}}(?:[{',' if comma else ''}.p]\d{{1,9}})?"
    parts, names, end = list[str](), list[str](), 0
    for match in _PLACEHOLDER.finditer(form):
        if match.start() == end and end > 0:
            raise ValueError("two placeholders need some text between them")
        parts.append(re.escape(form[end : match.start()]))
        end, name = match.end(), match[1]
        if match[2]:
            parts.append(".*")
            continue
        if name not in POINT_QUANTITY and name not in _SPECIAL:
            raise ValueError(f'unknown placeholder "{name}"{did_you_mean(name, [*POINT_QUANTITY, *_SPECIAL])}')
        if name in names:
            raise ValueError(f'"{{{name}}}" is there twice')
        names.append(name)
        parts.append(f"(?P<{name}>{_SPECIAL.get(name, number)})")
    if parts.count(".*") > 2:
        raise ValueError('at most two "*"')
    return re.compile("".join(parts) + re.escape(form[end:]))
