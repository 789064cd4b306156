"""Which column is time, pressure, force, displacement, command: by its name, its unit and the shape of its numbers.

Pure functions of names and arrays; must not know files. Every choice carries its reasons, and doubts where it is weak.
`Guess` is what was found out about the files so far.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from pmabench.base.imported import Imported
from pmabench.store.formats.record import Layout
from pmabench.store.importers import motion
from pmabench.store.importers.found import correlation
from pmabench.store.importers.map_file import QUANTITY, PointName, spelled
from pmabench.store.records import Array

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
"""Role of a column -> words in its name that speak for it, in lower case."""
MEASURED = WORDS["time"] | WORDS["pressure"] | WORDS["force"] | WORDS["displacement"]
PART = "|".join(word for words in WORDS.values() for word in sorted(words) if len(word) > 2)
PART += "|ist|istwert|wert|sensor|aufnehmer|geber|messdose|nr|nummer"
JOINED = re.compile(rf"({PART})s?({PART})(?:s?({PART}))?|\w{{3,}}(druck|kraft|weg|zeit|pressure|force)")
"""A word of two or three known ones (`Sollweg`, `Drucksollwert`, `targetpos`), or of any and a known one at its end."""
OF_MUSCLE = {"pressure", "force", "length"}
FEW = 0.1
"""A column that numbers trials changes in less than this share of its rows."""
SAMPLES = {"sample", "samples", "index", "idx", "n", "no", "nr", "number", "scan", "row", "record", "count", "x"}
"""Words of a column that counts the samples."""
HELD, STILL = 0.02, 3e-4
"""A length is held that moves by less than this share of itself, or by less than this [m]."""
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "in": 0.0254}
OF_ROLE = {
    "pressure_command": "pressure",
    "displacement_command": "length",
    "supply": "pressure",
    "displacement": "length",
}
COUNTS = (
    ("serial days", "d", 36_526.0, 54_789.0),
    ("matlab days", "d", 730_486.0, 748_749.0),
    ("epoch", "s", 0.94e9, 2.53e9),
    ("labview", "s", 3.03e9, 4.61e9),
    ("epoch", "ms", 0.94e12, 2.53e12),
    ("epoch", "us", 0.94e15, 2.53e15),
    ("epoch", "ns", 0.94e18, 2.53e18),
)
"""How written, unit, and the numbers of the years 2000 to 2050."""
LONGEST_STEP = {"d": 5e-5, "s": 10.0, "ms": 1e4, "us": 1e7, "ns": 1e10}
"""Median step of a recording that counts so, in that unit; days in longer steps may be seconds."""


@dataclass
class Proposal:
    """What one column seems to be."""

    name: str
    values: Array
    role: str = "ignore"
    unit: str = ""
    """As pmabench spells it; empty where it is not known."""
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    mixed: str = ""
    """Name of a file in which it holds whole numbers while it does not in others; empty where all are alike."""
    elsewhere: float = 0.0
    """The highest value in other files of the same layout."""
    middles: list[float] = field(default_factory=list)
    """The median in each of these."""
    question: str = ""
    """What is asked about its role, where the choice is open."""
    written: str = "number"
    """How a time is written, as the map says it; empty where it may be days or a plain number."""
    order: str = ""
    """Order of day and month in its dates, where the year comes last; `??` where the file leaves it open."""
    period: float = 0.0
    """Distance of the samples [s] that a time counts; 0 where the file does not give it."""
    bare: bool = False
    """Nothing but its numbers shows what it is: the file gives no name, or one for all columns of a matrix."""
    extra: list[str] = field(default_factory=list)
    """Further lines of the map that are known of it."""

    @property
    def good(self) -> Array:
        """Values without those that are none."""
        return self.values[np.isfinite(self.values)]

    @property
    def apart(self) -> bool:
        """Whether it is a length that is another one in another file of the layout."""
        middles = [*self.middles, *([float(np.median(self.good))] if len(self.good) else [])]
        return len(middles) > 1 and float(np.ptp(middles)) > STILL / METRES.get(self.unit, 1e-3)


_SHORT = re.compile(r"([pxfs])(set|setpoint|sp|cmd|command|ref|des|desired|soll|demand|target|ist)")
"""A quantity and what makes a command of it in one word: `Pset`; s is a length (German: Strecke)."""


BRACKETS = re.compile(r"[\[({][^\])}]*[\])}]")


def unit_in(name: str) -> str:
    """The unit that a name carries: in brackets, else behind `_`, `/`, `,`, a blank or `in`; empty where none."""
    if found := [unit for text in re.findall(r"[\[({]([^\])}]{1,12})[\])}]", name) if (unit := spelled(text))]:
        return found[-1]
    bare = BRACKETS.sub("", name).strip()
    if rate := re.search(r"(kg|g|m|mm|N|N?l)/(s|min|h)$", bare):
        return spelled(rate[0])
    last = re.split(r"[_/,.\s]+", bare)
    if len(last) > 1 and (len(last[-1]) > 1 or last[-1] in QUANTITY):
        return spelled(last[-1])
    return ""


def words(name: str) -> set[str]:
    """The words of a name in lower case, without brackets, digits, the group before `/` and the unit behind it."""
    parts = BRACKETS.sub(" ", name).split("/")
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


def choose(proposals: Sequence[Proposal]) -> None:
    """Give every column its role; at most one of each."""
    proposals = [proposal for proposal in proposals if not _exported(proposal)]
    for proposal in proposals:
        if not proposal.bare:
            _by_name(proposal)
    _time(proposals)
    _one_each(proposals)
    _by_shape(proposals)
    _unknown(proposals)


def _exported(proposal: Proposal) -> bool:
    """Whether it is a column that `pmabench export` adds to the channels: it gets its role."""
    name, of = proposal.name, re.fullmatch(r"trial (\w+)(?: \[.*\])?", proposal.name)
    if name in ("trial", "flags", "simulated"):
        proposal.role = name
    elif of is not None and of[1] in get_args(PointName):
        proposal.role, proposal.extra = "point", [f"of: {of[1]}"]
    return proposal.role in ("trial", "flags", "simulated", "point")


def _unknown(proposals: Sequence[Proposal]) -> None:
    """Doubt and question for columns that vary with the pressure and were not recognised."""
    pressure = next((p for p in proposals if p.role == "pressure"), None)
    for proposal in proposals:
        if (
            proposal.role != "ignore"
            or pressure is None
            or proposal.reasons
            or len(pressure.values) != len(proposal.values)
        ):
            continue
        together = correlation(proposal.values, pressure.values)
        if abs(together) > 0.8:
            proposal.doubts.append(f"goes with the pressure (correlation {together:.2f}): is it force or displacement?")
            if all(p.role != "force" for p in proposals):
                text = (
                    f'"{proposal.name[:40]}" goes with the pressure (correlation {together:.2f}), and nothing names it'
                )
                proposal.question = f"{text}: is it {{is: force, unit: N}}, {{is: displacement, unit: mm}}, or ignore?"
        else:
            proposal.reasons.append("neither its name nor its unit nor its numbers show what it is")


def _by_name(proposal: Proposal) -> None:
    own = words(proposal.name)
    quantity = QUANTITY.get(proposal.unit, "")
    hits = {role for role, known in WORDS.items() if own & known}
    text = f'called "{proposal.name[:40]}"' + (f", in {proposal.unit}" if proposal.unit else "")
    role = "ignore"
    if quantity == "time" or (hits - {"trial"} == {"time"} and quantity == ""):
        role = "time"
    elif quantity == "flow" or ("flow" in hits and quantity in {"", "reading"}):
        role = "flow"
    elif hits - {"other"} == {"trial"} and quantity == "" and _numbers_trials(proposal.good):
        role = "trial"
        if proposal.good.min() == 0:
            proposal.doubts.append("0 means no trial; where it is the first one, number the trials from 1")
    elif "ambient" in hits or ("other" in hits and not ("pressure" in hits or quantity in OF_MUSCLE)):
        proposal.reasons.append(f"{text}: none of the channels of a muscle's test")
        return
    elif quantity == "pressure" or (quantity in {"", "reading"} and "pressure" in hits):
        role = "supply" if "supply" in hits else "pressure_command" if "command" in hits else "pressure"
    elif quantity == "length" or (quantity in {"", "reading"} and hits & {"displacement"} and not hits & {"force"}):
        role = "displacement_command" if "command" in hits else "displacement"
    elif quantity == "force" or ("force" in hits and quantity in {"", "reading", "mass"}):
        role = "ignore" if hits & {"command", "not measured"} else "force"
        if role == "ignore":
            proposal.reasons.append(f"{text}: a force that nobody measured")
    elif hits & {"command", "time"} == {"command"} and quantity in {"", "reading"}:
        role = "pressure_command"
    elif "phase" in hits and quantity == "":
        role = "phase"
    proposal.role = role
    if role != "ignore":
        proposal.reasons.append(text)


def _numbers_trials(values: Array) -> bool:
    """Whether a column holds whole numbers that rarely change."""
    changes = int(np.count_nonzero(np.diff(values)))
    return len(values) > 1 and bool(np.all(values == np.round(values))) and changes < FEW * len(values)


def usual_step(values: Array) -> float:
    """Median of the steps upward; 0 where there is none."""
    steps = np.diff(values)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def counted(values: Array) -> tuple[str, str] | None:
    """How a column of numbers counts from a day, and in which unit; None where it is a plain number.

    An empty first text: it may be days or a plain number.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    step = usual_step(values)
    for kind, unit, low, high in COUNTS:
        if low <= float(values.min()) and float(values.max()) <= high and 0 < step:
            if step <= LONGEST_STEP[unit]:
                return kind, unit
            if unit == "d" and step <= 1e-2:
                return "", unit
    return None


