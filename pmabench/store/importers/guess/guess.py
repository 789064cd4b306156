"""Looks at files that were never seen: their format, their columns, their sampling, and how they part into trials."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from pmabench.base.errors import InvalidFile, PmaError, invalid
from pmabench.files.shipped import shipped_folder
from pmabench.store.importers import motion
from pmabench.store.importers.guess.clocks import alike, is_clock, matrix_of, owners
from pmabench.store.importers.guess.columns import OTHER_SIGN, Proposal, choose, held, is_whole, lone, unit_in
from pmabench.store.importers.guess.exported import as_exported
from pmabench.store.importers.guess.layout import TextGuess, guess_layout
from pmabench.store.importers.guess.names import frequency_of, told_by
from pmabench.store.importers.map_file import PLACE, BinaryLayout, TextLayout
from pmabench.store.importers.map_rules import ImportMap, read_map
from pmabench.store.importers.table import content_of, read_table
from pmabench.store.importers.units import spelled
from pmabench.store.records import Array

FILES = 20
"""Files of one guess that are looked at; the columns are told by the first."""
MAGIC = (
    (b"LabVIEW Measurement", "lvm"),
    (b"\xef\xbb\xbfLabVIEW Measurement", "lvm"),
    (b"TDSm", "tdms"),
    (b"MATLAB ", "mat"),
)
_MATRIX = re.compile(r"(.+)\(:,\d+\)")
LOOKED_AT = 20_000_000
"""Bytes of a text file that are looked at."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""In one unit of a time."""
LONG_PAUSE = 2.0
"""Seconds; a log that pauses so long several times was switched off between its parts."""


@dataclass
class Guess:
    """What was found; `columns` in the order of the file."""

    files: list[Path]
    layout: TextLayout | BinaryLayout
    columns: list[Proposal]
    optional: list[str]
    """Names of columns that some of the files lack."""
    left_out: list[str]
    kind: str = "isometric"
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
    """Where a file tells it."""

    def role(self, role: str) -> Proposal | None:
        """The column with a role, where there is one."""
        return next((column for column in self.columns if column.role == role), None)


def guess_files(files: Sequence[Path]) -> Guess:
    """Look at up to 20 files of one layout; raises InvalidFile where they cannot be read or are not alike."""
    if not files:
        raise invalid("files", "give at least one file")
    with np.errstate(all="ignore"):  # damaged files hold numbers of any size
        return _guess(files)


def _guess(files: Sequence[Path]) -> Guess:
    guess = _look(files[0])
    if as_exported(guess, files):
        _sampling(guess)
        return guess
    for path in files[1:FILES]:
        _alike(guess, path)
    guess.files = list(files)
    _sampling(guess)
    _kind(guess)
    _names(guess)
    _frequency(guess)
    _lacking(guess)
    guess.known = _known(files[0])
    for role in ("time", "pressure"):
        if guess.role(role) is None:
            guess.doubts.append(f"no column was found that is a {role}: say which it is, for the map needs one")
    if guess.role("time") is None and guess.role("pressure") is not None and isinstance(guess.layout, TextLayout):
        guess.doubts.append(
            "a table of points without time is no recording: report --overlay draws it beside your own, and model fit "
            "fits a model to it"
        )
    bare = [column.name for column in guess.columns if column.bare and column.role not in ("ignore", "time")]
    if bare:
        guess.doubts.append(f"to be confirmed by who knows the bench, for numbers alone tell it: {', '.join(bare)}")
    return guess


