"""Which trials and notes are behind a number, in short: ranges, and codes for what is long; computes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from pmabench.analysis.results import Estimate
from pmabench.plotting.wording import clean
from pmabench.report.document.tables import note_text

BRIEF = 18
"""Longest text that is printed next to its number itself [letters]."""


class Codes:
    """Long texts as they come in a report, each printed once in a table, and by its code elsewhere."""

    def __init__(self, letter: str, head: str, brief: int) -> None:
        self.letter, self.head, self.brief = letter, head, brief
        self.codes: dict[str, str] = {}

    def of(self, text: str) -> str:
        """The text itself where it is brief, else its code."""
        return text if len(text) <= self.brief else self.codes.setdefault(text, f"{self.letter}{len(self.codes) + 1}")

    def table(self) -> pd.DataFrame:
        """One row for each code."""
        rows = [{"code": code, self.head: text} for text, code in self.codes.items()]
        return pd.DataFrame(rows, columns=["code", self.head], dtype=object)


class Parents:
    """Trials and notes behind the values of a report; `names` are the short names of runs."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self.names = names
        self.trials = Codes("S", "trials (run: numbers)", BRIEF)
        self.notes = Codes("N", "note", BRIEF)

    def of(self, estimate: Estimate) -> tuple[str, str]:
        """Trials and note of an estimate."""
        return self.trials.of(trial_ranges(estimate.trials, self.names)), self.notes.of(note_text(estimate))


def trial_ranges(trials: Sequence[str], names: Mapping[str, str]) -> str:
    """Trials, named `run/number`, as `R1: 1–8, 11; R2: 3`."""
    runs: dict[str, list[int]] = {}
    others = []
    for trial in trials:
        run, _, index = trial.rpartition("/")
        if index.isascii() and index.isdigit() and len(index) < 7:
            runs.setdefault(names.get(run) or clean(run, 60), []).append(int(index))
        else:
            others.append(clean(trial, 60))
    parts = [f"{run}: {_ranges(sorted(set(indices)))}" for run, indices in runs.items()]
    return "; ".join(parts + others)


def _ranges(numbers: Sequence[int]) -> str:
    spans: list[list[int]] = []
    for n in numbers:
        if spans and n == spans[-1][1] + 1:
            spans[-1][1] = n
        else:
            spans.append([n, n])
    return ", ".join(str(low) if low == high else f"{low}–{high}" for low, high in spans)