UNLIKE_TIME = "is named or measured like a time"


def _time(proposals: Sequence[Proposal]) -> None:
    """The column that rises: a named one where it does, else any."""

    def rises(values: Array) -> bool:
        if len(values) < 2 or not np.isfinite(values).all() or np.ptp(values) == 0:
            return False
        return float(np.mean(np.diff(values) >= 0)) > 0.99

    named = [p for p in proposals if p.role == "time"]
    good = [p for p in named if rises(p.values)]
    for proposal in named:
        if proposal not in good:
            proposal.role = "ignore"
            proposal.doubts.append(f"{UNLIKE_TIME}, but does not rise")
    if not good:
        good = [
            p for p in proposals if p.role == "ignore" and p.unit == "" and rises(p.values) and len(set(p.values)) > 9
        ]
        if good:
            good = good[:1]
            good[0].role = "time"
            good[0].reasons.append("the only column that rises from the first row to the last")
    good.sort(key=lambda p: float(np.mean(np.diff(p.values) == 0)) > 0.5)  # one that is too coarse comes last
    for proposal in good[1:]:
        proposal.role = "ignore"
        proposal.reasons.append(f'a second time; "{good[0].name[:40]}" is taken')
    if good and good[0].written == "number" and (count := counted(good[0].values)) is not None:
        good[0].written, good[0].unit = count
        good[0].reasons.append(f"its numbers are those of {good[0].written or 'serial days'} of our years")
    elif good and not good[0].unit and bool(np.all(np.diff(good[0].values) == 1.0)) and words(good[0].name) & SAMPLES:
        good[0].written = "index"
        good[0].reasons.append("rises by exactly 1 from row to row: it counts the samples")
    elif good and not good[0].unit:
        _time_unit(good[0])
    elif good and good[0].unit in TIMES and good[0].written == "number":
        _said_time(good[0])


TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
FASTEST, SLOWEST = 2e4, 2.0
"""Usual samples a second."""
SHORTEST = 2.0
"""A test of a muscle lasts at least so long [s]."""
BRIEF, RARE = 0.5, 0.5
"""A file that lasts less than this [s], or has fewer samples a second, is doubted: a muscle takes 0.1 s to fill."""


def _in_each_unit(time: Proposal) -> dict[str, tuple[float, float, str]]:
    """Unit that a time may have -> samples a second, how long the file lasts [s], and both in words."""
    step, many = usual_step(time.values), len(time.values)
    found = {unit: (1.0 / (step * factor), step * many * factor) for unit, factor in TIMES.items()}
    return {unit: (rate, lasts, f"{rate:.4g} samples a second, {lasts:.4g} s") for unit, (rate, lasts) in found.items()}


def _usual_units(time: Proposal, slowest: float) -> list[str]:
    """The units in which a time is that of a usual test, of so many samples a second at least, in words."""
    each = _in_each_unit(time).items()
    return [f"{unit}: {text}" for unit, (rate, lasts, text) in each if FASTEST >= rate >= slowest and lasts >= SHORTEST]


def _time_unit(time: Proposal) -> None:
    step = usual_step(time.values)
    for unit, (rate, _, _) in _in_each_unit(time).items():
        if FASTEST >= rate >= SLOWEST:
            time.unit = unit
            time.reasons.append(f"steps of {step:.4g}: in {unit} these are {rate:.4g} samples a second")
            _which_time(time)
            return
    time.unit = "s"
    time.doubts.append(f"steps of {step:.4g}: the unit of time is not given; s is taken")
    time.question = f'in which unit is "{time.name[:40]}"? Its steps of {step:.4g} are no usual sampling in s, ms or us'


