"""Data of a guess, and the roles of columns (time, pressure, force ...) by name and unit; a time also by its numbers.

Pure functions of names and arrays; reads no file. Every choice has reasons, and doubts where it is weak.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import get_args

import numpy as np

from pmabench.base.kind import Imported
from pmabench.store.formats.record import Layout
from pmabench.store.importers.map_file import QUANTITY, PointName, spelled
from pmabench.store.records import Array

STILL = 3e-4
"""Largest range of a length that counts as held [m]."""
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "in": 0.0254}


@dataclass
class Proposal:
    """Probable meaning of one column."""

    name: str
    values: Array
    role: str = "ignore"
    unit: str = ""
    """Unit in pmabench's spelling; empty where unknown."""
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    middles: list[float] = field(default_factory=list)
    """Its median in each of the other files."""
    question: str = ""
    """Question about its role or unit, where the choice is open; else empty."""
    written: str = "number"
    """How a time is written, as in a map; empty where it may be days or a plain number."""
    order: str = ""
    """Order of day and month in dates whose year comes last; `??` where the file does not show it."""
    period: float = 0.0
    """Sampling period [s] of a column that counts samples; 0 where the file does not give it."""
    bare: bool = False
    """Whether the file gives it no name, or one for all columns of a matrix."""
    factor: str = ""
    """Factor of the unit in its heading, as written: `x10`, `/10`; empty for none."""
    strange: str = ""
    """Text in place of a unit that is not recognised."""
    extra: dict[str, str] = field(default_factory=dict)
    """Further known entries for the map."""

    @property
    def good(self) -> Array:
        """The finite values."""
        return self.values[np.isfinite(self.values)]

    @property
    def whole(self) -> bool:
        """Whether it has whole numbers only, and more than 12 different ones."""
        good = self.good
        return len(good) > 0 and bool(np.all(good == np.round(good))) and len(np.unique(good)) > 12

    @property
    def apart(self) -> bool:
        """Whether it is a length with different medians in different files."""
        middles = [*self.middles, *([float(np.median(self.good))] if len(self.good) else [])]
        return len(middles) > 1 and float(np.ptp(middles)) > STILL / METRES.get(self.unit, 1e-3)


@dataclass(frozen=True)
class Names:
    """Information in the names of files or folders."""

    of: str = "file"
    forms: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    comma: bool = False
    """Whether numbers have a decimal comma."""
    asked: Mapping[str, str] = field(default_factory=dict)
    """Key of a form -> reason to ask whether the number has this meaning."""
    keys: Set[str] = frozenset()


@dataclass
class Guess:
    """All that was found; `columns` in the order of the file."""

    files: list[Path]
    layout: Layout
    columns: list[Proposal]
    left_out: list[str]
    kinds: Mapping[str, Imported]
    """Kind of test -> what it needs from a file."""
    kind: str = ""
    trials: dict[str, str] = field(default_factory=dict)
    """Entries of the map's `trials`, as text."""
    smallest_of: str = "pressure_command"
    """Role of the channel in whose unit `smallest` of `trials` is given."""
    names: Names = field(default_factory=Names)
    """Of the files or their folders; without forms if they give nothing."""
    rate: tuple[float, float] = (1.0, 1000.0)
    gap: float = 1.0
    reasons: dict[str, list[str]] = field(default_factory=dict)
    """Part of the map (`file`, `sampling`, `trials`, `name_tells`) -> reasons."""
    doubts: list[str] = field(default_factory=list)
    frequency: float = 0.0
    """Frequency of a command that is a single sine [Hz], with the resolution of its spectrum; else 0."""
    either: str = ""
    """Example of a number whose comma may be decimal or thousands sign; else empty."""
    lacks: str = ""
    """A channel that is needed for a fit and was not found; empty for none."""
    constant: bool = False
    """Whether the pressure was not recorded and is taken from the operating point."""
    tests: list[str] = field(default_factory=list)
    """Names of the tests in each file, in order, if there are several."""
    period: float = 0.0
    """Sampling period from a header [s]; 0 where none gives it."""
    seconds: Array | None = None
    """Time of each row [s], shape (n,); None where no time was found."""

    @property
    def test(self) -> Imported:
        """What the proposed kind of test needs from a file."""
        return self.kinds.get(self.kind, Imported())

    def open_point(self, name: str) -> bool:
        """Whether the test needs a coordinate that no name of a file or folder gives."""
        return name in self.test.point and not any(f"{{{name}}}" in form for form in self.names.forms)

    def role(self, role: str) -> Proposal | None:
        """The column with a role; None without one."""
        return next((column for column in self.columns if column.role == role), None)


