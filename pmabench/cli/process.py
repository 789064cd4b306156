"""`pmabench process`: runs to coefficients, in an analysis folder; never touches a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, UsageError, invalid
from pmabench.cli.common import Ui, common
from pmabench.cli.names import PATH, RunFolder, short
from pmabench.cli.outcome import next_lines
from pmabench.kinds import registry
from pmabench.store.catalogue import ANALYSES, chain_of, holds_runs
from pmabench.store.folder import LATE, read_manifest

if TYPE_CHECKING:
    from pmabench.report.document.front import Verdict
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.records import RunData


MOST_RUNS = 6
"""Runs that the next command names."""
MOST_SINCE = 2
"""Lines about what came to runs after they were closed; with -v all."""


@click.command(name="process")
@click.argument("runs", nargs=-1, required=True, type=RunFolder(), metavar="RUN...|FOLDER...")
@click.option("--out", type=PATH, help="Analysis folder; in analyses/ next to runs/ if not given.")
@click.option("--each", is_flag=True, help="Each run on its own and one table, as for a folder of runs.")
@click.option("--jobs", type=click.IntRange(1, 256), metavar="N", help="So many processes share a folder of runs.")
@click.option("--cluster", metavar="ADDRESS", help="A Dask scheduler whose workers share a folder of runs.")
@click.option(
    "--form",
    "forms",
    multiple=True,
    metavar="FORM",
    help="`surface`: all slow tests together as one muscle with hysteresis and creep. SYMBOL=FORM, contraction runs:"
    " F_ce, K, B_c or B_r over pressure as constant, line, polynomial or polygon, in a joint fit next to the straight"
    " lines between pressures.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(20, 10_000),
    metavar="N",
    help="Contraction runs: so many draws over the trials check the intervals.",
)
@click.option(
    "--polish",
    is_flag=True,
    help="Contraction runs: the coefficients by output error, too, which simulates each stroke.",
)
@click.option("--regulator", is_flag=True, help="Contraction runs: dead time and lags from command to pressure.")
@click.option("--fresh", is_flag=True, help="A folder of runs: compute also what has not changed.")
@common
def command(
    ui: Ui,
    runs: tuple[Path, ...],
    out: Path | None,
    each: bool,
    jobs: int | None,
    cluster: str | None,
    forms: tuple[str, ...],
    fresh: bool,
    **options: Any,
) -> int | None:
    """Fit the coefficients of RUNS, each with its 95 % interval.

    RUNS named one by one are taken together: one analysis for each kind of test of each specimen.

    Of a FOLDER of runs each run is taken on its own, with those that it continues: an analysis folder for each in
    analyses/each, and one table over all of them next to those (all-runs.csv, .parquet, .json). Runs that have not
    changed since the last time are not computed again. A run that cannot be used is named at the end; the others go on.
    """
    from pmabench.kinds.reduce import FORM

    together = [form for form in forms if form in registry.with_part(FORM)]
    if together:
        if len(forms) > 1 or any(options.values()) or each or any(holds_runs(path) for path in runs):
            what = f"--form {together[0]} takes all runs that are named into one muscle, and no other option"
            raise UsageError(f"{what}: name run folders, for instance with /*")
        return _process_together(ui, runs, out, {}, together[0])
    asked = registry.options_for({"forms": list(forms), **options})
    below = [path for path in runs if holds_runs(path)]
    if each or below:
        if jobs is not None and cluster is not None:
            raise UsageError("--jobs is for this machine and --cluster for others: give one of the two")
        from pmabench.cli.process_many import process_folders

        start = runs[0].resolve()
        place = out or campaign_folder(start if runs[0] in below else start.parent) / ANALYSES / "each"
        wanted = [path for path in runs if path in below or not _holds_analyses(path)]
        return process_folders(ui, wanted, place, jobs or 1, cluster, asked, fresh=fresh)
    if jobs is not None or cluster is not None:
        what = "--jobs and --cluster share out runs that are processed each on its own"
        raise UsageError(f"{what}: give their folder, or --each; runs named one by one make one fit together")
    return _process_together(ui, runs, out, asked)


def _process_together(
    ui: Ui, runs: Sequence[Path], out: Path | None, asked: Mapping[str, Mapping[str, object]], form: str = ""
) -> int | None:
    """One analysis for each kind of test of each specimen in `runs`; `asked` are options by kind of test.

    With a `form` of all tests one analysis for each specimen, in a folder next to those of the tests.
    """
    ui.begin(f"processing {len(runs)} {'run' if len(runs) == 1 else 'runs'}")
    from pmabench.kinds.reduce import reduce_together, verdicts
    from pmabench.plotting.wording import clean
    from pmabench.report.foremost import glance
    from pmabench.store.analyses.folder import key_of

    given = without_analyses(ui, runs)
    key = "" if form else key_of(chains(given), asked)  # before the runs are read: what is added meanwhile is a change
    loaded = load_runs(given)
    if asked and not any(run.kind in asked for run in loaded):
        raise UsageError(
            "--form, --bootstrap, --polish and --regulator are for runs of kind "
            f"{', '.join(asked)}; none of these is one"
        )
    analyses = reduce_together(form, loaded) if form else analyse(loaded, asked)
    place = place_of(given[0])
    folders = write(analyses, loaded, out or (place.with_name(f"{place.name}-{form}") if form else place), key, asked)
    failed = verdicts(loaded, analyses)
    data: dict[str, Any] = {
        "schema": "pmabench.process/1",
        "folders": [str(path) for path in folders],
        "analyses": [analysis.to_dict() for analysis in analyses] if ui.json else [],
        "verdicts": failed,
        "excluded": [
            {"run": run.id, "trial": note.excluded, "because": note.because, "operator": note.operator}
            for run in loaded
            for note in run.notes
            if note.exclude is not None
        ],
        "since": {run.id: run.since.as_data() for run in loaded if run.since.sentences},
    }

    def human() -> None:
        since = [
            *since_lines(loaded),
            *(clean("{run}: trial {trial} is left out by {operator}: {because}".format(**e)) for e in data["excluded"]),
        ]
        if ui.verbose:
            print_analyses(ui, analyses)
            click.echo("".join(f"{line}\n" for line in since), nl=False)
            click.echo("\n".join(str(path) for path in folders))
            click.echo("\n".join(verdict_lines(analyses, loaded, failed)))
            return
        place = short(folders[0].parent)
        then = described_by(given, analyses, failed) or ["pmabench", "report", place, "-o", "report.html"]
        more = [f"{len(since) - MOST_SINCE} more: -v"] if len(since) > MOST_SINCE else []
        lines = [*glance(analyses, verdict_of_all(analyses, loaded, failed), failed), *since[:MOST_SINCE], *more]
        click.echo("\n".join([*lines, f"analysis  {place}", *next_lines(*then, indent=10)]))

    ui.result(
        data, human, [*(clean(f"NOT ACCEPTED: {verdict}") for verdict in failed), *(str(path) for path in folders)]
    )
    return 6 if failed else None


def described_by(runs: Sequence[Path], analyses: Sequence[Analysis], failed: Sequence[str]) -> list[str]:
    """The command that describes a muscle which does not follow the form of its test; empty where it does."""
    from pmabench.kinds.reduce import FORM

    facts = [analysis.facts.get("form") for analysis in analyses]
    withheld = any(isinstance(fact, Mapping) and fact.get("state") == "withheld" for fact in facts)
    if not (failed and withheld) or len(runs) > MOST_RUNS:
        return []
    return ["pmabench", "process", *map(short, runs), "--form", next(iter(registry.with_part(FORM)))]


def verdict_lines(analyses: Sequence[Analysis], runs: Sequence[RunData], failed: Sequence[str]) -> list[str]:
    """The verdict as the first page of the report has it, then each reason why results are not accepted."""
    from pmabench.analysis.verdict.acceptance import limits_of
    from pmabench.plotting.wording import clean

    limits = list(dict.fromkeys(limit.short for run in runs for limit in limits_of(run)))
    verdict = verdict_of_all(analyses, runs, failed)
    kept = f" ({', '.join(limits)})" if limits and not failed else ""
    return [clean(f"{verdict.word}{kept}: {verdict.text}"), *(clean(f"NOT ACCEPTED: {text}") for text in failed)]


def verdict_of_all(analyses: Sequence[Analysis], runs: Sequence[RunData], failed: Sequence[str]) -> Verdict:
    """The verdict of the report's first page; `failed` are the reasons why results are not accepted."""
    from pmabench.analysis.verdict.acceptance import limits_of
    from pmabench.report.document.front import verdict_of

    return verdict_of(analyses, runs, failed, accepted=any(limits_of(run) for run in runs))


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