def _said_time(time: Proposal) -> None:
    """Ask for the unit of a time where the given one makes the file an impossible test, another one a usual one."""
    rate, lasts, text = _in_each_unit(time)[time.unit]
    usual = _usual_units(time, 10 * SLOWEST)
    if usual and (lasts < BRIEF or rate < RARE):
        head = f'"{time.name[:40]}" is in {time.unit} by its name: {text} in all'
        time.question = f"{head}, which no test of a muscle has: which unit is it? {'; '.join(usual)}"


def _which_time(time: Proposal) -> None:
    """Ask for the unit of a time without one, where several are possible."""
    possible = _usual_units(time, SLOWEST)
    text = "; ".join(possible)
    if bool(np.all(np.diff(time.values) == 1.0)):
        head = f'"{time.name[:40]}" rises by exactly 1: is it a time, or does it count the samples'
        time.question = f"{head} (then write {{is: time, written: index, period: 2 ms}} with their distance)? {text}"
    elif len(possible) > 1:
        time.question = f'in which unit is "{time.name[:40]}"? {text}'


def _one_each(proposals: Sequence[Proposal]) -> None:
    """Where several columns have one role, the one that moves most keeps it, with a doubt."""
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
            text = (
                f'is "{best.name[:40]}" the measured {role}? It moves most against its scatter, but {names} may be it'
            )
            best.question = f"{text}; then write ignore here and {role} there"
    pressure = [p for p in proposals if p.role == "pressure"]
    spare = [p for p in proposals if p.role in {"supply", "pressure_command"}]
    if not pressure and spare:
        spare[0].doubts.append(f"no measured pressure was found; is it this {spare[0].role.replace('_', ' ')}?")


def _moves(values: Array) -> float:
    """How far a channel moves, against the scatter from sample to sample."""
    if len(values) < 3:
        return 0.0
    scatter = float(np.median(np.abs(np.diff(values)))) or 1e-12
    return float(np.ptp(np.quantile(values, [0.01, 0.99]))) / scatter


def _by_shape(proposals: Sequence[Proposal]) -> None:
    """Columns without names: phases are whole numbers in order, a command rests, the others go with the pressure."""
    bare = [p for p in proposals if p.role == "ignore" and p.bare and not p.unit and len(p.good) and not _phases(p)]
    taken = {p.role for p in proposals}
    command = None if "pressure_command" in taken else _command(bare)
    order = sorted((p for p in bare if p is not command), key=lambda p: _like_pressure(p.good), reverse=True)
    scale = _pressure_unit(order[0].good) if order else None
    if "pressure" in taken or scale is None:
        return
    pressure, others = order[0], order[1:]
    pressure.role, pressure.unit = "pressure", scale
    top = float(np.quantile(pressure.good, 0.99))
    pressure.reasons.append(f"never far below zero, {top:.4g} at most: like a pressure in {scale}")
    if command is not None:
        command.role, command.unit = "pressure_command", scale
        together = correlation(command.values, pressure.values)
        command.reasons.append(f"rests at levels, and the pressure goes with it (correlation {together:.2f})")
        command.doubts.append("that it is the command of the pressure is a guess: no name says it")
    follow = [p for p in others if abs(correlation(p.values, pressure.values)) > 0.5]
    if len(follow) > 1 and not taken & {"force", "displacement"}:
        _displacement(follow, pressure)
    if "force" not in taken:
        _force([p for p in others if p.role == "ignore"], pressure)
    for proposal in (pressure, *(p for p in others if p.role == "force")):
        if step := lattice(proposal.good):
            text = f"reads in steps of {step:.4g}: counts were turned into it; where you know the line say it with "
            proposal.doubts.append(f'{text}"recorded_with"')