def _look(path: Path) -> Guess:
    content = content_of(path, LOOKED_AT)
    kind = next((kind for magic, kind in MAGIC if content.startswith(magic)), "text")
    if kind == "text":
        if len(content) == LOOKED_AT:
            content = content[: content.rfind(b"\n") + 1] or content
        return _look_at_text(path, guess_layout(str(path), content))
    layout = BinaryLayout.model_validate({"format": kind})
    table = read_table(path, layout, None)
    groups: dict[tuple[str, int], list[str]] = {}
    owner = owners(table.columns) if kind == "mat" else {name: name.rpartition("/")[0] for name in table.columns}
    tests, zeros = alike(table.columns, owner) if kind == "mat" else ([], [])
    for name, values in table.columns.items():
        groups.setdefault((owner[name] if kind != "lvm" else "", len(values)), []).append(name)
    if not groups:
        raise invalid(path, "holds no columns of numbers")
    good = [key for key in groups if key[0] not in zeros and (len(tests) < 2 or key[0] in tests)]
    group = max(good or groups, key=lambda key: (len(groups[key]) * key[1], key))
    others = [name for key, names in groups.items() if key != group for name in names]
    names = {"lvm": "LabVIEW measurement", "tdms": "TDMS", "mat": "MATLAB"}
    reasons = [f"{names[kind]}, by its first bytes; {len(groups[group])} columns of {group[1]} samples each"]
    if zeros:
        reasons.append(f"nothing moves in {', '.join(zeros)[:200]}: records of the zeros, left out")
    if len(tests) > 1:
        reasons.append(f"{len(tests)} matrices with a clock each: every one is a test, and told apart by {group[0]}")
        others = [name for name in others if matrix_of(name) not in tests]
    if others:
        reasons.append(f"columns of other lengths, groups or clocks are left out: {', '.join(others)[:200]}")
    columns = [
        Proposal(name, table.columns[name], unit=spelled(table.units.get(name, "")) or unit_in(name))
        for name in groups[group]
    ]
    for column in columns:
        matrix = _MATRIX.fullmatch(column.name)
        column.bare = matrix is not None and sum(name.startswith(f"{matrix[1]}(:,") for name in groups[group]) > 1
        if spelled(table.units.get(column.name, "")):
            column.reasons.append(f"the file says its unit, {column.unit}")
    if any(column.bare for column in columns):
        reasons.append("columns of a matrix have no names of their own: they are told apart by what they hold")
    choose(columns)
    guess = Guess([path], layout, columns, [], [*others, *table.left_out], reasons={"file": reasons})
    if len(tests) > 1:
        guess.tests = tests
        for column in columns:
            column.name = column.name.replace(group[0], PLACE, 1)
        own = _usual_step(table.columns, group[0])
        steps = [_usual_step(table.columns, test) / own for test in tests] if own else []
        guess.slower = (min(steps, default=1.0), max(steps, default=1.0))
    if guess.role("time") is None:
        guess.doubts.append('nothing in the file tells the time: say "period" if the samples are evenly apart')
    return guess


def _usual_step(columns: Mapping[str, Array], matrix: str) -> float:
    """The median step of the clock of a matrix."""
    clock = next((v for name, v in columns.items() if matrix_of(name) == matrix and is_clock(v)), None)
    return 0.0 if clock is None else float(np.median(np.diff(clock)))


def _look_at_text(path: Path, told: TextGuess) -> Guess:
    numbers = [name for name in told.names if name not in told.texts]
    stamps = told.stamps
    if told.tests and _goes_on(path, told, numbers):
        told.tests, told.layout = 0, told.layout.model_copy(update={"repeated_header": "page"})
        told.reasons.append("the line of names is repeated, and the time goes on below it: pages of one test")
    elif told.tests:
        told.reasons.append("the line of names is repeated: another test begins there, which makes a run too")
    asked = [name for name in told.names if name in numbers]
    table = read_table(path, told.layout, asked, (), told.texts, stamps, LOOKED_AT)
    if table.starts:
        table = table.tests()[0]
    columns = [
        Proposal(name, table.columns[name], unit=told.units.get(name) or unit_in(name), bare=not told.named)
        for name in numbers
        if stamps is None or name != stamps.date
    ]
    for column in columns:
        if stamps is not None and column.name == stamps.column:
            column.unit, column.written, column.bare = "s", stamps.written, False
            column.order = "??" if told.open_order else stamps.order if stamps.order != "year first" else ""
    choose(columns)
    words = [
        Proposal(name, np.empty(0), reasons=[OTHER_SIGN if name in told.other else "holds words, not numbers"])
        for name in told.texts
    ]
    if stamps is not None and stamps.date:
        order = "??" if told.open_order else stamps.order if stamps.order != "year first" else ""
        words.append(Proposal(stamps.date, np.empty(0), role="date", order=order, reasons=["the day of the clock"]))
    falls = next((c.name for c in columns if c.unit in SECONDS and is_clock(-c.values) and c.written == "number"), "")
    if falls and all(column.role != "time" for column in columns):
        backward = f'"{falls}" falls from row to row: the newest row comes first; reverse the order of the rows'
        raise invalid(path, backward)
    every = {column.name: column for column in [*columns, *words]}
    reasons = {"file": told.reasons}
    guess = Guess([path], told.layout, [every[name] for name in told.names], [], [], reasons=reasons)
    time = guess.role("time")
    if time is not None and time.written == "index":
        time.period = told.interval
    guess.period, guess.either = told.interval, told.either
    guess.tests = [str(number) for number in range(1, told.tests + 1)]
    if not told.named:
        _call_by_role(guess)
    return guess


