"""What the names of files and folders contain: dates, numbers of tests, operating points; reads no file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import pi
from pathlib import Path

_PARTS = (
    (re.compile(r"\d{4}-\d{2}-\d{2}"), "date", ""),
    (re.compile(r"(?<=\{date\}[_T -])\d{6}(?!\d)"), "clock", ""),
    (re.compile(r"(?<=rads[-_])\d+(?:[.,]\d+)?|(?<=rad-s[-_])\d+(?:[.,]\d+)?"), "frequency", "rad/s"),
    (re.compile(r"\d+(?:[.,]\d+)?(?=[_-]?Hz)"), "frequency", "Hz"),
    (re.compile(r"(?<=[A-Za-z_-])\d+(?:[.,]\d+)?(?=kPa)"), "pressure", "kPa"),
    (re.compile(r"(?<=[A-Za-z_-])\d+(?:[.,]\d+)?(?=bar)"), "pressure", "bar"),
    (re.compile(r"(?<=[A-Za-z_-])\d+(?:[.,]\d+)?(?=kg)"), "mass", "kg"),
    (re.compile(r"(?<=[A-Za-z_-])\d+(?:[.,]\d+)?(?=mm)"), "contraction", "mm"),
    (re.compile(r"(?<=[Tt]est)\d{1,6}|(?<=[Rr]un)\d{1,6}|(?<=[Tt]rial)\d{1,6}"), "test", ""),
)
CONTRACTED = re.compile(
    r"(kink(ed)?|contract(ion|ed)?|contr|held|hold|at|shortened|short|x|dx|eps)[-_ ]?$", re.IGNORECASE
)
"""What comes before a length that is a contraction, and no diameter."""


def found_in(
    files: Sequence[Path], of: str, *, lengths: bool = True
) -> tuple[set[str], str, list[str], dict[str, str], bool]:
    """Keys in the names, from files or folders, their forms, units, and whether they have a decimal comma.

    A length that nothing calls a contraction, and that is the same in all names, may as well be a diameter: none then.
    """
    sizes: set[str] = set()
    units: dict[str, str] = {}
    comma = False
    forms: dict[str, None] = {}
    for path in files:
        form = re.sub(r"[{}*]", "?", path.stem if of == "file" else path.resolve().parent.name)
        for pattern, key, unit in _PARTS:
            found = [match for match in pattern.finditer(form) if key != "contraction" or lengths]
            called = [match for match in found if CONTRACTED.search(form[: match.start()])]
            match = next(iter(called or found), None)
            if match is None or "{" + key + "}" in form or (unit and units.get(key, unit) != unit):
                continue
            if form[: match.start()].endswith("}") or form[match.end() :].startswith("{"):
                continue
            sizes |= {match[0]} if key == "contraction" and not called else set()
            comma |= "," in match[0]
            form = f"{form[: match.start()]}{{{key}}}{form[match.end() :]}"
            if unit:
                units[key] = unit
        forms[form] = None
    if len(sizes) == 1:
        return found_in(files, of, lengths=False)
    keys = {key for form in forms for key in re.findall(r"\{(\w+)\}", form)}
    if "?" in "".join(forms) or (of == "folder" and keys <= {"test"}):
        keys = set()
    return keys, of, list(forms), units, comma


def frequency_of(path: Path, of: str, units: Mapping[str, str]) -> float | None:
    """The frequency in the name of a file or of its folder [Hz]; `units`: those of the forms."""
    name = path.resolve().parent.name if of == "folder" else path.stem
    for pattern, key, unit in _PARTS:
        match = pattern.search(name) if key == "frequency" and units.get(key) == unit else None
        if match is not None:
            return float(match[0].replace(",", ".")) / (2 * pi if unit == "rad/s" else 1.0)
    return None