def _phases(proposal: Proposal) -> bool:
    """Whether a column without a name holds few whole numbers in order; where they differ they mark phases."""
    marks = np.unique(proposal.good)
    if len(marks) > 6 or not np.array_equal(marks, np.round(marks)) or not bool(np.all(np.diff(proposal.good) >= 0)):
        return False
    if len(marks) > 1:
        proposal.role = "phase"
        proposal.reasons.append(f"few whole numbers in order, {', '.join(f'{m:g}' for m in marks)}: phases")
    return True


def _force(others: Sequence[Proposal], pressure: Proposal) -> None:
    """The column without a name that goes with the pressure best, where one does."""
    force = max(others, key=lambda p: abs(correlation(p.values, pressure.values)), default=None)
    together = 0.0 if force is None else correlation(force.values, pressure.values)
    if force is None or abs(together) <= 0.5:
        return
    force.role, force.unit = "force", "N"
    force.reasons.append(f"goes with the pressure (correlation {together:.2f}), flat where the pressure is low")
    force.doubts.append("that it is a force in N is a guess: no name says it")
    pressure.doubts.append("only its numbers distinguish it from the other column: is it the other way round?")


def _command(bare: Sequence[Proposal]) -> Proposal | None:
    """A column of the size of a pressure that rests at levels while another one goes with it."""
    for proposal in bare:
        values = proposal.good
        if len(values) < 10 or np.ptp(values) == 0 or _pressure_unit(values) is None:
            continue
        rests = float(np.mean(np.diff(values) == 0)) > 0.9
        twin = any(
            correlation(proposal.values, p.values) > 0.8 and _pressure_unit(p.good) == _pressure_unit(values)
            for p in bare
            if p is not proposal and float(np.mean(np.diff(p.good) == 0)) <= 0.9
        )
        if rests and twin:
            return proposal
    return None


def _displacement(follow: Sequence[Proposal], pressure: Proposal) -> None:
    """Of several columns that go with the pressure the one with the smallest numbers, where they could be a length."""
    smallest = min(follow, key=lambda p: float(np.quantile(np.abs(p.good), 0.99)))
    top = float(np.quantile(np.abs(smallest.good), 0.99))
    unit = "m" if top < 0.5 else "mm" if top < 200.0 else ""
    if not unit:
        return
    smallest.role, smallest.unit = "displacement", unit
    together = correlation(smallest.values, pressure.values)
    smallest.reasons.append(
        f"goes with the pressure (correlation {together:.2f}), {top:.4g} at most: a length in {unit}?"
    )
    smallest.doubts.append(
        "that it is a displacement is a guess by its size: no name says it; look whether it is not the force"
    )


def held(column: Proposal, pressure: Proposal | None) -> bool:
    """Whether a length is held: it moves by little of itself, and not with the pressure."""
    x = column.good
    if len(x) < 3:
        return False
    low, high = (float(value) for value in np.quantile(x, [0.01, 0.99]))
    if high - low == 0:
        return True
    together = 0.0 if pressure is None else correlation(column.values, pressure.values)
    still = STILL / METRES[column.unit] if column.unit in METRES else 0.0
    return high - low < max(still, HELD * max(abs(low), abs(high))) and abs(together) < 0.5


def _pressure_unit(values: Array) -> str | None:
    top = float(np.quantile(values, 0.99))
    usual = (("bar", 0.8, 12.0), ("kPa", 50.0, 1200.0), ("Pa", 5e4, 1.2e6), ("MPa", 0.05, 0.8))
    return next((unit for unit, low, high in usual if low <= top <= high), None)


