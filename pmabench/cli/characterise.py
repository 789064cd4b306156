"""Runs to analyses and a report in one go: what `demo` does, and `run --report` after the last trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.records import RunData


@dataclass(frozen=True)
class Characterised:
    """What came of runs."""

    runs: list[RunData]
    analyses: list[Analysis]
    folders: list[Path]
    """Of the analyses."""
    report: Path
    failed: list[str]
    """Why results are not accepted."""
    recorded: Sequence[Path] = ()
    """Run folders, as they were given."""

    def lines(self) -> list[str]:
        """The results at a glance, and where the report is."""
        from pmabench.cli.outcome import next_lines
        from pmabench.cli.process import described_by, verdict_of_all
        from pmabench.report.foremost import glance

        verdict = verdict_of_all(self.analyses, self.runs, self.failed)
        then = described_by(self.recorded, self.analyses, self.failed)
        lines = [*glance(self.analyses, verdict, self.failed), f"report  {self.report}"]
        return [*lines, *(next_lines(*then) if then else [])]


def characterise(recorded: Sequence[Path], place: Path, report: Path, title: str | None = None) -> Characterised:
    """Process the runs in `recorded` together into `place`, and write the page `report`."""
    from pmabench.cli.process import analyse, chains, load_runs, write
    from pmabench.kinds.reduce import verdicts
    from pmabench.report.document.content import content_of, write_page
    from pmabench.store.analyses.folder import key_of

    key = key_of(chains(recorded), {})
    runs = load_runs(recorded)
    analyses = analyse(runs)
    folders = write(analyses, runs, place, key)
    page = write_page(content_of(analyses, runs, title=title), report)
    return Characterised(runs, analyses, folders, page, verdicts(runs, analyses), recorded)
