"""What did not go as the protocol says, found in the record of each run, a sentence each; nothing is computed twice.

Manifests are untrusted and everything in them is optional; nothing here raises for what is missing or odd.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pmabench.report.provenance import get, text_of
from pmabench.report.wording import clean
from pmabench.store.records import RunData


def deviations(runs: Sequence[RunData], names: Mapping[str, str]) -> list[str]:
    """What did not go as the protocol says, and what the bench lacks, a sentence each."""
    lines: dict[str, list[str]] = {}

    def say(run: RunData, text: str) -> None:
        lines.setdefault(clean(text, 500), []).append(names.get(run.id, "?"))

    for run in runs:
        if run.status != "finished":
            why = text_of(run.manifest.get("why"))
            say(run, f"ended “{run.status}”" + (f": {why}" if why else ""))
        for key, words in (("deviations", ""), ("hazards", "hazard: "), ("lacks", "the bench lacks: ")):
            told = run.manifest.get(key)
            for item in told if isinstance(told, list | tuple) else [told] if told else []:
                say(run, f"{words}{text_of(item)}")
        ended = [trial for trial in run.trials if trial.status != "finished"]
        if ended:
            count: dict[str, int] = {}
            for trial in ended:
                count[trial.status] = count.get(trial.status, 0) + 1
            say(run, "trials: " + ", ".join(f"{n} {status}" for status, n in count.items()))
        for counts in (get(run.manifest, "end", "counts"), get(run.manifest, "imported", "flagged")):
            for name, n in counts.items() if isinstance(counts, Mapping) else ():
                if name not in ("rows", "slack") and isinstance(n, int) and n > 0:
                    say(run, f"samples flagged {text_of(name)}: {n}")
        answered = sum(e.kind == "answer" and "--yes" in str(e.data.get("answer", "")) for e in run.events)
        if answered:
            say(run, f"prompts to the operator confirmed beforehand (--yes): {answered}")
        for channel, how in run.interpolated.items():
            say(run, f"{text_of(channel)}: {how}")
        if run.manifest.get("guard"):
            result = text_of(get(run.manifest, "guard", "vent", "result"))
            say(run, f"the program died; the guard vented the bench after that: {result}")
        vent = get(run.manifest, "end", "vent", "result")
        if vent not in (None, "confirmed"):
            say(run, f"the safe state at the end was {text_of(vent)}")
    return [f"{', '.join(where)}: {text}" for text, where in lines.items()]