WORDS = {
    role: set(text.split())
    for role, text in {
        "time": "t time zeit elapsed timestamp zeitstempel seconds sec tijd temps x_value datetime date clock uhrzeit "
        "時間 时间 時刻 시간",
        "pressure": "p press pressure druck pressao presion pression pma pneu 圧力 压力 壓力 압력",
        "force": "f force load kraft lc loadcell tension weight cell fuerza forca 荷重 張力 拉力 载荷 하중",
        "displacement": "x pos position disp displacement dist distance length len stroke weg hub lage lange "
        "verkurzung kontraktion lvdt pot z contraction extension elongation encoder laser 変位 位移 변위",
        "command": "cmd command set setpoint sp ref reference desired target soll sollwert vorgabe out output "
        "demand commanded des vpr u",
        "not measured": "calc calculated theory theoretical model predicted simulated",
        "supply": "supply comp compressor tank reservoir source inlet line versorgung speise vor netz",
        "phase": "phase state step stage branch",
        "trial": "trial test run versuch lauf",
        "ambient": "ambient umgebung atmospheric barometer",
        "flow": "flow mdot massflow durchfluss massenstrom volumenstrom",
        "other": "volt volts temp temperature temperatura volume humidity sys index count",
    }.items()
}
"""Role of a column -> words in its name that indicate it, in lower case."""
MEASURED = WORDS["time"] | WORDS["pressure"] | WORDS["force"] | WORDS["displacement"]
PART = "|".join(word for words in WORDS.values() for word in sorted(words) if len(word) > 2)
PART += "|ist|istwert|wert|sensor|aufnehmer|geber|messdose|nr|nummer"
JOINED = re.compile(rf"({PART})s?({PART})(?:s?({PART}))?|\w{{3,}}(druck|kraft|weg|zeit|pressure|force)")
"""A compound of two or three known words (`Sollweg`, `Drucksollwert`, `targetpos`), or one that ends with such."""
_SHORT = re.compile(r"([pxfs])(set|setpoint|sp|cmd|command|ref|des|desired|soll|demand|target|ist)")
"""A quantity and a word for command joined in one word: `Pset`; s is a length (German: Strecke)."""
BRACKETS = re.compile(r"[\[({][^\])}]*[\])}]")
SUPERSCRIPTS = str.maketrans("⁻⁺⁰¹²³⁴⁵⁶⁷⁸⁹", "-+0123456789")
_POWER = r"10\s*(?:\^|\*\*)\s*[-+]?\d+|1[eE][-+]?\d+"
_TEN = rf"(?:{_POWER}|10+|0[.,]0*1)"
"""A power of ten other than 1: other numbers may belong to a sensor or an axis."""
_NUMBER = rf"(?:{_POWER}|\d+(?:[.,]\d+)?)"
_FACTORS = (
    rf"[*×·]\s*{_NUMBER}|(?<![\w.,])(?:{_NUMBER}\s*[*×·]|{_TEN}\s?[xX](?!\w))",  # *0.1, 10*, 10 x
    rf"(?<=[\s_()\[\]])[xX]\s?{_NUMBER}(?![^\W_])",  # x10, but not as the name of a column
    rf"(?<![\w.,])1\s*/\s*\d+(?!\w)|/\s*{_TEN}(?![^\W_])|(?<=[)\]])\s*/\s*{_NUMBER}",  # 1/10, /10
    rf"(?<![\w.,])(?:{_POWER})",
)
_FACTOR = re.compile("|".join(_FACTORS))
_BEFORE = re.compile(rf"[\[(]\s*({_TEN})\s*([^\W\d][^\])]*)[\])]|[\s_]({_TEN})\s*([^\W\d]\S*)$")
"""A number right before the unit: `[10 N]`, `in 10 um`."""


