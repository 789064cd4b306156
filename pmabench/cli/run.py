"""`pmabench run` and `continue`: a protocol on a bench into a run folder, and the way on after a run that ended early.

The exit code says how a run ended.
"""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import RecordError, UsageError, invalid
from pmabench.base.system import ENGINE, ordinary, real_time, user_name
from pmabench.cli.common import Ui, common, plan_options, say, session_options
from pmabench.cli.names import FOLDER, WIDTH, RunFolder, short, typed
from pmabench.cli.outcome import AtDisplay, Confirmed, at_terminal, print_checks, progress_line, show_end, show_next
from pmabench.engine.operator import Operator

if TYPE_CHECKING:
    from pmabench.bench.compile import Mounted
    from pmabench.cli.until import Until
    from pmabench.engine.run import Continues, Outcome
    from pmabench.kinds.compile import PlannedRun
    from pmabench.session.checks import Check
    from pmabench.store.records import RunData


@click.command(name="run")
@plan_options(required=False)
@click.option("--out", default=None, type=FOLDER, help="Where run folders go.  [default: runs]")
@click.option("--operator", default="", help="Who is at the bench; the login name if not given.")
@click.option("--yes", is_flag=True, help="Every prompt counts as answered; the record says so.")
@click.option("--resume", type=RunFolder(exists=True), help="Go on after the last trial of this run.")
@click.option(
    "--accept-changed",
    "accept",
    multiple=True,
    type=click.Choice(["bench", "calibration", "specimen", "protocol"]),
    help="With --resume: go on although this is not what it was.",
)
@click.option("--web", is_flag=True, help="Show it in a browser, too: prints the address to open.")
@click.option("--vent", is_flag=True, help="With --web: a vent button, where the bench file has `web_vent: true`.")
@click.option("--report", is_flag=True, help="Process the run when it is finished, and write its report.")
@click.option(
    "--until", metavar="GOAL", default="", help="Choose trials until intervals are so narrow: 'K 1 %, B_r 2 %'."
)
@click.option(
    "--time", "length", metavar="TIME", default="", help="With --until: longest time of all trials, '40 min'."
)
@session_options
@common
def command(
    ui: Ui, protocol: str | None, bench: str | None, specimen: str | None, until: str, length: str, **how: Any
) -> int | None:
    """Execute PROTOCOL on a bench with a specimen and record it.

    With --resume RUN the files of that run are used again, and what is left of it is done in a new run. With --until
    GOAL trials are chosen from the protocol's sweep one by one, each where it helps most, until the 95 % intervals of
    the coefficients are so narrow.
    """
    if how["vent"] and not how["web"]:
        raise UsageError("--vent belongs to --web")
    if length and not until:
        raise UsageError("--time belongs to --until")
    if until and how["resume"] is not None:
        raise UsageError("--resume keeps the goal of its run; leave --until out")
    goal = {"goal": until, "time": length} if until else {}
    return run_or_resume(ui, (protocol, bench, specimen), until=goal, **how)