def _goes_on(path: Path, told: TextGuess, numbers: Sequence[str]) -> bool:
    """Whether a column that rises throughout rises over each repeated line of names by a usual step, too."""
    layout = told.layout.model_copy(update={"repeated_header": "page"})
    starts = read_table(path, told.layout, numbers, (), told.texts, told.stamps, LOOKED_AT).starts
    table = read_table(path, layout, numbers, (), told.texts, told.stamps, LOOKED_AT)
    over = np.array(starts, dtype=int) - 1
    return len(over) > 0 and any(
        is_clock(values) and float(np.diff(values)[over].max()) < 2.0 * float(np.median(np.diff(values)))
        for values in table.columns.values()
    )


def _call_by_role(guess: Guess) -> None:
    """Columns without names are called by what they are."""
    for column in guess.columns:
        if column.role != "ignore":
            column.name = column.role
    if isinstance(guess.layout, TextLayout):
        guess.layout = guess.layout.model_copy(update={"names": [column.name for column in guess.columns]})


def _alike(guess: Guess, path: Path) -> None:
    """Another file of the same layout: a column at the end that not all files have is optional."""
    other = _look(path)
    _mixed(guess, other)
    same = type(other.layout) is type(guess.layout)
    if same and isinstance(guess.layout, TextLayout) and isinstance(other.layout, TextLayout):
        keys = ("delimiter", "quoted", "decimal", "encoding", "header", "skip_lines", "comment")
        same = all(getattr(guess.layout, key) == getattr(other.layout, key) for key in keys)
        blank = "skip" if "skip" in {guess.layout.blank_lines, other.layout.blank_lines} else "refuse"
        missing = sorted({*guess.layout.missing, *other.layout.missing})
        guess.layout = guess.layout.model_copy(update={"blank_lines": blank, "missing": missing})
        if same and guess.layout.header == "none":
            longer = guess if len(guess.columns) >= len(other.columns) else other
            shorter = other if longer is guess else guess
            extra = [column.name for column in longer.columns[len(shorter.columns) :]]
            guess.optional = sorted({*guess.optional, *extra})
            if longer is other:
                roles = [column.role for column in guess.columns]
                guess.columns += [column for column in other.columns[len(roles) :] if column.role not in roles]
                guess.layout = guess.layout.model_copy(update={"names": [column.name for column in guess.columns]})
            return
    names, others = {column.name for column in guess.columns}, {column.name for column in other.columns}
    if not same or names != others:
        told = ", ".join(sorted(names ^ others)[:4])
        raise invalid(
            path, f"is laid out otherwise than {guess.files[0]}{f' ({told})' if told else ''}: guess them apart"
        )


def _mixed(guess: Guess, other: Guess) -> None:
    """Columns that hold whole numbers in one of two files only."""
    there = {column.name: column for column in other.columns}
    for column in guess.columns:
        if column.name in there and (here := is_whole(column.good)) != is_whole(there[column.name].good):
            column.mixed = (guess if here else other).files[0].name


def _sampling(guess: Guess) -> None:
    time = guess.role("time")
    if time is None:
        return
    unit = time.period or 1.0 if time.written == "index" else SECONDS.get(time.unit, 1.0)
    guess.seconds = time.values * unit
    steps = np.diff(guess.seconds)
    forward = steps[steps > 0]
    if not len(forward):
        return
    usual = float(np.median(forward))
    guess.rate = (0.7 / (usual * guess.slower[1]), 1.4 / (usual * guess.slower[0]))
    early, late = (float(step) for step in np.quantile(steps[steps >= 0], [0.05, 0.95]))
    even = late < 1.01 * usual and early > 0.99 * usual
    guess.gap = (1.5 if even else 4.0) * usual
    wide = float(np.quantile(forward, 0.995))
    guess.gap = max(guess.gap, 1.5 * wide if wide < 10 * usual else 0.0) * guess.slower[1]
    how = "evenly" if even else f"unevenly, {early:.3g} to {late:.3g} s apart"
    told = [f"median {1 / usual:.4g} samples a second, {how}"]
    if (steps < 0).any():
        told.append(f"the time jumps back {int((steps < 0).sum())} times: it is flagged, not mended")
    if (steps > guess.gap).any():
        told.append(f"{int((steps > guess.gap).sum())} gaps, the longest {steps.max():.3g} s")
    guess.reasons["sampling"] = told