def split_factor(name: str) -> tuple[str, str]:
    """A name without the factor of its unit, and that factor as written: `x10`, `/10`, `10` of `[10 N]`.

    `Cell (500 N) [N]` has no factor: its unit is in brackets by itself.
    """
    name = re.sub("[⁻⁺]?[⁰¹²³⁴-⁹]+", lambda power: "^" + power[0].translate(SUPERSCRIPTS), name)
    span = found.span() if (found := _FACTOR.search(name)) else (0, 0)
    if found is None and not any(map(spelled, BRACKETS.findall(name))):
        every = _BEFORE.finditer(name)
        span = next((m.span(1 if m[1] else 3) for m in every if spelled(m[2] or m[4])), span)
    factor = name[slice(*span)].strip()
    return (name[: span[0]] + name[span[1] :], factor) if factor and value_of(factor) != 1.0 else (name, "")


def value_of(factor: str) -> float:
    """The value of a written factor; 0 where it is not finite."""
    base, _, power = re.findall(r"([\d.,]+(?:[eE][-+]?\d+)?)(\s*(?:\^|\*\*)\s*([-+]?\d{1,2}))?", factor)[-1]
    value = float(base.replace(",", ".")) ** int(power or 1)
    value = 1.0 / value if value and "/" in factor else value
    return value if isfinite(value) else 0.0


def unit_in(name: str) -> str:
    """The unit in a name: in brackets, else after `_`, `/`, `,`, `.`, a blank or joined (`pressureBar`); or empty."""
    name, _ = split_factor(name)
    if found := [unit for text in re.findall(r"[\[({]([^\])}]{1,12})[\])}]", name) if (unit := spelled(text))]:
        return found[-1]
    bare = BRACKETS.sub("", name).strip()
    if rate := re.search(r"(kg|g|m|mm|N|N?l)/(s|min|h)$", bare):
        return spelled(rate[0])
    last = re.split(r"[_/,.\s]+", bare)
    if len(last) > 1 and (len(last[-1]) > 1 or last[-1] in QUANTITY):
        return spelled(last[-1])
    joined = re.search(r"(?<=[a-z])([A-Z][A-Za-z]+)$", bare)  # pressureBar; not valveIn, forceMin
    unit = spelled(joined[1]) or spelled(joined[1].lower()) if joined and len(last) == 1 else ""
    return unit if QUANTITY.get(unit) in ("pressure", "force", "length", "mass") and unit != "in" else ""


def words(name: str) -> set[str]:
    """The words of a name in lower case, without brackets, digits, the group before `/` and the unit after it."""
    parts = BRACKETS.sub(" ", split_factor(name)[0]).split("/")
    plain = parts[-2] if len(parts) > 1 and spelled(parts[-1]) else parts[-1]
    plain = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain)
    plain = plain.translate(str.maketrans("ãáàâäéêíóõöúüçÃÁÄÉÍÓÖÚÜÇ", "aaaaaeeiooouucaaaeioouuc"))
    found = {word.lower() for word in re.split(r"[^A-Za-z]+", plain) if word}
    whole = "_".join(re.split(r"[\s_]+", plain.strip().lower()))
    for word in (*found, re.sub("[^a-z]", "", whole)):
        if joined := _SHORT.fullmatch(word):
            found |= {joined[1].replace("s", "weg"), joined[2]}
        elif joined := JOINED.fullmatch(word):
            parts = [part for part in joined.groups() if part]
            measured = [part for part in parts if part in MEASURED]
            found |= {part for part in parts if part not in measured[:-1]}  # Druckkraft is a force
    return found | {whole}


OF_MUSCLE = {"pressure", "force", "length"}
FEW = 0.1
"""Largest share of rows in which a column of trial numbers changes."""


def proposal(name: str, values: Array, said: str = "", *, bare: bool = False) -> Proposal:
    """A column with the unit and factor from its heading; `said`: unit that the file gives separately, if any."""
    own, heading = f"[{said}]", f"{name} [{said}]" if said else name
    column = Proposal(name, values, unit=spelled(said) or unit_in(own) or unit_in(name), bare=bare)
    column.factor = split_factor(own)[1] or split_factor(heading)[1]
    texts = [] if column.unit else BRACKETS.findall(heading)
    column.strange = next((text[1:-1] for text in texts if re.search(r"[^\W\d_]", text)), "")
    return column


def choose(proposals: Sequence[Proposal]) -> None:
    """Assign a role to every column, each role to at most one column."""
    proposals = [proposal for proposal in proposals if not _exported(proposal)]
    for proposal in proposals:
        if not proposal.bare:
            _by_name(proposal)
    _choose_time(proposals)
    _one_each(proposals)
    _unknown(proposals)