def run_or_resume(
    ui: Ui,
    files: Sequence[str | None],
    *,
    resume: Path | None,
    settings: Sequence[tuple[str, str]] = (),
    accept: Sequence[str] = (),
    out: Path | None = None,
    operator: str = "",
    session: dict[str, Any] | None = None,
    yes: bool,
    web: bool = False,
    vent: bool = False,
    report: bool = False,
    until: Mapping[str, str] | None = None,
) -> int:
    """Run protocol, bench and specimen (`files`), or what is left of the run `resume`; show its end; its exit code.

    `until`: `goal` and longest `time` of a run whose trials are chosen; one that goes on has those of the run before.
    """
    from pmabench.cli.prepare import prepare

    if resume is not None:
        from pmabench.engine.resume import continue_run, sources
        from pmabench.store.folder import read_manifest

        until = read_manifest(resume).get("until")
        before = sources(resume) if None in files else {}
        roles = ("protocol", "bench", "specimen")
        files = [given or str(before[role]) for given, role in zip(files, roles, strict=True)]
        settings = settings or [(name, value) for name, value in before.get("set", ())]
        out = out or resume.resolve().parent
    protocol, bench, specimen = files
    if protocol is None or bench is None or specimen is None:
        named = (("PROTOCOL", protocol), ("--bench", bench), ("--specimen", specimen))
        lacking = " and ".join(name for name, given in named if given is None)
        raise UsageError(f"a run needs PROTOCOL, --bench and --specimen, or --resume RUN; missing: {lacking}")
    prepared = prepare(protocol, bench, specimen, settings)
    continues = None
    if resume is not None:
        continues = continue_run(resume, prepared.plan, prepared.mounted, prepared.protocol_text, accept)
    if web:
        from pmabench.cli.watch import start_view

        start_view(ui, out or Path("runs"), vent=vent)
    how: dict[str, Any] = {"operator_name": operator, "yes": yes, "session": session, "until": until}
    outcome = execute(ui, prepared, out or Path("runs"), continues=continues, **how)
    show_end(ui, outcome, prepared.mounted.bench, prepared.plan.kind, len(prepared.plan.trials))
    if report and outcome.status == "finished" and outcome.folder is not None:
        return _reported(ui, outcome.folder) or outcome.exit_code
    return outcome.exit_code


def _reported(ui: Ui, folder: Path) -> int:
    """Process a run and write its report next to `runs`; 6 where its results are not accepted."""
    from pmabench.cli.report import characterise, characterised_lines
    from pmabench.cli.sources import campaign_folder, place_of

    page = campaign_folder(folder.resolve().parent) / f"{folder.name}.html"
    found = characterise([folder], place_of(folder), page)
    if not ui.json:
        click.echo(str(page) if ui.quiet else "\n".join(["", *characterised_lines(found, page)]))
    return 6 if found.failed else 0


def execute(
    ui: Ui,
    prepared: PlannedRun,
    out: Path,
    *,
    operator_name: str = "",
    yes: bool = False,
    continues: Continues | None = None,
    about: dict[str, Any] | None = None,
    session: dict[str, Any] | None = None,
    until: Mapping[str, str] | None = None,
) -> Outcome:
    """Run a prepared plan, after a session where its bench has one and none counts.

    With a display in real time, with a line of progress in virtual time. `session` are options of `ensure`. With
    `until` its trials are chosen.
    """
    from pmabench.cli.prepare import needed, too_little
    from pmabench.cli.until import asked_of, choosing
    from pmabench.engine.run import run_plan
    from pmabench.protocol.plan import Ask

    asked = asked_of(prepared, until["goal"], until["time"]) if until else None
    steps = prepared.plan.steps if continues is None or until else continues.steps
    if not (yes or _somebody(prepared.mounted)) and any(isinstance(step, Ask) for step in steps):
        raise UsageError("this run needs hands, and there is no terminal; with --yes prompts count as answered")
    for warning in prepared.warnings():
        ui.note(warning)
    if prepared.mounted.bench.realtime and (why := real_time(ENGINE)):
        ui.note(f"{why}: a busy computer may end this run early; docs/when-it-goes-wrong.md says how to allow it")
    ordinary()
    if lack := too_little(needed(prepared.plan, steps), out):
        raise RecordError(lack)
    mounted = prepared.mounted
    if mounted.session is not None:
        mounted = _in_session(ui, mounted, out, operator_name, session or {}, yes=yes)
    about = {"sources": prepared.sources, **({"until": dict(until)} if until else {}), **(about or {})}
    with ExitStack() as stack:
        operator, shown = stack.enter_context(_operated(ui, mounted, prepared.plan.kind, yes=yes))
        if asked is not None:
            shown = shown | _chosen(stack.enter_context(choosing(ui, asked, realtime=mounted.bench.realtime)), shown)
        shown = shown | {"protocol_text": prepared.protocol_text, "deviations": prepared.deviations, "about": about}
        shown |= {"operator_name": operator_name, "continues": continues}
        return run_plan(prepared.plan, mounted, operator, out=out, **shown)