def _kind(guess: Guess) -> None:
    """Which reduction fits, and how the file parts into trials."""
    told = guess.reasons.setdefault("trials", [])
    command, displacement, t = guess.role("pressure_command"), guess.role("displacement"), guess.seconds
    if guess.role("trial") is not None and command is not None and _edge(command.values) > 0:
        guess.kind, guess.trials = "contraction-relaxation", {"by": "column"}
        told.append("the command goes in steps, and a column numbers the trials")
        return
    pauses = np.diff(t)[np.diff(t) > LONG_PAUSE] if t is not None else np.empty(0)
    if displacement is not None and len(pauses) >= 2 and guess.role("force") is not None:
        guess.kind, guess.trials = "recorded-pull", {"by": "gap", "longer_than": f"{0.6 * pauses.min():.2g} s"}
        told.append(
            f"the log pauses {len(pauses)} times for {pauses.min():.2g} s and longer: parts at set contractions"
        )
        return
    sine = sine_of(t, command.values) if command is not None and t is not None else 0.0
    still = displacement is not None and guess.role("force") is not None and held(displacement, guess.role("pressure"))
    if displacement is None or still:
        guess.kind, guess.trials = "isometric", {"by": "file"}
        what = "the length is held" if still else "no displacement"
        told.append(f"{what}: force over pressure at one contraction in each file")
        cycles = _found(guess, "ramp")
        if cycles > 1:
            guess.trials, guess.smallest_of = (
                {"by": "ramp", "smallest": f"{5 * _share(guess, 'pressure'):.3g}"},
                "pressure",
            )
            told.append(f"the pressure rises and falls {cycles} times: each is a trial")
    elif sine:
        guess.kind, guess.trials = "recorded-sine", {"by": "file"}
        guess.frequency = sine
        told.append(f"the command is a sine of {sine:.3g} Hz ({sine * 2 * np.pi:.3g} rad/s)")
    elif command is not None and (edge := _edge(command.values)) > 0:
        guess.kind, guess.smallest_of = "recorded-step", "pressure_command"
        guess.trials = {"by": "step", "smallest": f"{edge:.3g}", "lead": _lead(guess)}
        told.append("the command goes in steps: each is a trial")
    elif (waves := _found(guess, "sine")) > 0:
        guess.kind, guess.smallest_of = "recorded-sine", "pressure_command" if command is not None else "pressure"
        guess.trials = {"by": "sine", "smallest": f"{_share(guess, guess.smallest_of):.3g}"}
        told.append(f"{waves} stretches of one frequency each, found in the {guess.smallest_of.replace('_', ' ')}")
    elif command is None and (steps := _found(guess, "step")) > 0:
        guess.kind, guess.smallest_of = "recorded-step", "pressure"
        guess.trials = {"by": "step", "smallest": f"{_share(guess, 'pressure'):.3g}", "lead": _lead(guess)}
        told.append(
            f"no command was recorded; the measured pressure makes {steps} steps: each is a trial, without dead time"
        )
    else:
        guess.kind, guess.trials = "recorded-step", {"by": "file"}
        told.append("neither steps nor sines were found: the file is one trial")


def _lead(guess: Guess) -> str:
    """So long before its step a trial begins: 1 s, more where that is less than 50 samples."""
    return f"{max(1.0, 50.0 / (guess.rate[0] / 0.7)):.2g} s"


def _share(guess: Guess, role: str) -> float:
    """A tenth of the span of a channel, in its own unit."""
    column = guess.role(role)
    if column is None or not len(column.good):
        return 0.0
    return 0.1 * float(np.ptp(np.quantile(column.good[~lone(column.good)], [0.005, 0.995])))


def _found(guess: Guess, what: str) -> int:
    """How many steps, ramps or sines the pressure makes (sines: its command, where there is one)."""
    command = guess.role("pressure_command") if what == "sine" else None
    column, t = command or guess.role("pressure"), guess.seconds
    if column is None or t is None or len(t) < 50:
        return 0
    good = np.isfinite(column.values) & np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    good &= (column.values != 0) | (column.unit != "mA")
    smallest = _share(guess, column.role)
    if smallest <= 0 or good.sum() < 50:
        return 0
    t, values = t[good], column.values[good]
    t, values = t[~lone(values)], values[~lone(values)]
    if what == "ramp":
        return len(motion.cycles(t, values, 5 * smallest))
    return len(motion.waves(t, values, smallest) if what == "sine" else motion.levels(t, values, smallest))