def _exported(proposal: Proposal) -> bool:
    """Whether it is one of the columns that `pmabench export` adds to the channels; if so, assign its role."""
    name, of = proposal.name, re.fullmatch(r"trial (\w+)(?: \[.*\])?", proposal.name)
    if name in ("trial", "flags", "simulated"):
        proposal.role = name
    elif of is not None and of[1] in get_args(PointName):
        proposal.role, proposal.extra = "point", {"of": of[1]}
    return proposal.role in ("trial", "flags", "simulated", "point")


def _unknown(proposals: Sequence[Proposal]) -> None:
    """Ask what a column without a name is."""
    for proposal in proposals:
        good = proposal.good
        if proposal.role != "ignore" or proposal.reasons:
            continue
        if proposal.bare and len(good):
            numbers = f"{good.min():.4g} to {good.max():.4g}, first {', '.join(f'{value:.4g}' for value in good[:3])}"
            text = f'what is "{proposal.name[:40]}"? It has no name; its numbers: {numbers}'
            proposal.question = f"{text}. Write what it is and its unit, as {{is: pressure, unit: bar}}, or ignore"
        else:
            proposal.reasons.append("neither its name nor its unit shows what it is")


def _by_name(proposal: Proposal) -> None:
    own = words(proposal.name)
    quantity = QUANTITY.get(proposal.unit, "")
    hits = {role for role, known in WORDS.items() if own & known}
    text = f'called "{proposal.name[:40]}"' + (f", in {proposal.unit}" if proposal.unit else "")
    role, free = "ignore", quantity in {"", "reading"}
    if quantity == "time" or (hits - {"trial"} == {"time"} and quantity == ""):
        role = "time"
    elif quantity == "flow" or ("flow" in hits and free):
        role = "flow"
    elif hits - {"other"} == {"trial"} and quantity == "" and _numbers_trials(proposal.good):
        role = "trial"
        if proposal.good.min() == 0:
            proposal.doubts.append("0 means no trial; where it is the first one, number the trials from 1")
    elif "ambient" in hits or ("other" in hits and not ("pressure" in hits or quantity in OF_MUSCLE)):
        proposal.reasons.append(f"{text}: none of the channels of a muscle's test")
        return
    elif quantity == "pressure" or (free and "pressure" in hits):
        role = "supply" if "supply" in hits else "pressure_command" if "command" in hits else "pressure"
    elif quantity == "length" or (free and "displacement" in hits and "force" not in hits):
        role = "displacement_command" if "command" in hits else "displacement"
    elif quantity == "force" or ("force" in hits and (free or quantity == "mass")):
        role = "force"
        if hits & {"command", "not measured"}:
            proposal.reasons.append(f"{text}: a force that nobody measured")
            return
    elif hits & {"command", "time"} == {"command"} and free:
        role = "pressure_command"
    elif "phase" in hits and quantity == "":
        role = "phase"
    proposal.role = role
    if role != "ignore":
        proposal.reasons.append(text)


def _numbers_trials(values: Array) -> bool:
    """Whether a column has whole numbers that rarely change, as numbers of trials do."""
    changes = int(np.count_nonzero(np.diff(values)))
    return len(values) > 1 and bool(np.all(values == np.round(values))) and changes < FEW * len(values)


def _one_each(proposals: Sequence[Proposal]) -> None:
    """Of several columns with one role, that with the best name, a unit and most motion keeps it, with a doubt."""
    for role in dict.fromkeys(p.role for p in proposals if p.role not in {"ignore", "time"}):
        same = [p for p in proposals if p.role == role]
        if len(same) < 2:
            continue
        best = max(same, key=lambda p: (len(words(p.name) & WORDS.get(role, set())), bool(p.unit), _moves(p.good)))
        for proposal in same:
            if proposal is not best:
                proposal.role = "ignore"
                proposal.doubts.append(f'may be {role.replace("_", " ")} too; "{best.name[:40]}" is taken')
        best.doubts.append(f"{len(same)} columns look like {role.replace('_', ' ')}; this one was taken")
        if role in {"pressure", "force", "displacement"}:
            names = ", ".join(f'"{p.name[:40]}"' for p in same if p is not best)
            text = f'is "{best.name[:40]}" the measured {role}? It moves most against its scatter, but {names} may be '
            best.question = f"{text}it; then write ignore here and {role} there"
    spare = [p for p in proposals if p.role in {"supply", "pressure_command"}]
    if spare and all(p.role != "pressure" for p in proposals):
        spare[0].doubts.append(f"no measured pressure was found; is it this {spare[0].role.replace('_', ' ')}?")


