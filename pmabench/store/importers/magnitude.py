"""Checks whether pressures and forces are possible for a muscle: its size bounds the force, whatever the units.

Braided muscles obey F = P (pi D0^2/4) (3 cos^2 a - 1)/sin^2 a at most (Chou and Hannaford 1996, eq. 8 at no
contraction; D0 inner diameter, a braid angle from the axis). Measured slopes of muscles of 10, 20 and 40 mm are 8 to
10 times pi D0^2/4, and fall with contraction and for short muscles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, inf, pi, radians, sin, sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import motion
from pmabench.store.importers.found import Bools, Checked, Report, in_words, slope
from pmabench.store.importers.map_file import Question, spelled
from pmabench.store.records import UNUSABLE, Array, Flags

STEEPEST = 17.0
"""Smallest braid angle made [deg]; it gives the largest force for a diameter."""
USUAL = 12.0
"""Force per pressure and bore area [1] that real muscles hardly exceed."""
FLATTEST = 42.0
"""Largest braid angle of a useful muscle [deg]; it gives the least force of long muscles at zero contraction."""
DIAMETERS = (0.004, 0.1)
"""Smallest and largest inner diameter of muscles [m]."""
LONG = 5.0
"""Ratio of length to diameter above which end effects do not weaken a muscle [1]."""
HELD = 0.05
"""Largest relative contraction at which the least force applies [1]."""
SHARE, NEAR = 0.7, 0.01
"""Share of the least force that a muscle of several lengths shows where it is longest, within this share of its length:
the force that stretches the bladder is not taken off.
"""
WEAK = 2.5
"""Force per pressure and bore area [1] of long muscles that is rarely that small."""
PEAKS = (15e3, 2.5e6)
"""Possible range of the highest gauge pressure of a test [Pa]: less opens no bladder, more bursts it."""
PSI = 6894.757
UNITS_OF_PRESSURE = {"kPa": 1e3, "bar": 1e5, "psi": PSI, "MPa": 1e6}
LOW, USUAL_PEAKS = (15e3, 180e3), (100e3, 1.25e6)
"""Range of peaks that are low for muscles [Pa], and range in which they must be in another unit to ask for it."""
FILLED, RESOLVED = 0.015, 10
"""Shortest time in which a valve fills a muscle [s], and least number of samples of a rise."""
PULLS = 0.1
"""Share of its span above its lowest value from which on a force counts as pulling."""
EXCHANGED = 0.1
"""A force of a held muscle moves less than this share of its span while the pressure is at its lowest."""
ATMOSPHERE = (90e3, 106e3)
"""Range of atmospheric pressure [Pa absolute], up to 900 m above sea level."""
LENGTHS = (3e-4, 3.0)
"""Possible range of the highest reading of a length [m]: less is no motion, more no muscle."""
VACUUM = -30e3
"""Lowest possible gauge pressure in a muscle [Pa]."""
MANY = 100
"""Least number of samples that show whether a channel has whole numbers only."""

WRONG = "the unit or the scale of force or pressure is wrong, or the inner diameter"
CONFUSED = {
    "is the pressure in bar, not kPa?": 1e-2,
    "is the pressure in psi, not kPa?": 1e3 / PSI,
    "is the pressure in MPa, not kPa?": 1e-3,
    "is the pressure in kPa, not bar?": 1e2,
    "is the force in kg, not N?": 9.80665,
    "is the force in pounds, not N?": 4.448,
    "is the force in kN, not N?": 1e3,
    "is the force in grams, not N?": 9.80665e-3,
}
"""Question -> factor on the slope if the answer is yes."""


@dataclass(frozen=True)
class Muscle:
    """Known facts about specimen and operating point [SI]; None where unknown."""

    diameter: float | None
    length: float | None
    contraction: float | None
    held: bool
    """Whether its length is held constant, so that force follows pressure."""
    moves: bool = True
    """Whether its length changes within the test; where it is only set, a trial may be at full length throughout."""
    driven: bool = False
    """Whether its length is set from outside, to one value or to several, so that it pulls as hard as it can."""


def slope_of_held(values: Mapping[str, Array], flags: Flags) -> float | None:
    """Slope of force over pressure where the muscle pulls [N/Pa], from usable samples, shape (n,); None without."""
    good = (flags & np.uint16(UNUSABLE)) == 0
    if not {"pressure", "force"} <= set(values) or not good.any():
        return None
    return slope_of(values["pressure"][good], values["force"][good])


def area_factor(angle: float) -> float:
    """Force per pressure and bore area [1] at zero contraction for a braid angle [deg]."""
    a = radians(angle)
    return (3.0 * cos(a) ** 2 - 1.0) / sin(a) ** 2


def judge(
    report: Report, channels: Mapping[str, Checked], good: Bools, muscle: Muscle, set_length: Checked | None = None
) -> list[Question]:
    """Report pressures and forces that are impossible for a muscle; returns questions that numbers cannot decide."""
    pressure, force = channels.get("pressure"), channels.get("force")
    if pressure is None or good.sum() < 20:
        return []
    P = pressure.si[good]
    questions = _lengths(channels, good, LENGTHS[0] if muscle.moves else 0.0)
    if force is not None:
        questions += _converter(report, force, good)
    if (fastest := _fastest(report.t[good], P)) < FILLED:
        questions.append(_pace(fastest))
    peak = float(np.quantile(P, 0.999))
    command = channels.get("pressure_command")
    asked = 0.0 if command is None else float(np.quantile(command.si[good], 0.999))
    for role, top in (("pressure", peak), *([("pressure_command", asked)] if asked else [])):
        if not PEAKS[0] <= top <= PEAKS[1]:
            text = f"its peak is {show(top, 'pressure', 4)}, and muscles need {show(PEAKS[0], 'pressure')} at least "
            text += f"and bear {show(PEAKS[1], 'pressure')} at most: its unit or its scale is wrong{_other_unit(top)}"
            report.withhold("magnitude", text, role)
            return questions
    if float(np.quantile(P, 0.02)) < VACUUM:
        low = show(float(np.quantile(P, 0.02)), "pressure", 3)
        report.add("doubt", "zero", f"falls to {low}, as no supply does: its zero or its scale is doubtful", "pressure")
    if force is None:
        return questions if muscle.diameter else [*questions, *_low(pressure, peak)]
    F = force.si[good]
    questions += _absolute(P, F)
    if muscle.held:
        _exchanged(report, P, F)
    m = slope_of(P, F) if muscle.held else _steepest(P, F)
    if m is not None:
        questions += _steep(report, m, peak, muscle, pressure)
    lengths = set_length or channels.get("displacement")
    if muscle.held:
        questions += _weak(report, m, 1.0, muscle, force)
    elif muscle.driven and muscle.length and lengths is not None:
        questions += _weak(report, _longest(P, F, lengths.si[good], muscle.length), SHARE, muscle, force)
    return questions


def _longest(P: Array, F: Array, x: Array, length: float) -> float | None:
    """Slope of force over pressure, or their ratio where that is one, at the least contraction; None above `HELD`."""
    least = float(np.nanmin(x)) if np.isfinite(x).any() else np.inf
    near = x <= least + NEAR * length
    if least > HELD * length:
        return None
    return slope_of(P[near], F[near]) if np.ptp(P[near]) > 0.5 * P.max() else _steepest(P[near], F[near])


def _weak(report: Report, m: float | None, share: float, muscle: Muscle, force: Checked) -> list[Question]:
    """Compare the force per pressure [N/Pa] at hardly any contraction with the least for the inner diameter."""
    area = pi * (muscle.diameter or 0.0) ** 2 / 4.0
    if m is None or not 0 < m < WEAK * area or not _long(muscle) or (muscle.held and not _stretched(muscle)):
        return []
    units = _units(m, lambda x: 2.0 * area <= x <= 14.0 * area)
    text = f"where the muscle is longest force over pressure is {in_words(m, 'force')}, {m / area:.2g} times the area "
    text += f"of a bore of {show(muscle.diameter or 0.0, 'length', 3)}"
    if m < share * area_factor(FLATTEST) * area:
        if not muscle.held:  # of a held one `_steep` says it
            text += f"; braids give {area_factor(FLATTEST):.2g} times at least: {WRONG}"
            report.withhold("magnitude", text + units, "force")
        return []
    asked = f"is the force in {force.rule.raw_unit}, as the map says?{units} {text[0].upper()}{text[1:]}, "
    asked += "where long muscles give 8 to 10 times; correct the unit, or say confirmed: [force-unit]"
    return [Question("force-unit", force.rule.column, asked, force.rule.raw_unit)]


def slope_of(P: Array, F: Array) -> float | None:
    """Slope of force over pressure where the muscle pulls; over all samples if that is at one pressure only."""
    low = float(np.quantile(F, 0.02))
    pulls = low + PULLS * float(np.quantile(F, 0.998) - low) < F
    if not pulls.any() or np.ptp(np.quantile(P[pulls], [0.05, 0.95])) < 0.2 * np.ptp(P):
        return slope(P, F)
    return slope(P[pulls], F[pulls])


def _steepest(P: Array, F: Array) -> float | None:
    """Median force per pressure [N/Pa] above half of the peak pressure; None without samples there."""
    high = 0.5 * float(np.quantile(P, 0.999)) < P
    return float(np.median(F[high] / P[high])) if high.any() else None


def _steep(report: Report, m: float, peak: float, muscle: Muscle, pressure: Checked) -> list[Question]:
    """Compare the force per pressure `m` [N/Pa] with the range possible for the inner diameter, and report."""
    most = area_factor(STEEPEST)
    word = "slope of force over pressure" if muscle.held else "force over pressure"
    thinnest = 0.1 * area_factor(FLATTEST) * pi * DIAMETERS[0] ** 2 / 4.0
    if m < 0 and (muscle.held or abs(m) > thinnest):
        text = f"{word} is {in_words(m, 'force')}: a muscle pulls harder at more pressure, and pulling is positive; "
        text += "where the cell reads it as negative say line: {slope: -1 N/N, offset: 0 N}"
        report.withhold("magnitude", text, "force")
        return []
    if muscle.diameter is None:
        size = sqrt(4.0 * abs(m) / (pi * area_factor(25.0)))
        limit = most * pi * DIAMETERS[1] ** 2 / 4.0
        least = thinnest * (10.0 if _stretched(muscle) else 1.0)
        if least <= abs(m) <= limit or (not muscle.held and abs(m) < least):
            if muscle.held:
                text = f"{word} of {in_words(m, 'force')} suits an inner diameter of about {show(size, 'length', 2)}"
                report.add(
                    "note", "size", f"{text}; the map gives none, so the units were held against no size", "force"
                )
            return _low(pressure, peak)
        text = (
            f"{word} is {in_words(m, 'force')}; muscles of {show(DIAMETERS[0], 'length')} to "
            f"{show(DIAMETERS[1], 'length')} give {in_words(least, 'force')} to {in_words(limit, 'force')} (this would "
            f"be one of about {show(size, 'length', 2)}): the unit or the scale of force or pressure is wrong"
        )
        report.withhold("magnitude", text + _units(m, lambda x: least <= x <= limit), "force")
        return []
    area = pi * muscle.diameter**2 / 4.0
    least = area_factor(FLATTEST) * area if muscle.held and _long(muscle) and _stretched(muscle) else 0.0
    if least <= m <= most * area:
        return _low(pressure, peak) if m > USUAL * area else []
    low = f"{in_words(least, 'force')} to" if least else "at most"
    text = f"{word} is {in_words(m, 'force')}; a muscle of {show(muscle.diameter, 'length', 3)} gives {low} "
    text += f"{in_words(most * area, 'force')}: {WRONG}"
    report.withhold("magnitude", text + _units(m, lambda x: max(least, 2.0 * area) <= x <= 14.0 * area), "force")
    return []


def _long(muscle: Muscle) -> bool:
    """Whether its ends do not weaken a muscle."""
    return muscle.length is not None and muscle.diameter is not None and muscle.length >= LONG * muscle.diameter


def _stretched(muscle: Muscle) -> bool:
    """Whether the muscle is known to be hardly contracted."""
    return muscle.contraction is not None and abs(muscle.contraction) <= HELD * (muscle.length or 0.0)


def _units(m: float, fits: Callable[[float], bool]) -> str:
    """Questions about units that would make a slope plausible, for a message."""
    asked = [text for text, factor in CONFUSED.items() if fits(abs(m) * factor)]
    return f" ({' '.join(asked)})" if asked else ""


def _other_unit(peak: float) -> str:
    """Questions about units in which a peak of the pressure [Pa] would be usual, for a message."""
    shown = peak / 1e3
    names = {"bar": 1e5, "psi": PSI, "MPa": 1e6, "Pa": 1.0}
    asked = [f"is it {name}?" for name, factor in names.items() if 80e3 <= shown * factor <= 1.2e6]
    return f" ({' '.join(asked)})" if asked else ""


def _low(pressure: Checked, peak: float) -> list[Question]:
    """Question whether a low pressure has another unit; empty where the pressure is not low."""
    unit = pressure.rule.raw_unit
    if unit not in UNITS_OF_PRESSURE or not LOW[0] <= peak <= LOW[1]:
        return []
    number = peak / UNITS_OF_PRESSURE[unit]
    others = {
        other: show(number * factor, "pressure", 3)
        for other, factor in UNITS_OF_PRESSURE.items()
        if other != unit and USUAL_PEAKS[0] <= number * factor <= USUAL_PEAKS[1]
    }
    if not others:
        return []
    asked = " or ".join(f"in {other} ({value})" for other, value in others.items())
    question = (
        f"is the pressure in {unit}, as the map says, or {asked}? Its peak, {number:.4g}, is low for {unit}; say "
        "specimen inner_diameter, by which the force may decide it, or confirmed: [pressure-unit]"
    )
    return [Question("pressure-unit", pressure.rule.column, question, unit)]


def _fastest(t: Array, P: Array) -> float:
    """Shortest 10 % to 90 % rise time of the pressure [s], of rises that the samples resolve; else infinite."""
    stride = 1 + len(t) // 50_000
    forward = motion.later(t)
    times, values = t[forward][::stride], P[forward][::stride]
    shortest = inf
    for cycle in motion.cycles(times, values, 0.5 * float(np.ptp(values))):
        rise = values[(times >= cycle.begin) & (times <= cycle.turn)]
        low, high = float(rise[0]), float(rise[-1])
        between = int(np.count_nonzero((rise > 0.9 * low + 0.1 * high) & (rise < 0.1 * low + 0.9 * high)))
        if between * stride >= RESOLVED:
            shortest = min(shortest, between * float(np.median(np.diff(times))))
    return shortest


def _pace(seconds: float) -> Question:
    """Question whether the time has another unit."""
    question = (
        f"what is the unit of time? As the map says it the pressure rises within {1e3 * seconds:.3g} ms, and no valve "
        f"fills a muscle in less than {1e3 * FILLED:g} ms; correct the unit, or say confirmed: [time-unit]"
    )
    return Question("time-unit", "time", question, "the unit of the map")


def _exchanged(report: Report, P: Array, F: Array) -> None:
    """Report force and pressure of a held muscle that look exchanged: force moves while pressure is at its lowest.

    A contracted muscle pulls only above some pressure: its force rests while the pressure moves.
    """
    moves, rests = (_at_lowest(*pair) for pair in ((P, F), (F, P)))
    if moves > EXCHANGED and rests < EXCHANGED / 4:
        text = f"moves by {100 * moves:.0f} % of its span while the pressure rests at its lowest, as no muscle does "
        report.withhold("swap", text + "that is held: the columns of force and pressure look exchanged", "force")


def _at_lowest(rests: Array, moves: Array) -> float:
    """Motion of one channel while the other is within 3 % of its lowest value, as a share of its span."""
    near = moves[rests <= np.quantile(rests, 0.02) + 0.03 * np.ptp(rests)]
    return float(np.ptp(np.quantile(near, [0.1, 0.9])) / np.ptp(np.quantile(moves, [0.002, 0.998])))


def _lengths(channels: Mapping[str, Checked], good: Bools, least: float) -> list[Question]:
    """Questions for the units of lengths that are impossible at their highest; `least` [m] it must reach."""
    lengths = [channels[role] for role in ("displacement", "displacement_command") if role in channels]
    tops = [(channel.rule, float(np.quantile(np.abs(channel.si[good]), 0.995))) for channel in lengths]
    text = "is the length in {}, as the map says? It is {} at most; correct the unit, or say confirmed: [length-unit]"
    return [
        Question("length-unit", rule.column, text.format(rule.raw_unit, show(top, "length", 3)), rule.raw_unit)
        for rule, top in tops
        if top and not least <= top <= LENGTHS[1]
    ]


def _absolute(P: Array, F: Array) -> list[Question]:
    """Question whether a pressure is absolute that rests near atmospheric pressure while the muscle does not pull."""
    low, rest = float(np.quantile(P, 0.005)), float(np.quantile(F, 0.02))
    near = P <= low + 0.03 * float(np.ptp(P))
    pulls = rest + 0.05 * float(np.quantile(F, 0.998) - rest) < F
    if not ATMOSPHERE[0] <= low <= ATMOSPHERE[1] or float(pulls[near].mean()) > 0.1:
        return []
    text = f"is the pressure absolute? It rests at {show(low, 'pressure', 4)} where the muscle does not pull; then its "
    text += "line in the map needs offset: -101.325 kPa, which moves the intercept of force over pressure; if not, say "
    text += "confirmed: [absolute]"
    return [Question("absolute", "pressure", text, "gauge")]


def _converter(report: Report, channel: Checked, good: Bools) -> list[Question]:
    """Report a force of whole numbers, probably counts: a question if its name gives the unit, else a fault."""
    rule = channel.rule
    numbers = (channel.raw * rule.back[0] + rule.back[1])[good]
    marks = np.unique(numbers)
    if len(numbers) < MANY or len(marks) < 3:
        return []
    whole = bool(np.all(marks == np.round(marks)))
    scaled = rule.raw_unit in {"count", "g", "Pa", "mV", "mbar", "hPa", "um"}
    if not whole or scaled or float(np.abs(marks).max()) < 50:
        return []
    text = (
        f"holds whole numbers only, {marks[0]:g} to {marks[-1]:g}, and they are called {rule.raw_unit}: are they "
        'counts of a converter? Then say "unit: count" and the line of its calibration; if not, confirmed: [counts]'
    )
    if spelled(rule.column) == rule.raw_unit or _names_unit(rule.column, rule.raw_unit):
        return [Question("counts", rule.column, text, rule.raw_unit)]
    report.withhold("counts", text, rule.role)
    return []


def _names_unit(column: str, unit: str) -> bool:
    """Whether the name of a column gives the unit."""
    return any(spelled(part) == unit for part in column.replace("[", " [").replace("(", " (").replace("_", " ").split())