def sine_of(t: Array, values: Array) -> float:
    """The frequency [Hz] of a channel that is one sine, shape (n,), `t` [s]; 0 where it is not."""
    good = np.isfinite(values) & np.concatenate([[True], np.diff(t) > 0])
    t, values = t[good], values[good]
    if len(t) < 50 or np.ptp(values) == 0:
        return 0.0
    low, high = np.quantile(values, [0.02, 0.98])
    even = np.linspace(t[0], t[-1], min(4096, len(t)))
    signal = np.interp(even, t, np.clip(values, low, high))
    power = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(even)))) ** 2
    peak = int(np.argmax(power[1:])) + 1
    share = float(power[max(1, peak - 3) : peak + 4].sum() / power[1:].sum())
    smooth = len(np.unique(np.round(values, 6))) > 8
    return float(peak / (t[-1] - t[0])) if share > 0.9 and peak >= 3 and smooth else 0.0


def _edge(values: Array) -> float:
    """Half of the smallest usual step of a command that rests at levels; 0 where it does not."""
    good = values[np.isfinite(values)]
    span = float(np.ptp(good)) if len(good) else 0.0
    if span == 0:
        return 0.0
    moves = np.abs(np.diff(good))
    big = moves > 0.02 * span
    if not 0 < big.sum() < 0.1 * len(good):
        return 0.0
    return 0.5 * float(np.quantile(moves[big], 0.05))


def _names(guess: Guess) -> None:
    """Dates, numbers of tests and points in the names of the files, or of their folders: whichever tell more."""
    found = (told_by(guess.files, of) for of in ("file", "folder"))
    best = max(found, key=lambda told: (len(told[0]), told[1] == "file"))
    keys, guess.form_of, forms, guess.form_units, guess.form_comma = best
    if keys and len(forms) <= 20:
        guess.forms = forms
        guess.reasons["name_tells"] = [f"the name of the {guess.form_of} tells {', '.join(sorted(keys))}"]


def _frequency(guess: Guess) -> None:
    """A sine whose frequency no name tells, or tells wrong, is fitted in each file, where that can be done."""
    if not guess.frequency:
        return
    told = frequency_of(guess.files[0], guess.form_of, guess.form_units)
    slowest = 1.0 / float(guess.seconds[-1] - guess.seconds[0]) if guess.seconds is not None else 0.0
    if (told is None or abs(told - guess.frequency) > 0.1 * told + 2 * slowest) and _found(guess, "sine") > 0:
        why = (
            "no name tells its frequency" if told is None else f"its name tells {told:.4g} Hz, and its command does not"
        )
        guess.smallest_of = "pressure_command"
        guess.trials = {"by": "sine", "smallest": f"{_share(guess, 'pressure_command'):.3g}"}
        guess.reasons["trials"].append(f"{why}: it is fitted to each file")


def _lacking(guess: Guess) -> None:
    """Without a pressure, or a force of an isometric test, one of the columns that are left is asked to be it."""
    needed = ("pressure", "force") if guess.kind == "isometric" else ("pressure",)
    guess.lacks = next((role for role in needed if guess.role(role) is None), "")
    ignored = [column for column in guess.columns if column.role == "ignore"]
    spare = next((column for column in guess.columns if column.role in {"pressure_command", "supply"}), None)
    if guess.lacks:
        for column in ignored:
            column.question = ""
    if guess.lacks == "pressure" and spare is not None:
        text = f'no measured pressure was found: is "{spare.name[:40]}" it (pressure), or'
        spare.question = f"{text} {spare.role} as its name says? Then nothing can be fitted"
    elif guess.lacks and ignored:
        ignored.sort(key=lambda column: len(column.values) == 0)
        odd = {column.name: f" ({OTHER_SIGN})" for column in ignored if OTHER_SIGN in column.reasons}
        names = ", ".join(f'"{column.name[:40]}"{odd.get(column.name, "")}' for column in ignored[:8])
        form = f"as {{is: {guess.lacks}, unit: {'bar' if guess.lacks == 'pressure' else 'N'}}}"
        text = f"which column is the {guess.lacks}? No name says it; there is {names}"
        ignored[0].question = f"{text}: write what it is and its unit, {form}"


def _known(path: Path) -> str:
    """The shipped map that takes a file as it is, without a fault and at the rate that it expects."""
    from pmabench.store.importers.importing import prepare

    if path.stat().st_size > LOOKED_AT:
        return ""
    for rules in _shipped():
        try:
            findings = prepare(path, rules).findings
        except (InvalidFile, PmaError):
            continue
        if not any(found.level == "fault" or found.kind == "rate" for found in findings):
            return Path(rules.path).stem
    return ""


@lru_cache(maxsize=1)
def _shipped() -> tuple[ImportMap, ...]:
    return tuple(read_map(each) for each in sorted(shipped_folder("map").glob("*.yaml")))
