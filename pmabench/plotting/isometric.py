"""Figure of forces over pressure at set contractions, with the lines through them."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.plotting import plots
from pmabench.plotting.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    spread,
)
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Trace

PANELS = 9
"""Most panels."""


def lines(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Force over pressure at each contraction."""
    able = [t for t in traces if has(t, "pressure", "force")]
    if not able:
        return []
    chosen = spread(able, PANELS)
    by_branch = all(has(t, "branch") for t in able)
    optional = {"fit": "fit", "group": "branch" if by_branch else "test"}
    panels = []
    for trace in chosen:
        names = {"x": "pressure", "measured": "force"} | {k: v for k, v in optional.items() if has(trace, v)}
        x = trace.marks.get("contraction")
        title = f"x = {x / shown('length').scale:.3g} {shown('length').unit}" if x is not None else head(trace)
        panels.append(panel(trace, names, title))
    labels = {"x": label(chosen[0], "pressure"), "y": label(chosen[0], "force")}
    caption = (
        f"Samples of every test ({'blue: filling, red: emptying' if by_branch else 'colours'}) at set contractions, "
        f"and the least-squares line through them where it was fitted.{how_many(chosen, able)}"
    )
    alt = f"Force over pressure at fixed contraction, with a straight line, for {'; '.join(p.title for p in panels)}."
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)], ("pressure", "force", "fit", "test"))
    draw = bound(plots.scatter_and_line, panels, labels)
    title = "Isometric force over pressure" + (f", {panels[0].title}" if len(chosen) == 1 else "")
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]