GUIDED = ("session", "self-test", "calibration", "setup")
"""Kinds of runs that have no trials: what they found is in their events."""


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
    if path.name.endswith(LATE) and path.is_dir() and not (path / "manifest.json").exists():
        return "holds what came after a run was closed"
    if _holds_analyses(path):
        return "holds analyses"
    if not (path / "manifest.json").is_file():
        return ""
    with suppress(InvalidFile):  # what is wrong with it is reported when it is loaded
        kind = read_manifest(path).get("kind")
        return f"is a run of kind {kind}" if kind in GUIDED else ""
    return ""


def _holds_analyses(path: Path) -> bool:
    if not path.is_dir() or (path / "manifest.json").exists():
        return False
    return path.resolve().name == ANALYSES or any(
        next(path.glob(pattern), None) for pattern in ("analysis.json", "*/analysis.json", "*/*/analysis.json")
    )


def load_runs(paths: Sequence[Path]) -> list[RunData]:
    """Every run with those that it continues, or `InvalidFile` with what is wrong with each that is none."""
    from pmabench.store.chain import open_chains

    for path in filter(holds_runs, paths):
        advice = "is a folder of runs: name those in it, for instance with /*; process takes it as it is, run by run"
        raise invalid(path, advice)
    return open_chains(paths)


