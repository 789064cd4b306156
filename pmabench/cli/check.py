"""`pmabench check`: all errors of all files at once, and the plan; nothing touches a device."""

from __future__ import annotations

import shlex
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.base.quantities import in_words, show
from pmabench.base.text import printable
from pmabench.bench.compile import Mounted
from pmabench.cli.common import Ui, common, fields, labelled, no_overwriting, plan_options
from pmabench.cli.names import FILE, FOLDER, next_lines, typed
from pmabench.cli.outcome import progress_line
from pmabench.cli.prepare import needed, prepare, size, too_little
from pmabench.kinds.compile import PlannedRun, read_protocol
from pmabench.protocol.plan import Plan
from pmabench.protocol.sweep import Idle, idle_trials, without
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.bench.dry_run import PredictedMuscle


@click.command(name="check")
@plan_options()
@click.option("--plan", "show_plan", is_flag=True, help="Print every step.")
@click.option("--out", default="runs", type=FOLDER, help="Where the run would go, for the disk.")
@click.option("--simulate", is_flag=True, help="Run the plan on the bench with a simulated muscle; show the peaks.")
@click.option(
    "--muscle", type=click.Path(path_type=Path, exists=True), help="What to simulate: an analysis, or a plant file."
)
@click.option("--drop-idle", is_flag=True, help="Write the protocol without trials that cannot lift; with -o.")
@click.option("-o", "--output", type=FILE, help="The file for --drop-idle.")
@common
def command(
    ui: Ui,
    out: Path,
    *,
    muscle: Path | None,
    output: Path | None,
    drop_idle: bool,
    show_plan: bool,
    simulate: bool,
    **files: Any,
) -> int | None:
    """Check PROTOCOL against a bench and a specimen, and show the plan."""
    prepared = prepare(**files)
    plan, mounted = prepared.plan, prepared.mounted
    summary = plan_summary(plan, mounted)
    summary["disk"] = too_little(summary["bytes"], out)
    full = [f"`run` refuses: {summary['disk']}"] if summary["disk"] else []
    warnings = [*prepared.warnings(), *full]
    if drop_idle != (output is not None):
        raise UsageError("--drop-idle and -o FILE belong together")
    simulate |= muscle is not None
    one = not mounted.bench_file.muscles
    replaced = mounted.bench.realtime or muscle is not None  # the bench's devices, or its simulated muscle
    known = None
    if (one or (simulate and replaced)) and (replaced or output or mounted.specimen_file.expected is not None):
        from pmabench.cli.dry_run import muscle_of

        known = muscle_of(mounted, muscle)  # of a simulated bench only what the file expects, unless asked for
    idle = idle_trials(plan, known.expected) if known is not None and known.expected is not None else None
    summary["idle"] = None if idle is None else {"trials": idle.idle, "doubtful": idle.doubtful}
    if output is not None:
        _write_without(prepared, idle, output)
        summary["written"] = str(output)
    refused = bool(mounted.unconfirmed) and mounted.bench.realtime
    if show_plan:
        summary["plan"] = plan.to_dict()
    if simulate:
        from pmabench.cli.dry_run import findings_of, report

        simulated = summary["simulated"] = _tried(ui, plan, mounted, known, replaced=replaced)
        lines = [*findings_of(simulated), *_idle_lines(plan, idle, output), *_open(mounted), *warnings]
        then = _then(prepared, idle, output, refused=refused, done=simulated["status"] == "finished")

    def human() -> None:
        if not simulate or ui.verbose:
            _print(ui, plan, summary, [*_open(mounted), *warnings])
            click.echo("".join(f"!  {line}\n" for line in _idle_lines(plan, idle, output)), nl=False)
        done = report(plan, mounted, simulated, lines, then) if simulate else ["nothing was sent to a bench"]
        click.echo("\n".join(done))
        if show_plan:
            _print_steps(plan)

    ui.result(summary, human, None if show_plan or simulate else warnings)
    return int(simulated["exit_code"]) if simulate else InvalidFile.exit_code if refused else None


def _tried(ui: Ui, plan: Plan, mounted: Mounted, known: PredictedMuscle | None, *, replaced: bool) -> dict[str, Any]:
    """What the plan does on a simulated muscle, and which intervals it is expected to give."""
    from pmabench.cli.dry_run import expected_intervals, simulate

    ui.note("the plan is run on a simulated muscle; nothing is sent to a bench")
    with progress_line(ui, "simulated") as progress:
        found = simulate(plan, mounted, known if replaced else None, progress)
    return found | {"intervals": expected_intervals(plan, mounted, known)}


def _open(mounted: Mounted) -> list[str]:
    """A line where values are not confirmed."""
    count = len(mounted.unconfirmed)
    if not count:
        return []
    first = mounted.unconfirmed[0]
    then = "run refuses them on real devices" if mounted.bench.realtime else "this simulated bench runs with them"
    return [f"{count} values are not confirmed ({then}); first {first}"]


