"""`pmabench runs` and `note`: the catalogue, one run in full, whether the record is whole, and what is added to it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, invalid
from pmabench.base.system import user_name
from pmabench.base.text import printable
from pmabench.cli.common import Group, Ui, common, fields, labelled
from pmabench.cli.names import PATH, RunFolder, tail_of, typed
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.store.records import RunData
    from pmabench.store.verify import Finding


WIDE = 160
"""From so many columns on a list of runs holds their long names, too."""
ENDED_EARLY = ("interrupted", "aborted", "tripped", "error")
"""How a run ends that may have trials left."""


@click.group(name="runs", cls=Group)
def command() -> None:
    """List, show and verify recorded runs."""


@command.command(name="list")
@click.argument("folder", default="runs", type=PATH)
@common
def list_runs(ui: Ui, folder: Path) -> None:
    """Every run in FOLDER, by date."""
    from pmabench.store.catalogue import catalogue

    if not folder.is_dir():
        raise invalid(folder, "there is no such folder")
    rows = sorted(({**vars(row)} for row in catalogue(folder)), key=lambda row: (row["date"], row["folder"]))
    continued = {row["continues"] for row in rows}
    for row in rows:
        left = row["trials_planned"] - row["trials_finished"] - row["trials_before"]
        row["resume"] = ""
        if row["status"] in ENDED_EARLY and row["id"] not in continued:
            row["resume"] = _resume(folder / row["folder"], left)

    def human() -> None:
        from pmabench.store.since import Added, Since

        console = ui.console(columns=300)
        tails = Counter(tail_of(row["folder"]) for row in rows)
        table = []
        for row in rows:
            tail = tail_of(row["folder"])
            run = typed((folder / (tail if tails[tail] == 1 else row["folder"])).resolve())
            here, before = row["trials_finished"], row["trials_before"]
            trials = f"{before + here}/{row['trials_planned']}" + (f" ({here} here)" if before else "")
            length = f"{row['duration']:.0f} s" if row["duration"] is not None else ""
            mark = "*" if row["added"] or row["late"] else ""
            begun = str(row["date"])[:16].replace("T", " ")
            table.append([run, begun, row["kind"], row["status"] + mark, trials, length, row["specimen"], row["id"]])
        heads = ["run", "begun (UTC)", "kind", "status", "trials", "duration", "specimen", "id"]
        count = len(heads) if ui.verbose or console.width >= WIDE else len(heads) - 1
        texts = [head for head in heads if head not in ("trials", "duration")]
        print_grid(console, heads[:count], [line[:count] for line in table], texts)
        for row in rows:
            for sentence in Since(tuple(Added(name, "") for name in row["added"]), row["late"]).sentences:
                click.echo(f"* {row['id']}: {sentence}")
        for row in rows:
            if row["status"] == "interrupted" and row["resume"]:
                click.echo(f"{row['id']} was interrupted; to go on with it: {row['resume']}")

    ui.result({"schema": "pmabench.runs/1", "runs": rows}, human)


def _resume(run: Path, left: int) -> str:
    """The command that continues a run that ended early; empty where no trial is left."""
    return f"pmabench run --resume {quote(str(run))}" if left > 0 else ""


@command.command(name="show")
@click.argument("run", type=RunFolder())
@common
def show_run(ui: Ui, run: Path) -> None:
    """One RUN in full: what, when, by whom, how it ended, its trials and channels."""
    from pmabench.store.reader import open_run

    data = open_run(run)
    after = going_on(run, data)
    ui.result(_summary(data, after), lambda: _print_run(data, after))


def _summary(data: RunData, after: Mapping[str, str]) -> dict[str, Any]:
    """The run as data for programs."""
    from pmabench.store.timebase import sampling

    taken = sampling(data.trials)
    return {
        "schema": "pmabench.run-summary/1",
        **fields(data, "id", "kind", "status", "simulated", "manifest", "interpolated"),
        "channels": {name: vars(channel) for name, channel in data.channels.items()},
        "trials": [
            {"trial": t.number, "rows": len(t.t)}
            | fields(t, "point", "repeat", "attempt", "status", "reference", "again")
            for t in data.trials
        ],
        "sampling": vars(taken) if taken is not None else None,
        "events": len(data.events),
        "clocks": {name: {**vars(clock), "offset": clock.offset} for name, clock in data.clocks.items()},
        "notes": [note.as_data() for note in data.notes],
        "since": data.since.as_data(),
        **after,
    }


def _print_run(data: RunData, after: Mapping[str, str]) -> None:
    from pmabench.analysis.verdict.checks import unresolved_of
    from pmabench.display.wording import point_text

    manifest, width = data.manifest, shutil.get_terminal_size((100, 24)).columns
    click.echo(f"{data.id}\n  {data.kind}, {data.status}{', SIMULATED' if data.simulated else ''}")
    for name in ("protocol", "source", "bench", "operator", "started_utc", "why"):
        if manifest.get(name):
            click.echo(labelled(f"{name:12} ", printable(manifest[name]), width))
    if unproven := manifest.get("scales_not_proven"):
        click.echo(printable(f"  {'scales':12} not proven: emulated by the bench file itself: {', '.join(unproven)}"))
    ends = [event.data.get("counts") for event in data.events if event.kind == "end"]
    counts = ends[-1] if ends and isinstance(ends[-1], Mapping) else {}
    rows = sum(len(t.t) for t in data.trials) or int(counts.get("rows") or 0)
    states = Counter(t.status for t in data.trials if not t.again)
    finished, planned = states.pop("finished", 0), manifest.get("trials_planned", "?")
    others = "".join(f", {count} {status}" for status, count in sorted(states.items()))
    click.echo(f"  {'trials':12} {finished} of {planned} finished{others}; {rows:,} rows")
    _print_sampling(data)
    for t in data.trials:
        reference = "; reference trial, done again" if t.again else "; reference trial" if t.reference else ""
        click.echo(f"  trial {t.number:<6} {t.status:12} {point_text(t.point)}{reference}")
    for channel in data.channels.values():
        click.echo(f"  {channel.name:18} [{channel.unit}]  calibration {channel.calibration or 'none'}")
    _print_session(data)
    if result := vented(data):
        click.echo(f"  {'vent':12} {result}")
    _print_rest(data)
    for entry in unresolved_of(data):
        click.echo(printable(f"  {'not answered':12} {entry['what']}: {entry['question']}"))
    for sentence in data.since.sentences:
        click.echo(f"  {'since then':12} {sentence}")
    if after["continued_by"]:
        click.echo(f"  {'continued':12} by {after['continued_by']}")
    elif after["resume"]:
        click.echo(f"  {'to go on':12} {after['resume']}")


def _print_sampling(data: RunData) -> None:
    from pmabench.store.timebase import sampling

    taken = sampling(data.trials)
    if taken is not None:
        times = (taken.interval, taken.jitter, taken.longest)
        every, spread, most = (f"{round(1e3 * value, 6):.4g} ms" for value in times)
        counted = f"{taken.late:,} late, {taken.gaps:,} after a gap"
        click.echo(f"  {'samples':12} {taken.rate:.6g} Hz; every {every} with {spread} rms, longest {most}; {counted}")


def vented(data: RunData) -> str:
    """The result of the vent: of its event, or where a full disk took that, of the seal."""
    events = [event.data for event in data.events if event.kind == "vent"]
    end = data.manifest.get("end")
    sealed = end.get("vent") if isinstance(end, Mapping) else None
    vent = events[-1] if events else sealed if isinstance(sealed, Mapping) else {}
    return str(vent.get("result") or "")


def going_on(run: Path, data: RunData) -> dict[str, str]:
    """The run that continues this one, and the command that would; both empty where nothing is left to do."""
    from pmabench.store.chain import goes_on

    if not ended_early(data) or not isinstance(data.manifest.get("sources"), Mapping):
        return {"continued_by": "", "resume": ""}
    after = goes_on(run)
    resume = "" if after else _resume(run, trials_left(data))
    return {"continued_by": after.name if after else "", "resume": resume}


def ended_early(data: RunData) -> bool:
    """Whether it ended before its last trial, as one that failed between trials did, or at a load by older versions."""
    from pmabench.store.records import ENDED

    if data.status != "failed":
        return data.status in ENDED_EARLY
    chosen = any(event.kind == "choice-end" for event in data.events)  # of all that could be chosen
    return not chosen and trials_left(data, ENDED) > 0


def trials_left(data: RunData, done: Collection[str] = ("finished",)) -> int:
    """How many planned trials have none of the statuses `done`, neither in this run nor in those that it continues."""
    link = data.manifest.get("continues")
    before = link.get("trials_done") if isinstance(link, Mapping) else None
    ended = {t.index for t in data.trials if t.status in done and not t.again}
    ended |= set(before) if isinstance(before, list) else set()
    return int(data.manifest.get("trials_planned") or 0) - len(ended)


def _print_session(data: RunData) -> None:
    """What self-test, warm-up and zeros gave."""
    from pmabench.display.wording import OF_SESSIONS

    for event in data.events:
        if event.kind not in OF_SESSIONS:
            continue
        head, colon, text = OF_SESSIONS[event.kind](event.data)[0].partition(": ")
        if colon:
            click.echo(f"  {head:12} {text}")
        checks = event.data.get("checks") if event.kind == "self-test" else None
        for check in (one for one in checks or () if isinstance(one, Mapping) and one.get("verdict") != "ok"):
            said = f"{check.get('name')}: {check.get('verdict')}"
            click.echo(printable(f"  {'':12} {said}{'; ' if check.get('hint') else ''}{check.get('hint') or ''}"))


def _print_rest(data: RunData) -> None:
    """What only some runs have: a vent by the guard, clocks of their own, notes."""
    if guard := data.manifest.get("guard") or {}:
        vent = guard.get("vent")
        result = vent.get("result") if isinstance(vent, dict) else None
        click.echo(f"  {'guard':12} the bench was vented after the program died: {result or 'not reported'}")
        click.echo(f"  {'':12} {guard.get('cause', '')}".rstrip())
    for name, clock in data.clocks.items():
        if clock.how != "stated equal":
            drift, uncertainty = f"drift {1e6 * clock.drift:.3g} ppm", f"± {1e3 * clock.uncertainty:.3g} ms"
            click.echo(f"  {'clock':12} {name}: offset {clock.offset:.6g} s, {drift}, {uncertainty} ({clock.how})")
    for name, how in data.interpolated.items():
        click.echo(f"  {name:18} {how}")
    for note in data.notes:
        said = [note.text] if note.text else []
        if note.exclude is not None:
            said.append(f"trial {note.excluded} is left out: {note.because}")
        said += [f"[{file}]" for file in note.files]
        line = f"  note {note.number:<7} {note.utc[:16]} {note.operator}: {'; '.join(said)}"
        click.echo(printable(line))


@command.command(name="verify")
@click.argument("runs", nargs=-1, required=True, type=RunFolder())
@common
def verify_runs(ui: Ui, runs: tuple[Path, ...]) -> int | None:
    """Check hashes, checksums, gaps and torn rows of RUNS, or of every run in a folder of runs.

    Exit 3 where something is wrong, also where one of RUNS is no run; the others are checked all the same. What was
    added to a closed run is named; its sealed part is whole all the same.
    """
    from pmabench.store.catalogue import folders_in
    from pmabench.store.folder import LATE, MANIFEST
    from pmabench.store.since import late_files

    given = [run for run in runs if not (run.name.endswith(LATE) and run.is_dir() and not (run / MANIFEST).exists())]
    folders = [folder for run in given for folder in (folders_in(run) or [run])]
    found = {str(folder): _verified(folder) for folder in folders}
    wrong = {run: [str(finding) for finding in findings if not finding.added] for run, findings in found.items()}
    added = {run: [str(finding) for finding in findings if finding.added] for run, findings in found.items()}
    late = {str(folder): late_files(folder) for folder in folders}

    def human() -> None:
        for run, findings in wrong.items():
            state = [f"{len(findings)} finding{'s'[: len(findings) > 1]}" if findings else "whole"]
            state += [f"{len(added[run])} added"] if added[run] else []
            state += [f"{len(late[run])} late"] if late[run] else []
            click.echo(f"{run}: {', '.join(state)}")
            for finding in (*findings, *added[run]):
                click.echo(f"  {finding}")
            for name in late[run]:
                click.echo(f"  {Path(run).name}{LATE}/{name}: came after the run was closed; no seal protects it")

    lines = [f"{run}: {finding}" for run, findings in wrong.items() for finding in findings]
    ui.result({"schema": "pmabench.verify/1", "runs": wrong, "added": added, "late": late}, human, lines)
    return 3 if any(wrong.values()) else None


def _verified(folder: Path) -> list[Finding]:
    """What is wrong with a folder; that it is no run is the only finding then."""
    from pmabench.store.verify import Finding, verify

    try:
        return verify(folder)
    except InvalidFile as error:
        return [Finding(Path(problem.path).name, problem.message) for problem in error.problems]


@click.command(name="note")
@click.argument("run", type=RunFolder())
@click.argument("text", default="")
@click.option("--attach", multiple=True, type=PATH, metavar="FILE", help="A copy is kept.")
@click.option(
    "--exclude",
    type=click.IntRange(min=1),
    metavar="TRIAL",
    help="Leave a trial out of fits: its number in `runs show` and on the display, from 1.",
)
@click.option("--because", default="", metavar="TEXT", help="Why it is left out.")
@click.option("--operator", default="", help="Who says so; the login name if not given.")
@common
def note(
    ui: Ui, run: Path, text: str, attach: tuple[Path, ...], exclude: int | None, because: str, operator: str
) -> None:
    """Append a note to RUN, open or closed: TEXT, files, or a trial that is left out of fits and why."""
    from pmabench.store.notes import add_note

    index = None if exclude is None else exclude - 1
    note = add_note(run, text, attach=attach, exclude=index, because=because, operator=operator or user_name())
    data = {"schema": "pmabench.note-added/1", "run": str(run), "note": note.as_data()}

    def human() -> None:
        click.echo(f"note {note.number} of {run}")
        if note.exclude is not None:
            click.echo(f"left out: {_trial(run, note.exclude)}")

    ui.result(data, human)


def _trial(run: Path, index: int) -> str:
    """A trial in words, so that a wrong number is seen."""
    from pmabench.display.wording import point_text
    from pmabench.store.folder import EVENTS, decode_lines, read_file

    lines = decode_lines(read_file(run, EVENTS)).lines
    data = next(line["data"] for line in lines if line["kind"] == "trial-begin" and line["data"].get("trial") == index)
    return f"trial {index + 1} ({point_text(data.get('point') or {})})"