def analyse(runs: Sequence[RunData], options: Mapping[str, Mapping[str, Any]] | None = None) -> list[Analysis]:
    """One analysis for each kind of run, in the order in which the kinds come; `options` by kind."""
    from pmabench.kinds.reduce import reduce_runs

    return reduce_runs(runs, options)


def write(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    folder: Path,
    key: str = "",
    options: Mapping[str, Any] | None = None,
) -> list[Path]:
    """An analysis folder for each analysis below `folder`; kinds that come twice are numbered.

    With the `key` of runs and `options` they are used again as long as it is the same.
    """
    from pmabench.report.files.csv_files import write_with_tables
    from pmabench.store.analyses.folder import keep

    seen: dict[str, int] = {}
    written = []
    for analysis in analyses:
        seen[analysis.kind] = number = seen.get(analysis.kind, 0) + 1
        name = f"{analysis.kind}-{number}" if number > 1 else analysis.kind
        written.append(write_with_tables(analysis, folder / name))
    keep(folder, key, [Path(run.path) for run in runs], options or {}, written)
    return written


def print_analyses(ui: Ui, analyses: Sequence[Analysis]) -> None:
    """The coefficient table, what was left out, and the findings."""
    from pmabench.plotting.wording import clean, printed
    from pmabench.report.foremost import print_coefficients

    console = ui.console()
    print_coefficients(analyses, console)
    for analysis in analyses:
        if analysis.dropped:
            console.print(
                f"{analysis.kind}: {len(analysis.dropped)} trials not used; the report lists each with its reason"
            )
        for finding in analysis.findings:
            text = clean(f"{finding.level}: {printed(finding.text)}").replace(" ± ", "\u00a0±\u00a0")
            kept = fill(text, console.width, break_long_words=False, break_on_hyphens=False)
            console.print(kept.replace("\u00a0±\u00a0", " ± "), soft_wrap=True)  # a value stays with its half width