def _chosen(chooser: Until, shown: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `run_plan` with which trials are chosen; the chooser learns the run's folder as the display does."""
    from pmabench.engine.resume import Choosing

    def begun(folder: Path) -> None:
        chooser.folder = folder
        if "begun" in shown:
            shown["begun"](folder)

    return {"begun": begun, "further": lambda executor: Choosing(executor, chooser.choose)}


def _in_session(ui: Ui, mounted: Mounted, out: Path, who: str, options: dict[str, Any], *, yes: bool) -> Mounted:
    """The bench within a valid session, which is run first where none is; `options` are those of `ensure`."""
    from pmabench.session.session import SessionFailed, ensure

    with _operated(ui, mounted, "session", yes=yes) as (operator, shown):
        tables: list[Sequence[Check]] = []
        try:
            return ensure(
                mounted, operator, out, operator_name=who, say=ui.note, report=tables.append, **shown, **options
            )
        except SessionFailed as error:
            show_next(ui, error.outcome, mounted.bench, trials=False)
            raise
        finally:
            for checks in tables if not (ui.quiet or ui.json) else ():
                print_checks(ui, checks, err=True)


@contextmanager
def _operated(ui: Ui, mounted: Mounted, title: str, *, yes: bool) -> Iterator[tuple[Operator, dict[str, Any]]]:
    """Who answers, and how it is shown; a display is a process that reads what the run writes, never waited for."""
    if not mounted.bench.realtime or ui.quiet or ui.json:
        with progress_line(ui, title) as progress:
            operator = at_terminal(mounted.bench, yes=yes, there=_somebody(mounted))
            yield operator, {"progress": progress}
        return
    from pmabench.display.child import Display

    display = Display(color=ui.color)
    try:
        person = Confirmed(display) if yes else AtDisplay(display, answers=_somebody(mounted))
        yield person, {"begun": display.start}
    finally:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is vented and recorded: one more changes nothing
        display.close()
        signal.signal(signal.SIGINT, before)


def _somebody(mounted: Mounted) -> bool:
    """Whether there is a terminal at which a person can answer; a bench in real time must not be in the background."""
    if not mounted.bench.realtime:
        return sys.stdin.isatty()
    from pmabench.base.terminal import in_front

    return in_front(0) and in_front(2)


LOOKED = "Have you looked at the rig, and may pressure be put on it again?"


@click.command(name="continue")
@click.argument("run", required=False, type=RunFolder())
@click.option("--out", default="runs", show_default=True, type=FOLDER, help="Where run folders are.")
@click.option("--operator", default="", help="Who is at the bench; asked for if not given.")
@click.option("--because", default="", help="Why the bench may be used again; asked for where it is tripped.")
@click.option("--yes", is_flag=True, help="Ask nothing: every question counts as answered, and the record says so.")
@common
def continue_(ui: Ui, run: Path | None, out: Path, operator: str, because: str, *, yes: bool) -> int:
    """Say how RUN (or the newest in --out) ended, and lead on: reset its bench, do the trials that are left.

    Nothing is done before you have agreed to it.
    """
    from pmabench.store.reader import open_run

    folder = run if run is not None else _newest(out)
    data = open_run(folder)
    left, what_next = _left(folder, data)
    tripped = _tripped(data)
    ui.note(_happened(data, tripped))
    if tripped is not None and (code := _reset(tripped, operator, because, yes=yes)):
        return code
    if not left:
        data_next = {"schema": "pmabench.continue/1", "run": str(folder), "next": what_next}
        ui.result(data_next, lambda: click.echo(f"next    {what_next}"))
        return 0
    until = (data.manifest.get("until") or {}).get("goal")
    question = f"Go on choosing trials until {until}?" if until else f"Do the {left} trials that are left now?"
    if not yes and not _agreed(question, f"pmabench run --resume {typed(folder.resolve())}"):
        return 0
    return run_or_resume(ui, (None, None, None), resume=folder, operator=operator, yes=yes)


def _newest(out: Path) -> Path:
    from pmabench.store.catalogue import catalogue

    rows = [row for row in catalogue(out) if row.kind != "session" or row.status != "finished"] if out.is_dir() else []
    if not rows:
        raise invalid(out, "there is no run in this folder; name a run, or the folder with --out")
    newest = max(rows, key=lambda row: (row.date, row.folder))
    if newest.status == "running":
        raise UsageError(f"{newest.id} is going on; pmabench watch shows it")
    return out / newest.folder


def _left(folder: Path, data: RunData) -> tuple[int, str]:
    """How many trials are left, and the command to type where none can be done by going on."""
    from pmabench.cli.runs import ended_early, going_on, trials_left
    from pmabench.report.many import without_trials

    after = going_on(folder, data)
    if after["continued_by"]:
        later = folder.resolve().parent / after["continued_by"]
        return 0, f"pmabench continue {typed(later)}    goes on after the run that continued this one"
    if after["resume"]:
        return trials_left(data), ""
    if ended_early(data) and not any(trial.status == "finished" for trial in data.trials):
        return 0, "nothing of it can be processed or continued; run the protocol again"
    if without_trials(folder):
        return 0, f"nothing: a run of kind {data.kind} has no trials to process"
    return 0, f"pmabench process {typed(folder.resolve())}"


def _happened(data: RunData, tripped: Any) -> str:
    from pmabench.cli.runs import trials_left, vented

    planned = int(data.manifest.get("trials_planned") or 0)
    why = str(data.manifest.get("why") or "")
    mark = "SIMULATED  " if data.simulated else ""
    head = f"{mark}{data.status.upper()}  {data.kind}, {short(Path(data.path))}" + (f": {why}" if why else "")
    lines = wrap(head, WIDTH, subsequent_indent="   ")
    done = planned - trials_left(data)
    trials = f"{done} of {planned} trials are done" if planned else "a run without trials"
    guard = data.manifest.get("guard") or {}
    result = vented(data) or str((guard.get("vent") or {}).get("result") or "")
    lines.append(f"   {trials}; vent {result or 'not recorded'}")
    if tripped is not None:
        lines.append("   its bench is tripped: nothing runs on it until it is reset")
    return "\n".join(lines)


def _tripped(data: RunData) -> str | None:
    """The bench as `vent` takes it, where it is tripped."""
    from pmabench.guard.station import stations

    name = data.manifest.get("bench")
    known = ((station, station.read("bench")) for station in stations())
    mine = (station for station, saved in known if saved.get("name") == name and saved.get("realtime"))
    return str(name) if any(station.latched() for station in mine) else None


def _reset(bench: str, operator: str, because: str, *, yes: bool) -> int:
    """Vent and reset the bench where a person says that it may be used again; another exit code than 0 where not."""
    import subprocess

    by_hand = f"pmabench vent {shlex.quote(bench)} --reset --operator NAME --because TEXT"
    if not (yes or (operator and because)) and not _agreed(LOOKED, by_hand):
        return 5
    if not (operator and because) and not sys.stdin.isatty():
        raise UsageError(f"a reset is recorded: say who and why, with --operator NAME --because TEXT, or {by_hand}")
    operator = operator or click.prompt("Who resets it", default=user_name(), err=True)
    because = because or click.prompt("Why may it be used again", err=True)
    asked = ["vent", bench, "--reset", "--operator", operator, "--because", because]
    done = subprocess.run([sys.executable, "-m", "pmabench", *asked], stdout=sys.stderr.fileno(), check=False)
    return done.returncode  # a process for itself: it holds the lock of the bench until it ends


def _agreed(question: str, command: str) -> bool:
    """Whether a person says yes; without a terminal nobody can, and the command for it is named."""
    answer = "" if sys.stdin.isatty() else "n"
    while answer not in ("y", "yes", "n", "no"):
        if answer:
            say("type y for yes, n for no")
        answer = click.prompt(f"{question} [y/N]", default="n", show_default=False, err=True).strip().lower()
    if answer.startswith("y"):
        return True
    say(f"not done; later:  {command}")
    return False
