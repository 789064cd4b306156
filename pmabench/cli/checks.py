"""The table of a self-test on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pmabench.cli.common import Ui

if TYPE_CHECKING:
    from pmabench.session.checks import Check


def print_checks(ui: Ui, checks: Sequence[Check], *, err: bool = False) -> None:
    """The table of a self-test; below it what to look at."""
    from pmabench.report.terminal import print_grid

    if not checks:
        return
    console = ui.console(err=err)
    heads = ["check", "value", "limit", "verdict"]
    rows = [[c.name, c.value or (c.hint if c.verdict.startswith("not ") else ""), c.limit, c.verdict] for c in checks]
    print_grid(console, heads, rows, heads)
    for check in checks:
        if check.verdict == "failed":
            console.print(f"{check.name}: {check.hint}")
