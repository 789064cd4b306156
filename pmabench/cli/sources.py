"""What commands are given, runs and analyses: which is which, what is stored of them, where analyses go."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pmabench.base.errors import InvalidFile, UsageError, invalid
from pmabench.cli.common import Ui
from pmabench.store.catalogue import ANALYSES, ANALYSIS, chain_of, holds_runs
from pmabench.store.folder import LATE, read_manifest

if TYPE_CHECKING:
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.records import RunData


@dataclass(frozen=True)
class Sources:
    """Runs and analyses that a command was given."""

    folders: list[Path]
    """Analyses that were named."""
    given: list[Path]
    """Runs that were named."""
    used: list[Path]
    """Analyses to read: those that were named, else what `process` stored of the runs."""

    @classmethod
    def of(cls, ui: Ui, sources: Sequence[Path], *, fresh: bool) -> Sources:
        """From what was typed; with `fresh` nothing that is stored is used."""
        folders, others = apart(sources)
        given = without_analyses(ui, others) if others else []
        return cls(folders, given, folders if folders or fresh else stored(ui, given))

    def analysed(self, ui: Ui, *, once: bool = True) -> tuple[list[Analysis], list[RunData]]:
        """All analyses, read or else made now, and the runs behind them; `once`: refuse two of the same runs."""
        from pmabench.kinds.reduce import reduce_runs
        from pmabench.store.analyses.folder import read_analysis, runs_of

        runs = load_runs(self.given) if self.given else []
        if self.folders:
            analyses = [read_analysis(folder) for folder in self.folders]
            seen: dict[tuple[str, tuple[str, ...]], Path] = {}
            for folder, analysis in zip(self.folders, analyses, strict=True):
                other = seen.setdefault((analysis.kind, analysis.runs), folder)
                if once and other != folder:
                    raise UsageError(f"{other} and {folder} are analyses of the same runs: give one of the two")
            runs += load_runs(list(dict.fromkeys(run for folder in self.folders for run in runs_of(folder))))
        else:
            analyses = read_all(ui, self.used)
        return analyses + reduce_runs([run for run in runs if not any(run.id in a.runs for a in analyses)]), runs


def campaign_folder(folder: Path) -> Path:
    """Where analyses go: next to a folder that is called `runs`, so that `runs/*` are runs and nothing else."""
    return folder.parent if folder.name == "runs" else folder


def place_of(run: Path) -> Path:
    """Where the analyses of runs are that are processed together, of which `run` is named first."""
    return campaign_folder(run.resolve().parent) / ANALYSES / str(read_manifest(run)["id"])


def chains(runs: Sequence[Path]) -> list[Path]:
    """The runs with those that they continue, each once."""
    with suppress(InvalidFile):  # whoever loads them reports what is wrong
        return list({run.resolve(): run for given in runs for run in chain_of(given)}.values())
    return []


def stored(ui: Ui, runs: Sequence[Path]) -> list[Path]:
    """Folders of the analyses that `process` made of `runs`; none where runs, notes or program changed since.

    What was made with options, or was changed afterwards, is not used, and the user is informed.
    """
    from pmabench.store.analyses.folder import Kept, kept, key_of
    from pmabench.store.since import as_sealed

    chain = chains(runs)
    key = key_of(chain, {}) if chain else ""
    if not key:
        return []
    each = campaign_folder(runs[0].resolve().parent) / ANALYSES / "each" / runs[0].resolve().name
    found = [kept(place, key, {}) for place in (place_of(runs[0]), each)]
    best = next((one for one in found if one.folders), Kept(why=next((one.why for one in found if one.why), "")))
    if best.why:
        ui.note(f"{best.why}: it is not used, and its runs are processed again")
    return list(best.folders) if all(as_sealed(run) for run in chain) else []


def read_all(ui: Ui, folders: Sequence[Path]) -> list[Analysis]:
    """The analyses in folders that `stored` found; none where one is damaged, and the user is informed."""
    from pmabench.store.analyses.folder import read_analysis

    try:
        return [read_analysis(folder) for folder in folders]
    except InvalidFile as error:
        ui.note(f"{error}: it is not used, and its runs are processed again")
        return []


def without_analyses(ui: Ui, paths: Sequence[Path]) -> list[Path]:
    """The paths that are neither analyses nor guided runs, which lie among runs named with `*`; those are reported."""
    skipped = {path: why for path in paths if (why := _nothing_to_process(path))}
    if len(skipped) == len(paths):
        raise invalid(paths[0], f"{skipped[paths[0]]} and no run with trials; give run folders")
    for path, why in skipped.items():
        ui.note(f"{path}: {why}, skipped")
    return [path for path in paths if path not in skipped]


def apart(sources: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Analysis folders, and the other sources.

    A folder of analyses means all of them; among runs, named with `*`, it is left to `without_analyses` to skip.
    """
    from pmabench.store.analyses.folder import analyses_below

    below = {source: analyses_below(source) for source in sources}
    runs = [source for source in sources if not below[source]]
    own = [source for source in sources if (source / "analysis.json").is_file()]
    if runs:
        return own, [source for source in sources if source not in own]
    return list(dict.fromkeys(folder for source in sources for folder in below[source])), []


def since_lines(runs: Sequence[RunData]) -> list[str]:
    """One line for everything that was added to runs after they were closed."""
    return [f"{run.id}: {sentence}" for run in runs for sentence in run.since.sentences]


def _nothing_to_process(path: Path) -> str:
    """What a folder is that nothing can be fitted to, in words; empty for any other."""
    from pmabench.report.many import without_trials

    if path.name.endswith(LATE) and path.is_dir() and not (path / "manifest.json").exists():
        return "holds what came after a run was closed"
    if holds_analyses(path):
        return "holds analyses"
    return str(without_trials(path).get("skipped", ""))


def holds_analyses(path: Path) -> bool:
    """Whether a folder is one of analyses, or an analysis."""
    from pmabench.store.analyses.folder import analyses_below

    named = path.resolve().name == ANALYSES and path.is_dir() and not (path / "manifest.json").exists()
    return named or bool(analyses_below(path))


def analyses_of(runs: Path) -> list[Path]:
    """Folders of the analyses next to a folder of runs, those of runs each on its own too, the newest last."""
    patterns = [f"{'*/' * depth}{ANALYSIS}" for depth in (1, 2, 3)]
    files = {file for pattern in patterns for file in (campaign_folder(runs.resolve()) / ANALYSES).glob(pattern)}
    return [file.parent for file in sorted(files, key=lambda file: (file.stat().st_mtime_ns, file))]


def load_runs(paths: Sequence[Path]) -> list[RunData]:
    """Every run with those that it continues, or `InvalidFile` with what is wrong with each that is none."""
    from pmabench.store.chain import open_chains

    for path in filter(holds_runs, paths):
        advice = "is a folder of runs: name those in it, for instance with /*; process takes it as it is, run by run"
        raise invalid(path, advice)
    return open_chains(paths)