def _moves(values: Array) -> float:
    """Range of a channel divided by its scatter from sample to sample."""
    if len(values) < 3:
        return 0.0
    return float(np.ptp(np.quantile(values, [0.01, 0.99])) / (np.median(np.abs(np.diff(values))) or 1e-12))


SAMPLES = {"sample", "samples", "index", "idx", "n", "no", "nr", "number", "scan", "row", "record", "count", "x"}
"""Words in the name of a column that counts the samples."""
COUNTS = (
    ("serial days", "d", 36_526.0, 54_789.0),
    ("matlab days", "d", 730_486.0, 748_749.0),
    ("epoch", "s", 0.94e9, 2.53e9),
    ("labview", "s", 3.03e9, 4.61e9),
    ("epoch", "ms", 0.94e12, 2.53e12),
    ("epoch", "us", 0.94e15, 2.53e15),
    ("epoch", "ns", 0.94e18, 2.53e18),
)
"""Kind of count, unit, and range of the numbers for the years 2000 to 2050."""
LONGEST_STEP = {"d": 5e-5, "s": 10.0, "ms": 1e4, "us": 1e7, "ns": 1e10}
"""Unit -> longest plausible median step in that unit; days with longer steps may be seconds."""
UNLIKE_TIME = "is named or measured like a time"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""Seconds in each unit of time."""
USUAL = ("s", "ms", "us")
"""Usual units of recorded times."""
FASTEST, SLOWEST = 2e4, 2.0
"""Usual range of sampling rates [Hz]."""
SHORTEST = 2.0
"""Shortest usual duration of a test [s]."""
ROUND = (1.0, 1.25, 2.0, 2.5, 4.0, 5.0, 10.0)
"""Usual sampling rates, up to powers of ten."""
EXACT = 0.005
"""Relative tolerance for a usual rate."""
FULL = 120.0
"""Duration in seconds above which times without a unit are not taken for minutes [s]."""
BRIEF, RARE = 0.5, 0.5
"""A shorter duration [s] or a lower rate [Hz] than these is doubtful: a muscle takes 0.1 s to fill."""


def usual_step(values: Array) -> float:
    """Median of the positive steps; 0 where there are none."""
    steps = np.diff(values)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def counted(values: Array) -> tuple[str, str] | None:
    """Kind of count (see `COUNTS`) and unit of a column of absolute times; None for plain numbers.

    The kind is empty where the numbers may be days or plain numbers.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    step = usual_step(values)
    for kind, unit, low, high in COUNTS:
        inside = low <= values.min() and values.max() <= high
        if inside and 0 < step <= max(LONGEST_STEP[unit], 1e-2 if unit == "d" else 0.0):
            return kind if step <= LONGEST_STEP[unit] else "", unit
    return None


def _rises(values: Array) -> bool:
    known = len(values) > 1 and np.isfinite(values).all() and np.ptp(values) > 0
    return bool(known and np.mean(np.diff(values) >= 0) > 0.99)


def _choose_time(proposals: Sequence[Proposal]) -> None:
    """Choose the time: a column that increases, preferably one with such a name."""
    for proposal in proposals:
        if proposal.role == "time" and not _rises(proposal.values):
            proposal.role = "ignore"
            proposal.doubts.append(f"{UNLIKE_TIME}, but does not rise")
    good = [p for p in proposals if p.role == "time"]
    if not good:
        spare = (p for p in proposals if p.role == "ignore" and not p.unit)
        good = [p for p in spare if _rises(p.values) and len(set(p.values)) > 9][:1]
        for proposal in good:
            proposal.role = "time"
            proposal.reasons.append("the only column that rises from the first row to the last")
    good.sort(key=lambda p: float(np.mean(np.diff(p.values) == 0)) > 0.5)  # a clock that is too coarse comes last
    for proposal in good[1:]:
        proposal.role = "ignore"
        proposal.reasons.append(f'a second time; "{good[0].name[:40]}" is taken')
    if good:
        _how_written(good[0])