def _like_pressure(values: Array) -> float:
    """The higher the more like a gauge pressure: of its size, never below zero, rarely at rest at its lower end."""
    low, top = (float(v) for v in np.quantile(values, [0.002, 0.998]))
    span = (top - low) or 1.0
    size = 1.0 if _pressure_unit(values) else 0.0
    below = min(1.0, max(0.0, -low / span) * 20)
    rest = float(np.mean(values < low + 0.1 * span))
    return size - below - rest


def lone(values: Array) -> NDArray[np.bool_]:
    """Which samples leap away from those around them, as sentinels and spikes do: shape (n,), finite values only."""
    if len(values) < 9:
        return np.zeros(len(values), dtype=bool)
    around = motion.medians(values, 9)
    return np.asarray(np.abs(values - around) > 0.25 * float(np.ptp(around)))


def lattice(values: Array) -> float:
    """The step between values, where they are those of a converter; 0 where they are not."""
    marks = np.unique(np.round(values, 9))
    if not 20 < len(marks) < len(values) / 4:
        return 0.0
    gaps = np.diff(marks)
    step = float(np.median(gaps))
    near = np.abs(gaps / step - np.round(gaps / step))
    return step if float(np.mean(near < 0.2)) > 0.95 and float(gaps.min()) > 1e-6 * step else 0.0


def is_whole(values: Array) -> bool:
    """Whole numbers throughout, and more than a few of them."""
    return len(values) > 0 and bool(np.all(values == np.round(values))) and len(np.unique(values)) > 12


@dataclass
class Guess:
    """What was found; `columns` in the order of the file."""

    files: list[Path]
    layout: Layout
    columns: list[Proposal]
    optional: list[str]
    """Names of columns that some of the files lack."""
    left_out: list[str]
    kinds: Mapping[str, Imported]
    """What each kind of test needs of a file, by its name."""
    kind: str = ""
    trials: dict[str, str] = field(default_factory=dict)
    """Lines of `trials`, as text."""
    smallest_of: str = "pressure_command"
    """Role whose unit `smallest` of `trials` has."""
    forms: list[str] = field(default_factory=list)
    form_of: str = "file"
    form_units: dict[str, str] = field(default_factory=dict)
    form_comma: bool = False
    rate: tuple[float, float] = (1.0, 1000.0)
    gap: float = 1.0
    reasons: dict[str, list[str]] = field(default_factory=dict)
    """`file`, `sampling`, `trials`, `name_tells` -> why."""
    doubts: list[str] = field(default_factory=list)
    known: str = ""
    """Name of a shipped map that takes these files as they are."""
    frequency: float = 0.0
    """Of a command that is one sine [Hz], to the resolution of its spectrum."""
    either: str = ""
    """A number whose comma may be the decimal sign or group digits."""
    lacks: str = ""
    """A channel without which nothing can be fitted, and that was not found."""
    constant: bool = False
    """The pressure was not recorded: it is that of the operating point."""
    tests: list[str] = field(default_factory=list)
    """Names of several tests in each file, in their order."""
    slower: tuple[float, float] = (1.0, 1.0)
    """Least and largest step of the clocks of the tests, against that of the test that is shown."""
    period: float = 0.0
    """Distance of the samples that a header gives [s]; 0 where none does."""
    seconds: Array | None = None
    """Time of each row [s], where a time was found."""
    exported: bool = False
    """The record of an exported run answers what else would be asked."""
    simulated: bool = False
    specimen: dict[str, str] = field(default_factory=dict)
    """Where a file gives it."""

    @property
    def test(self) -> Imported:
        """What the kind that is proposed needs of a file."""
        return self.kinds.get(self.kind, Imported())

    def open_point(self, name: str) -> bool:
        """Whether a coordinate is needed of each file, and no name of a file or folder gives it."""
        return name in self.test.point and not any(f"{{{name}}}" in form for form in self.forms)

    def role(self, role: str) -> Proposal | None:
        """The column with a role, where there is one."""
        return next((column for column in self.columns if column.role == role), None)
