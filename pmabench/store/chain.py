"""Chains of runs that continue one another: each names the one before by its id and the hash of its seal."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, RecordError, invalid
from pmabench.store import folder as files
from pmabench.store.folder import is_regular, read_manifest, read_seal, sha256_of, status_of
from pmabench.store.reader import Recalibration, open_run
from pmabench.store.records import RunData, exclude, supersede
from pmabench.store.seal import close_interrupted


def continued(folder: Path) -> dict[str, Any]:
    """The entry `continues` for the manifest of a run that continues `folder`: `run`, `sha256`, `trials_done`.

    A run whose writer died is first closed as interrupted. Raises RecordError while it is still being written.
    """
    manifest = read_manifest(folder)
    if read_seal(folder) is None:
        if status_of(manifest, None) == "running":
            raise RecordError(f"{folder} is still being recorded; end it before another run continues it")
        close_interrupted(folder)
    return {"run": manifest["id"], "sha256": sha256_of(folder / files.SEAL), "trials_done": finished_trials(folder)}


def goes_on(folder: Path) -> Path | None:
    """The newest run in the folder's parent that continues it, directly or through others; None where there is none."""
    links: dict[str, Path] = {}
    for other in sorted(folder.resolve().parent.iterdir()):
        with suppress(InvalidFile, OSError):
            link = read_manifest(other).get("continues") if (other / files.MANIFEST).is_file() else None
            if isinstance(link, dict):
                links[str(link.get("run"))] = other
    last, seen = None, set[str]()
    name = str(read_manifest(folder)["id"])
    while name in links and name not in seen:
        seen.add(name)
        last = links[name]
        name = str(read_manifest(last)["id"])
    return last


def finished_trials(folder: Path) -> list[int]:
    """Indices of all trials finished in the chain that ends with `folder`, in order of time.

    A trial that a note excludes still counts as finished. Raises InvalidFile where a link does not fit.
    """
    return _finished(_load(folder))


def _finished(runs: Sequence[RunData]) -> list[int]:
    """Indices of finished trials, without repeated reference trials, which are not part of the plan."""
    return [t.index for run in runs for t in run.trials if t.status == "finished" and not t.again]


def open_chain(folder: Path, anew: Recalibration | None = None) -> tuple[RunData, ...]:
    """The run and all runs that it continues, in order of time; a single run if it continues none.

    Of several completed attempts at one trial the last counts, the others are `superseded`. Raises InvalidFile where a
    run of the chain is missing, was changed, or does not fit. `anew`: as for `open_run`.
    """
    return tuple(
        replace(run, trials=exclude(run.trials, {note.exclude for note in run.notes if note.exclude is not None}))
        for run in _load(folder, anew)
    )


def open_chains(paths: Sequence[Path], anew: Recalibration | None = None) -> list[RunData]:
    """The runs of all chains that end with `paths`, each run once; raises InvalidFile with the problems of all paths.

    `anew`: as for `open_run`. A path that another one continues belongs to that chain. Two runs that continue the same
    run are refused: its trials would count twice.
    """
    chains, problems = [], list[Problem]()
    for path in paths:
        try:
            chains.append(open_chain(path, anew))
        except InvalidFile as error:
            problems.extend(error.problems)
    if problems:
        raise InvalidFile(dict.fromkeys(problems))
    earlier = {_place(run): chain[-1] for chain in chains for run in chain[:-1]}
    taken: dict[Path, RunData] = {}
    for chain in chains:
        if _place(chain[-1]) in earlier:
            continue
        for run in chain:
            other = earlier.get(_place(run))
            if other is not None and other.path != chain[-1].path and _place(other) not in earlier:
                raise invalid(chain[-1].path, f"and {other.path} both continue {run.id}: give one of the two")
            taken.setdefault(_place(run), run)
    return list(taken.values())


def _place(run: RunData) -> Path:
    return Path(run.path).resolve()


def _load(folder: Path, anew: Recalibration | None = None) -> tuple[RunData, ...]:
    """The chain with superseded trials marked; exclusions are not applied."""
    runs = [open_run(folder, honour_notes=False, anew=anew)]
    while (link := runs[0].manifest.get("continues")) is not None:
        path = Path(runs[0].path)
        before = _linked(path, link)
        if before.resolve() in {_place(run) for run in runs}:
            raise invalid(path, "continues a run that continues it")
        runs.insert(0, open_run(before, honour_notes=False, anew=anew))
    for number in range(1, len(runs)):
        _fits(runs[:number], runs[number])
    return _superseded(runs)


def _linked(path: Path, link: Any) -> Path:
    """The folder of the run that `path` continues; InvalidFile if it is missing or was changed since."""
    try:
        name, digest = str(link["run"]), str(link["sha256"])
    except (TypeError, KeyError) as error:
        text = "does not say which run it continues (`continues`: run, sha256)"
        raise invalid(path / files.MANIFEST, text) from error
    for folder in files.next_to(path, name):
        if not is_regular(folder / files.SEAL) or sha256_of(folder / files.SEAL) != digest:
            raise invalid(folder, f"was not closed as it was when {path.name} continued it: its seal is another one")
        return folder
    raise invalid(path, f"continues {name}, which is not next to it; put that run's folder there")


def _fits(before: Sequence[RunData], run: RunData) -> None:
    last, path = before[-1], Path(run.path) / files.MANIFEST
    for what in ("kind", "simulated", "rate"):
        then, now = getattr(last, what), getattr(run, what)
        if then != now and (what != "rate" or (then and now)):
            raise invalid(path, f"does not fit the run that it continues: {what} is {now}, there {then}")
    found = run.manifest["continues"].get("trials_done")
    done = sorted(_finished(_superseded(before)))
    if found is not None and sorted(found) != done:
        said, finished = (", ".join(str(index + 1) for index in indices) or "none" for indices in (sorted(found), done))
        what = f"says that these trials were done before: {said}; the runs that it continues finished {finished}"
        raise invalid(path, what)
    points = {trial.index: (trial.point, trial.repeat) for earlier in before for trial in earlier.trials}
    for trial in run.trials:
        if trial.index in points and points[trial.index] != (trial.point, trial.repeat):
            text = f"does not fit: its trial {trial.number} is another one than in the run that it continues"
            raise invalid(path, text)


def _superseded(runs: Sequence[RunData]) -> tuple[RunData, ...]:
    trials = iter(supersede([trial for run in runs for trial in run.trials]))
    return tuple(replace(run, trials=tuple(next(trials) for _ in run.trials)) for run in runs)
