"""Patterns of text lines: which are safe to run, and what they find; knows no port. Standard library only.

A regular expression can take longer than the age of the universe on a line of 100 characters. So that reading one line
is bounded, a pattern may repeat single characters and classes only, never groups, and repetitions that can take the
same characters are few: n of them can take parts of a run of r characters in about r^n / n! ways.
"""

from __future__ import annotations

import re
from itertools import combinations

LONGEST_PATTERN = 300
MOST_SHARED = 3
"""Four repetitions that can take the same characters: 120^4 / 24 steps at worst, some 0.3 s."""
NOT_INPUTS = ("sign", "unit", "status")
"""Named groups that are no measured value."""

_TOKEN = re.compile(
    r"(?P<atom>\\[dDwWsS]|\\[^A-Za-z0-9]|\\[trn]|\[\^?\]?(?:\\.|[^\]\\])*\]|[^\\\[\](){}*+?|^$])"
    r"|(?P<open>\((?:\?:|\?P<[A-Za-z_]\w*>)?(?!\?))"
    r"|(?P<close>\))|(?P<bar>\|)|(?P<anchor>[\^$])"
)
_QUANTIFIER = re.compile(r"(?:[*+?]|\{(\d{0,3})(,?)(\d{0,3})\})\??")
_PRINTABLE = [chr(code) for code in (9, 10, 13, *range(32, 127))]


def pattern_problem(pattern: str) -> str:
    """Why a pattern cannot be used; empty where it can."""
    if len(pattern) > LONGEST_PATTERN:
        return f"is longer than {LONGEST_PATTERN} characters"
    variable: list[frozenset[str]] = []
    position = 0
    while position < len(pattern):
        token = _TOKEN.match(pattern, position)
        if token is None:
            return (
                f'cannot be used from "{pattern[position : position + 12]}" on; characters, [classes], \\d \\w \\s, '
                "groups, | and repetitions are understood, references and looks around are not"
            )
        position = token.end()
        times = _QUANTIFIER.match(pattern, position)
        if times is None:
            continue
        position = times.end()
        if token["atom"] is None:
            if times[0] == "?" and token["close"]:
                continue
            return f'repeats a group ("{pattern[max(0, token.start() - 8) : position]}"); repeat single characters only'
        if times[0][0] == "{" and not times[2]:
            continue
        atom = re.compile(token["atom"])
        variable.append(frozenset(char for char in _PRINTABLE if atom.fullmatch(char)))
    try:
        compiled = re.compile(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        return f"is no regular expression: {error}"
    if _shared(variable) > MOST_SHARED:
        return "has too many repetitions of the same characters; use narrower classes or fixed numbers, as \\d{3}"
    if not inputs_of(compiled):
        return 'names no value; write "(?P<value>...)" around the number'
    if "sign" in compiled.groupindex and len(inputs_of(compiled)) != 1:
        return 'has a group "sign", which needs exactly one value next to it'
    return ""


def _shared(sets: list[frozenset[str]]) -> int:
    """Repetitions less the number of bunches that can take the same characters."""
    bunch = list(range(len(sets)))
    for a, b in combinations(range(len(sets)), 2):
        if sets[a] & sets[b]:
            bunch = [bunch[a] if item == bunch[b] else item for item in bunch]
    return len(sets) - len(set(bunch))


def inputs_of(pattern: re.Pattern[str]) -> list[str]:
    """The named groups that are measured values."""
    return [name for name in pattern.groupindex if name not in NOT_INPUTS]


_NUMBER = re.compile(r"([+-]?)\s*(\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})", re.ASCII)


def number(text: str, sign: str = "") -> float:
    """A decimal number, spaces after its sign allowed; ValueError for anything else."""
    found = _NUMBER.fullmatch(text.strip())
    if found is None or (sign and found[1]):
        raise ValueError(f'"{text[:40]}" is no number')
    return float(f"{sign.strip() or found[1]}{found[2]}")
