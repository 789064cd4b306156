"""Files whose units are odd, wrong or not known: labels, counts, absolute pressure (finding 8)."""

from __future__ import annotations

import numpy as np

from tests.store.foreign.case import NAME, Case, clean, fixed, lines, plain, text

PSI, KGF, LBF, AT = 6.894757, 9.80665, 4.448222, 98.0665
"""kPa, N, N, kPa in one."""
IMPLAUSIBLE = r"implausib|unit|plausib|too (high|low|large|small|steep|flat)|diameter|scale|\bbar\b"


def _labelled(
    name: str, header: str, P: float, F: float, words: str, digits: int = 3, *, damaged: bool = False
) -> Case:
    """The numbers of pressure and force multiplied, under a header."""
    test = clean(40 + len(name))
    rows = lines([fixed(test.t), fixed(test.P * P, digits), fixed(test.F * F, digits)])
    return Case(name, "scales", {NAME: text([header], rows)}, words, (test,), damaged=damaged)


def _counts(header: str, name: str) -> Case:
    test = clean(60)
    counts = np.rint(test.F / 1.7437 + 212).astype(int)
    rows = lines([fixed(test.t), fixed(test.P), map(str, counts)])
    words = r"count|calibrat|whole numbers|integer|raw|\?\?"
    return Case(name, "scales", {NAME: text([header], rows)}, words, (test,), damaged=True)


def _pooled() -> Case:
    """Two tests of a folder: one in newtons, one still in counts."""
    one, two = clean(61), clean(62)
    counts = np.rint(two.F / 1.7437 + 212)
    files = {NAME: plain(one.t, one.P, one.F), NAME.replace("test1", "test2"): plain(two.t, two.P, counts)}
    words = r"count|differ|other files|implausib|raw|disagree|peak|scale|whole"
    return Case("a file of newtons and one of counts", "scales", files, words, (one, two), damaged=True)


def _absolute() -> Case:
    test = clean(63)
    rows = lines([fixed(test.t), fixed(test.P + 101.3), fixed(test.F)])
    file = text(["time (s),abs. pressure (kPa),force (N)"], rows)
    return Case("absolute pressure", "scales", {NAME: file}, r"absolut|atmospher|gauge|ambient", (test,))


def _two_labels() -> Case:
    test = clean(64)
    rows = lines([fixed(test.t), fixed(test.P), fixed(test.F)])
    file = text(["time_s,pressure_bar,force_N", "s,kPa,N"], rows)
    return Case("name says bar and unit line kPa", "scales", {NAME: file}, r"unit|bar|kpa", (test,))


def _volts() -> Case:
    test = clean(65)
    rows = lines([fixed(test.t), fixed(0.5 + test.P / 250, 4), fixed(test.F)])
    file = text(["time (s),pressure (V),force (N)"], rows)
    return Case("pressure in volts without a calibration", "scales", {NAME: file}, r"\bV\b|volt|calibrat|\?\?", (test,))


def _no_units() -> Case:
    """Three names and no unit anywhere; 600 kPa read as 600 psi or mbar would do as well."""
    test = clean(66)
    file = plain(test.t, test.P / PSI, test.F, "t,p,f")
    return Case("no unit anywhere", "scales", {NAME: file}, r"unit|\?\?", (test,), damaged=True)


def _diameter() -> Case:
    """The first millimetres in the name are those of the muscle, not of the contraction."""
    test = clean(67)
    file = plain(test.t, test.P, test.F)
    names = {"muscle20mm_contraction5mm_test1.csv": file}
    return Case("diameter and contraction in the name", "scales", names, r"contraction|name", (test,))


def _no_contraction() -> Case:
    test = clean(68)
    file = plain(test.t, test.P, test.F)
    return Case("no contraction in the name", "scales", {"log_0042.csv": file}, r"contraction", (test,))


def _commanded() -> Case:
    """The commanded pressure comes first and is smoother and cleaner than the measured one."""
    test = clean(69)
    asked = np.round(np.interp(test.t - 0.4, test.t, test.P), -1)
    rows = lines([fixed(test.t), fixed(asked, 0), fixed(test.P), fixed(test.F)])
    file = text(["time (s),Pset [kPa],Pact [kPa],F [N]"], rows)
    return Case("commanded and measured pressure", "scales", {NAME: file}, r"pset|which|command", (test,))


def _pushes() -> Case:
    """The cell reads pulling as negative."""
    test = clean(70)
    file = plain(test.t, test.P, -test.F)
    words = r"sign|negative|push|falls|direction|polarity"
    return Case("pulling is negative", "scales", {NAME: file}, words, (test,), damaged=True)


def cases() -> list[Case]:
    """Right where the label says it, asked or refused where nothing does."""
    return [
        _labelled("bar labelled kPa", "time (s),pressure (kPa),force (N)", 0.01, 1, IMPLAUSIBLE, 4, damaged=True),
        _labelled("psi labelled kPa", "time (s),pressure (kPa),force (N)", 1 / PSI, 1, IMPLAUSIBLE, damaged=True),
        _labelled("MPa labelled bar", "time (s),pressure (bar),force (N)", 1e-3, 1, IMPLAUSIBLE, 6, damaged=True),
        _labelled("N labelled kN", "time (s),pressure (kPa),force (kN)", 1, 1, IMPLAUSIBLE, damaged=True),
        _labelled("force in kg", "time (s),pressure (kPa),force (kg)", 1, 1 / KGF, r"kg|unit|mass"),
        _labelled("force in lbf", "time (s),pressure (kPa),force (lbf)", 1, 1 / LBF, r"lbf|unit"),
        _labelled("pressure in psig", "time (s),pressure (psig),force (N)", 1 / PSI, 1, r"psi|unit"),
        _labelled("pressure in kgf/cm2", "time (s),pressure (kgf/cm2),force (N)", 1 / AT, 1, r"kgf|unit", 5),
        _labelled("pressure in kg/cm² and kgf", "time (s),P (kg/cm²),F (kgf)", 1 / AT, 1 / KGF, r"kg|unit", 5),
        _labelled("pressure in mmHg", "time [s],pressure [mmHg],force [N]", 7.50062, 1, r"mmhg|unit"),
        _counts("time (s),pressure (kPa),force", "counts without a unit"),
        _counts("time (s),pressure (kPa),force (N)", "counts labelled N"),
        _pooled(),
        _absolute(),
        _two_labels(),
        _volts(),
        _no_units(),
        _diameter(),
        _no_contraction(),
        _labelled("pressure in mbar", "time (s),pressure (mbar),force (N)", 10, 1, r"mbar|unit"),
        _labelled("force in kN, three digits", "time (s),pressure (kPa),force (kN)", 1, 1e-3, r"kn|unit|step", 6),
        _commanded(),
        _pushes(),
    ]