def _how_written(time: Proposal) -> None:
    """Determine how a time is written and its unit, or add a question about it."""
    plain = time.written == "number"
    if plain and (count := counted(time.values)) is not None:
        time.written, time.unit = count
        time.reasons.append(f"its numbers are those of {time.written or 'serial days'} of our years")
    elif not time.unit and bool(np.all(np.diff(time.values) == 1.0)) and words(time.name) & SAMPLES:
        time.written = "index"
        time.reasons.append("rises by exactly 1 from row to row: it counts the samples")
    elif time.factor and time.unit in SECONDS and plain:
        time.written, time.period = "index", value_of(time.factor) * SECONDS[time.unit]
    elif not time.unit:
        _time_unit(time)
    elif time.unit in USUAL and plain:
        _said_time(time)


def _in_each_unit(time: Proposal) -> dict[str, tuple[float, float, str]]:
    """Possible unit of a time -> sampling rate [Hz], duration of the file [s], and both in words."""
    step, many = usual_step(time.values), len(time.values)
    found = ((unit, 1.0 / (step * SECONDS[unit]), step * many * SECONDS[unit]) for unit in (*USUAL, "min"))
    return {unit: (rate, lasts, f"{rate:.4g} samples a second, {lasts:.4g} s") for unit, rate, lasts in found}


def _usual_units(time: Proposal, slowest: float) -> list[str]:
    """Units in which a time has a usual duration and rate, at least `slowest` [Hz], as text."""
    each = (way for way in _in_each_unit(time).items() if way[0] != "min" or _may_be_minutes(time))
    return [f"{u}: {text}" for u, (rate, lasts, text) in each if FASTEST >= rate >= slowest and lasts >= SHORTEST]


def _may_be_minutes(time: Proposal) -> bool:
    """Whether a time that would be short in seconds has a usual rate only in minutes: 50 Hz, not 3000 Hz."""
    lasts = float(np.ptp(time.values))
    rates = np.array([1.0 / usual_step(time.values), (len(time.values) - 1) / lasts])
    usual = lasts <= FULL and bool(np.all(rates / 60.0 > 4.0 * SLOWEST))
    return usual and _is_round(rates / 60.0) and not _is_round(rates)


def _is_round(rates: Array) -> bool:
    """Whether one of these rates, shape (n,), is a usual one."""
    lead = rates / 10.0 ** np.floor(np.log10(rates))
    return bool(np.any(np.abs(lead[:, None] / np.array(ROUND) - 1.0) < EXACT))


def _time_unit(time: Proposal) -> None:
    step = usual_step(time.values)
    for unit, (rate, _, _) in _in_each_unit(time).items():
        if unit != "min" and FASTEST >= rate >= SLOWEST:
            time.unit = unit
            time.reasons.append(f"steps of {step:.4g}: in {unit} these are {rate:.4g} samples a second")
            _which_time(time)
            return
    time.unit = "s"
    time.doubts.append(f"steps of {step:.4g}: the unit of time is not given; s is taken")
    time.question = f'in which unit is "{time.name[:40]}"? Its steps of {step:.4g} are no usual sampling in s, ms or us'


def _said_time(time: Proposal) -> None:
    """Ask for the unit of a time if the given one is implausible and another one plausible."""
    rate, lasts, text = _in_each_unit(time)[time.unit]
    if (lasts < BRIEF or rate < RARE) and (usual := _usual_units(time, 10 * SLOWEST)):
        head = f'"{time.name[:40]}" is in {time.unit} by its name: {text} in all'
        time.question = f"{head}, which no test of a muscle has: which unit is it? {'; '.join(usual)}"


def _which_time(time: Proposal) -> None:
    """Ask for the unit of a time without one, if several are possible or its heading is unclear."""
    possible = _usual_units(time, SLOWEST)
    if len(possible) == 1 and possible[0].startswith("min"):
        possible.insert(0, f"{time.unit}: {_in_each_unit(time)[time.unit][2]}")
    text = "; ".join(possible)
    if bool(np.all(np.diff(time.values) == 1.0)):
        head = f'"{time.name[:40]}" rises by exactly 1: is it a time, or does it count the samples'
        time.question = f"{head} (then write {{is: time, written: index, period: 2 ms}} with their distance)? {text}"
    elif len(possible) > 1 or time.factor or time.strange or not (time.bare or words(time.name) & WORDS["time"]):
        head = f'in which unit is "{time.name[:40]}"? {text}{"; " if possible else ""}'
        time.question = f"{head}for any other write {{is: time, written: index, period: 0.1 ms}} with its length"
