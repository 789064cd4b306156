"""Names of columns: the words in them, their unit, and a factor of that.

Pure functions of texts.
"""

from __future__ import annotations

import re
from math import isfinite

from pmabench.store.importers.map_file import QUANTITY, spelled

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
_SHORT = re.compile(r"([pxfs])(set|setpoint|sp|cmd|command|ref|des|desired|soll|demand|target|ist)")
"""A quantity and what makes a command of it in one word: `Pset`; s is a length (German: Strecke)."""
BRACKETS = re.compile(r"[\[({][^\])}]*[\])}]")
SUPERSCRIPTS = str.maketrans("⁻⁺⁰¹²³⁴⁵⁶⁷⁸⁹", "-+0123456789")
_POWER = r"10\s*(?:\^|\*\*)\s*[-+]?\d+|1[eE][-+]?\d+"
_TEN = rf"(?:{_POWER}|10+|0[.,]0*1)"
"""A power of ten, but not 1: other numbers may be those of a sensor or an axis."""
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
    """A name without what it multiplies its unit by, and that as it is written: `x10`, `/10`, `10` of `[10 N]`.

    `Cell (500 N) [N]` multiplies by nothing: its unit is in brackets by itself.
    """
    name = re.sub("[⁻⁺]?[⁰¹²³⁴-⁹]+", lambda power: "^" + power[0].translate(SUPERSCRIPTS), name)
    span = found.span() if (found := _FACTOR.search(name)) else (0, 0)
    if found is None and not any(map(spelled, BRACKETS.findall(name))):
        every = _BEFORE.finditer(name)
        span = next((m.span(1 if m[1] else 3) for m in every if spelled(m[2] or m[4])), span)
    factor = name[slice(*span)].strip()
    return (name[: span[0]] + name[span[1] :], factor) if factor and value_of(factor) != 1.0 else (name, "")


def value_of(factor: str) -> float:
    """The number that a factor is as it is written; 0 where it is none."""
    base, _, power = re.findall(r"([\d.,]+(?:[eE][-+]?\d+)?)(\s*(?:\^|\*\*)\s*([-+]?\d{1,2}))?", factor)[-1]
    value = float(base.replace(",", ".")) ** int(power or 1)
    value = 1.0 / value if value and "/" in factor else value
    return value if isfinite(value) else 0.0


def unit_in(name: str) -> str:
    """The unit that a name carries: in brackets, else behind `_`, `/`, `,`, a blank or `in`; empty where none."""
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
    """The words of a name in lower case, without brackets, digits, the group before `/` and the unit behind it."""
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