def plan_summary(plan: Plan, mounted: Mounted) -> dict[str, Any]:
    """Duration, rows, bytes, and each command's range next to the active limits, in SI.

    The duration does not include a session, which comes first where the bench declares one and none counts now.
    """
    from pmabench.session.session import kept, out_of_date, parts, utc_now

    shortest, longest = plan.duration()
    session = None
    if mounted.session is not None:
        why = out_of_date(kept(mounted.bench.name), mounted, utc_now())
        session = {"parts": parts(mounted), "due": bool(why), "because": why}
    return {
        "schema": "pmabench.check/1",
        **fields(plan, "kind", "name", "source", "hazards"),
        "bench": mounted.bench.name,
        "plants": _plants(mounted),
        "trials": len(plan.trials),
        "steps": len(plan.steps),
        "duration": {"shortest": shortest, "longest": longest, "unit": "s"},
        "session": session,
        "rows": plan.rows(),
        "bytes": needed(plan),
        "commands": {
            name: {"lowest": low, "highest": high, "quantity": out.quantity, "limits": [out.low, out.high]}
            | {"limits_from": [out.low_from, out.high_from]}
            for name, (low, high) in plan.commands().items()
            for out in [mounted.bench.commanded[name]]
        },
        "lacks": list(mounted.lacks),
        "unconfirmed": [str(problem) for problem in mounted.unconfirmed],
        "plan_sha256": plan.sha256,
    }


def _plants(mounted: Mounted) -> dict[str, str]:
    """Device -> the simulated muscle in it, with the plant file that describes it."""
    named = {device.name: device.options["plant"] for device in mounted.bench.devices if "plant" in device.options}
    return {
        device: f"{plant['name']} ({plant['file']})" if isinstance(plant, dict) else str(plant)
        for device, plant in named.items()
    }


def _print(ui: Ui, plan: Plan, summary: dict[str, Any], warnings: list[str]) -> None:
    console = ui.console()
    console.print(f"{plan.name} ({plan.kind})")
    plants = (("plant", f"{plant}, simulated") for plant in summary["plants"].values())
    for label, text in (("source", plan.source), ("bench", summary["bench"]), *plants):
        console.print(labelled(label, printable(text), console.width))
    shortest, longest = summary["duration"]["shortest"], summary["duration"]["longest"]
    length = in_words(shortest)
    length += f" to {in_words(longest)}, if every wait takes its longest" if shortest != longest else ""
    asks, session = sum(step.kind == "ask" for step in plan.steps), summary["session"]
    times = "1 time" if asks == 1 else f"{asks} times"
    hands = f"{length}; without the operator's time; hands are needed {times}"
    console.print(labelled("length", hands, console.width))
    if session is not None and session["due"]:
        parts = ", ".join(session["parts"]) or "nothing in it"
        console.print(labelled("", f"a session comes first and is not in that: {parts}", console.width))
    elif session is not None:
        console.print("            no session before it: the last one still counts")
    console.print(
        f"  record    {summary['trials']} trials, at most {summary['rows']:,} rows, "
        f"{size(summary['bytes'])} on disk while running"
    )
    rows = []
    for name, span in summary["commands"].items():
        numbers = [show(value, span["quantity"]) for value in (span["lowest"], span["highest"], span["limits"][1])]
        rows.append([name, *numbers, span["limits_from"][1]])
    print_grid(console, ["command", "lowest", "highest", "limit", "set by"], rows, ("command", "set by"))
    for warning in warnings:
        console.print(warning)


def _idle_lines(plan: Plan, idle: Idle | None, written: Path | None) -> list[str]:
    """What is said of trials that cannot move, and what to type."""
    if idle is None or not idle.all:
        return []
    doubtful = f", {len(idle.doubtful)} more may not" if idle.doubtful else ""
    count = f"{len(idle.idle)} of {len(plan.trials)} trials are not expected to lift their load{doubtful}"
    return [count, *([f"{written} has the sweep without them"] if written is not None else [])]


def _then(prepared: PlannedRun, idle: Idle | None, written: Path | None, *, refused: bool, done: bool) -> list[str]:
    """What to type after a dry run."""
    files = {role: typed(Path(prepared.sources[role]), role) for role in ("protocol", "bench", "specimen")}
    rest = ["--bench", files["bench"], "--specimen", files["specimen"]]
    if not done:
        return ["next    change the protocol or the limits, and check again"]
    if idle is not None and idle.all and written is None:
        return next_lines("pmabench", "check", files["protocol"], *rest, "--drop-idle", "-o", "moving.yaml")
    if refused:
        return ["next    look up the values that are not confirmed, then check again"]
    return next_lines("pmabench", "run", files["protocol"] if written is None else shlex.quote(str(written)), *rest)


def _write_without(prepared: PlannedRun, idle: Idle | None, path: Path) -> None:
    from pmabench.report.writing import write_file

    if idle is None:
        raise UsageError("--drop-idle: a plant file predicts no idle trials; give an analysis")
    no_overwriting(path)
    document, model = read_protocol(Path(prepared.sources["protocol"]), prepared.sources["set"])
    write_file(path, without(document, model.sweep, prepared.protocol_text, idle.all), "the protocol")


def _print_steps(plan: Plan) -> None:
    counts: Counter[str] = Counter()
    for number, step in enumerate(plan.steps):
        counts[step.kind] += 1
        fields = {key: value for key, value in vars(step).items() if key != "phase" and value is not None}
        shown = {key: f"{value:g}" if isinstance(value, float) else str(value) for key, value in fields.items()}
        text = "  ".join(f"{key}={value}" for key, value in shown.items())
        click.echo(f"{number:5d}  {step.kind:10} {step.phase:12} {text}")
    click.echo("      " + ", ".join(f"{count} {kind}" for kind, count in counts.items()) + "; values in SI")
