"""Checks whether pressures and forces are possible for a muscle: its size bounds the force, whatever the units.

Braided muscles obey F = P (pi D0^2/4) (3 cos^2 a - 1)/sin^2 a at most (Chou and Hannaford 1996, eq. 8 at no
contraction; D0 inner diameter, a braid angle from the axis). Measured slopes of muscles of 10, 20 and 40 mm are 8 to
10 times pi D0^2/4, and fall with contraction and for short muscles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, inf, pi, radians, sin, sqrt

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import motion
from pmabench.store.importers.found import Bools, Checked, Report, in_words, slope
from pmabench.store.importers.map_file import spelled
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
PRESSURES = ("pressure", "pressure_command")
PSI = 6894.757
OTHERS = {"bar": 1e5, "psi": PSI, "MPa": 1e6, "Pa": 1.0}
"""Units that are asked for where a pressure taken for kPa is impossible."""
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
FINE = {"count", "g", "Pa", "mV", "mbar", "hPa", "um"}
"""Units in which whole numbers are usual readings."""

WRONG = "the unit or the scale of force or pressure is wrong"
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

    @property
    def area(self) -> float:
        """Area of the bore [m2]; 0 where the diameter is not known."""
        return pi * (self.diameter or 0.0) ** 2 / 4.0

    @property
    def long(self) -> bool:
        """Whether its ends do not weaken it."""
        return self.length is not None and self.diameter is not None and self.length >= LONG * self.diameter

    @property
    def stretched(self) -> bool:
        """Whether it is known to be hardly contracted."""
        return self.contraction is not None and abs(self.contraction) <= HELD * (self.length or 0.0)


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
) -> None:
    """Report pressures and forces that are impossible for a muscle, and ask what the numbers cannot decide."""
    pressure, force = channels.get("pressure"), channels.get("force")
    if pressure is None or good.sum() < 20:
        return
    P = pressure.si[good]
    _lengths(report, channels, good, LENGTHS[0] if muscle.moves else 0.0)
    if force is not None:
        _converter(report, force, good)
    _pace(report, P, good)
    peaks = {role: float(np.quantile(channels[role].si[good], 0.999)) for role in PRESSURES if role in channels}
    for role, top in peaks.items():
        if not PEAKS[0] <= top <= PEAKS[1] and (top or role == "pressure"):
            text = f"its peak is {show(top, 'pressure', 4)}, and muscles need {show(PEAKS[0], 'pressure')} at least "
            text += f"and bear {show(PEAKS[1], 'pressure')} at most: its unit or its scale is wrong"
            other = [f"is it {name}?" for name, factor in OTHERS.items() if 80e3 <= top / 1e3 * factor <= 1.2e6]
            report.withhold("magnitude", text + _in_brackets(other), role)
            return
    lowest = float(np.quantile(P, 0.02))
    if lowest < VACUUM:
        text = f"falls to {show(lowest, 'pressure', 3)}, as no supply does: its zero or its scale is doubtful"
        report.add("doubt", "zero", text, "pressure")
    peak = peaks["pressure"]
    if force is None:
        if not muscle.diameter:
            _low(report, pressure, peak)
        return
    F = force.si[good]
    _absolute(report, P, F)
    if muscle.held:
        _exchanged(report, P, F)
    m = slope_of(P, F) if muscle.held else _steepest(P, F)
    if m is not None and _steep(report, m, muscle):
        _low(report, pressure, peak)
    lengths = set_length or channels.get("displacement")
    if muscle.held:
        _weak(report, m, 1.0, muscle, force)
    elif muscle.driven and muscle.length and lengths is not None:
        _weak(report, _longest(P, F, lengths.si[good], muscle.length), SHARE, muscle, force)


def _longest(P: Array, F: Array, x: Array, length: float) -> float | None:
    """Slope of force over pressure, or their ratio where that is one, at the least contraction; None above `HELD`."""
    least = float(np.nanmin(x)) if np.isfinite(x).any() else np.inf
    if least > HELD * length:
        return None
    near = x <= least + NEAR * length
    return slope_of(P[near], F[near]) if np.ptp(P[near]) > 0.5 * P.max() else _steepest(P[near], F[near])


def _weak(report: Report, m: float | None, share: float, muscle: Muscle, force: Checked) -> None:
    """Compare the force per pressure [N/Pa] at hardly any contraction with the least for the inner diameter."""
    if m is None or not 0 < m < WEAK * muscle.area or not muscle.long or (muscle.held and not muscle.stretched):
        return
    units = _units(m, 2.0 * muscle.area, 14.0 * muscle.area)
    text = f"where the muscle is longest force over pressure is {in_words(m, 'force')}, {m / muscle.area:.2g} times "
    text += f"the area of a bore of {show(muscle.diameter or 0.0, 'length', 3)}"
    if m >= share * area_factor(FLATTEST) * muscle.area:
        unit = force.rule.raw_unit
        text = f"is the force in {unit}, as the map says?{units} W{text[1:]}, where long muscles give 8 to 10 times; "
        report.ask("force-unit", force.rule.column, f"{text}correct the unit, or say confirmed: [force-unit]", unit)
    elif not muscle.held:  # of a held one `_steep` says it
        text += f"; braids give {area_factor(FLATTEST):.2g} times at least: {WRONG}, or the inner diameter"
        report.withhold("magnitude", text + units, "force")


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


def _steep(report: Report, m: float, muscle: Muscle) -> bool:
    """Report a force per pressure `m` [N/Pa] outside the possible range; whether a low pressure remains doubtful."""
    steepest, flattest = area_factor(STEEPEST), area_factor(FLATTEST)
    word = "slope of force over pressure" if muscle.held else "force over pressure"
    text = f"{word} is {in_words(m, 'force')}"
    thinnest, thickest = (pi * diameter**2 / 4.0 for diameter in DIAMETERS)
    thinnest *= 0.1 * flattest
    if m < 0 and (muscle.held or abs(m) > thinnest):
        text += ": a muscle pulls harder at more pressure, and pulling is positive; where the cell reads it as "
        report.withhold("magnitude", f"{text}negative say line: {{slope: -1 N/N, offset: 0 N}}", "force")
    elif muscle.diameter is None:
        size = show(sqrt(4.0 * abs(m) / (pi * area_factor(25.0))), "length", 2)
        least, most = thinnest * (10.0 if muscle.stretched else 1.0), steepest * thickest
        if abs(m) <= most and (abs(m) >= least or not muscle.held):
            if muscle.held:
                text = f"{word} of {in_words(m, 'force')} suits an inner diameter of about {size}; the map gives none, "
                report.add("note", "size", f"{text}so the units were held against no size", "force")
            return True
        text += f"; muscles of {' to '.join(show(end, 'length') for end in DIAMETERS)} give {in_words(least, 'force')} "
        text += f"to {in_words(most, 'force')} (this would be one of about {size}): {WRONG}"
        report.withhold("magnitude", text + _units(m, least, most), "force")
    else:
        sure = muscle.held and muscle.long and muscle.stretched
        least, most = flattest * muscle.area * sure, steepest * muscle.area
        if least <= m <= most:
            return m > USUAL * muscle.area
        low = f"{in_words(least, 'force')} to" if least else "at most"
        text += f"; a muscle of {show(muscle.diameter, 'length', 3)} gives {low} {in_words(most, 'force')}: {WRONG}, "
        text += "or the inner diameter"
        report.withhold("magnitude", text + _units(m, max(least, 2.0 * muscle.area), 14.0 * muscle.area), "force")
    return False


def _units(m: float, least: float, most: float) -> str:
    """Questions about units with which a slope would be within these limits, for a message."""
    return _in_brackets([text for text, factor in CONFUSED.items() if least <= abs(m) * factor <= most])


def _in_brackets(questions: Sequence[str]) -> str:
    return f" ({' '.join(questions)})" if questions else ""


def _low(report: Report, pressure: Checked, peak: float) -> None:
    """Ask whether a low pressure has another unit."""
    unit = pressure.rule.raw_unit
    if unit not in UNITS_OF_PRESSURE or not LOW[0] <= peak <= LOW[1]:
        return
    number = peak / UNITS_OF_PRESSURE[unit]
    others = {other: number * factor for other, factor in UNITS_OF_PRESSURE.items() if other != unit}
    if asked := " or ".join(
        f"in {other} ({show(value, 'pressure', 3)})"
        for other, value in others.items()
        if USUAL_PEAKS[0] <= value <= USUAL_PEAKS[1]
    ):
        text = f"is the pressure in {unit}, as the map says, or {asked}? Its peak, {number:.4g}, is low for {unit}; "
        text += "say specimen inner_diameter, by which the force may decide it, or confirmed: [pressure-unit]"
        report.ask("pressure-unit", pressure.rule.column, text, unit)


def _pace(report: Report, pressure: Array, good: Bools) -> None:
    """Ask for the unit of time where the pressure rises faster than a valve can fill a muscle.

    The fastest rise, from 10 % to 90 %, counts, of those that the samples resolve.
    """
    stride = 1 + len(pressure) // 50_000
    t = report.t[good]
    forward = motion.later(t)
    t, P = t[forward][::stride], pressure[forward][::stride]
    shortest = inf
    for cycle in motion.cycles(t, P, 0.5 * float(np.ptp(P))):
        rise = P[(t >= cycle.begin) & (t <= cycle.turn)]
        low, high = float(rise[0]), float(rise[-1])
        between = int(np.count_nonzero((rise > 0.9 * low + 0.1 * high) & (rise < 0.1 * low + 0.9 * high)))
        if between * stride >= RESOLVED:
            shortest = min(shortest, between * float(np.median(np.diff(t))))
    if shortest < FILLED:
        text = f"what is the unit of time? As the map says it the pressure rises within {1e3 * shortest:.3g} ms, and "
        text += f"no valve fills a muscle in less than {1e3 * FILLED:g} ms; correct the unit, or say confirmed: "
        report.ask("time-unit", "time", f"{text}[time-unit]", "the unit of the map")


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


def _lengths(report: Report, channels: Mapping[str, Checked], good: Bools, least: float) -> None:
    """Ask for the units of lengths that are impossible at their highest; `least` [m] it must reach."""
    for channel in (channels[role] for role in ("displacement", "displacement_command") if role in channels):
        top, unit = float(np.quantile(np.abs(channel.si[good]), 0.995)), channel.rule.raw_unit
        if top and not least <= top <= LENGTHS[1]:
            text = f"is the length in {unit}, as the map says? It is {show(top, 'length', 3)} at most; correct the "
            report.ask("length-unit", channel.rule.column, f"{text}unit, or say confirmed: [length-unit]", unit)


def _absolute(report: Report, P: Array, F: Array) -> None:
    """Ask whether a pressure is absolute that rests near atmospheric pressure while the muscle does not pull."""
    low, rest = float(np.quantile(P, 0.005)), float(np.quantile(F, 0.02))
    near = P <= low + 0.03 * float(np.ptp(P))
    pulls = rest + 0.05 * float(np.quantile(F, 0.998) - rest) < F
    if ATMOSPHERE[0] <= low <= ATMOSPHERE[1] and not float(pulls[near].mean()) > 0.1:
        text = f"is the pressure absolute? It rests at {show(low, 'pressure', 4)} where the muscle does not pull; then "
        text += "its line in the map needs offset: -101.325 kPa, which moves the intercept of force over pressure; if "
        report.ask("absolute", "pressure", f"{text}not, say confirmed: [absolute]", "gauge")


def _converter(report: Report, channel: Checked, good: Bools) -> None:
    """Report a force of whole numbers, probably counts: a question if its name gives the unit, else a fault."""
    rule = channel.rule
    marks = np.unique(channel.numbers[good])
    whole = bool(np.all(marks == np.round(marks))) and rule.raw_unit not in FINE
    if good.sum() < MANY or len(marks) < 3 or not whole or float(np.abs(marks).max()) < 50:
        return
    text = f"holds whole numbers only, {marks[0]:g} to {marks[-1]:g}, and they are called {rule.raw_unit}: are they "
    text += 'counts of a converter? Then say "unit: count" and the line of its calibration; if not, confirmed: [counts]'
    parts = (rule.column, *rule.column.replace("[", " [").replace("(", " (").replace("_", " ").split())
    if any(spelled(part) == rule.raw_unit for part in parts):  # its name gives the unit
        report.ask("counts", rule.column, text, rule.raw_unit)
    else:
        report.withhold("counts", text, rule.role)
