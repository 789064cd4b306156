"""`pmabench check`: all errors of all files at once, and the plan; nothing touches a device."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import RecordError, UsageError
from pmabench.base.quantities import CHANNEL_QUANTITY, in_words, show
from pmabench.cli.common import Ui, common, fields, plan_options
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.protocol.idle import Idle, foreseen, without
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.bench.compile import Mounted
    from pmabench.cli.prepare import Prepared
    from pmabench.protocol.plan import Plan


@click.command(name="check")
@plan_options()
@click.option("--plan", "show_plan", is_flag=True, help="Print every step.")
@click.option("--out", default="runs", type=click.Path(path_type=Path), help="Where the run would go, for the disk.")
@click.option("--simulate", is_flag=True, help="Run the plan on the bench with a simulated muscle; show the peaks.")
@click.option("--drop-idle", is_flag=True, help="Write the protocol without trials that cannot lift; with -o.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="The file for --drop-idle.")
@common
def command(
    ui: Ui,
    protocol: str,
    bench: str,
    specimen: str,
    settings: list[tuple[str, str]],
    out: Path,
    *,
    output: Path | None,
    drop_idle: bool,
    show_plan: bool,
    simulate: bool,
) -> int | None:
    """Check PROTOCOL against a bench and a specimen, and show the plan."""
    from pmabench.cli.prepare import prepare, too_little

    prepared = prepare(protocol, bench, specimen, settings)
    plan, mounted, warnings = prepared.plan, prepared.mounted, prepared.warnings()
    summary = plan_summary(plan, mounted)
    summary["disk"] = too_little(summary["bytes"], out)
    if summary["disk"]:
        warnings = [*warnings, f"too little room on the disk, `run` refuses: {summary['disk']}"]
    expected = mounted.specimen_file.expected
    idle = foreseen(plan, expected) if expected is not None else None
    summary["idle"] = None if idle is None else {"trials": idle.idle, "doubtful": idle.doubtful, "first": idle.first}
    if drop_idle != (output is not None):
        raise UsageError("--drop-idle and -o FILE belong together")
    if output is not None:
        _write_without(prepared, idle, output, settings)
        summary["written"] = str(output)
    peaks = _simulate(plan, mounted) if simulate else None
    if peaks is not None:
        summary["simulated"] = peaks
    if show_plan:
        summary["plan"] = plan.to_dict()

    def human() -> None:
        _print(ui, plan, summary, peaks, warnings)
        for line in _idle_lines(plan, idle, output):
            click.echo(line)
        if show_plan:
            _print_steps(plan)

    ui.result(summary, human, None if show_plan or simulate else warnings)
    return None if peaks is None else int(peaks["exit_code"])


def plan_summary(plan: Plan, mounted: Mounted) -> dict[str, Any]:
    """Duration, rows, bytes, and each command's range next to the active limits, in SI.

    The duration holds the session that comes first, where the bench declares one and none counts now.
    """
    from pmabench.cli.prepare import needed
    from pmabench.session.length import session_length
    from pmabench.session.state import kept, out_of_date, utc_now

    shortest, longest = plan.duration()
    session = None
    if (length := session_length(mounted)) is not None:
        why = out_of_date(kept(mounted.bench.name), mounted, utc_now())
        session = {**vars(length), "parts": list(length.parts), "due": bool(why), "because": why}
        if why:
            shortest, longest = shortest + length.shortest, longest + length.longest
    outputs = {output.name: output for output in mounted.bench.outputs}
    rows = plan.rows()
    return {
        "schema": "pmabench.check/1",
        **fields(plan, "kind", "name", "source", "hazards"),
        "bench": mounted.bench.name,
        "plants": _plants(mounted),
        "trials": len(plan.trials),
        "steps": len(plan.steps),
        "duration": {"shortest": shortest, "longest": longest, "unit": "s"},
        "session": session,
        "rows": rows,
        "bytes": needed(plan),
        "commands": {
            name: {
                **{"lowest": low, "highest": high, "quantity": outputs[name].quantity},
                "limits": [outputs[name].low, outputs[name].high],
                "limits_from": [outputs[name].low_from, outputs[name].high_from],
            }
            for name, (low, high) in plan.commands().items()
        },
        "lacks": list(mounted.lacks),
        "plan_sha256": plan.sha256,
    }


def _plants(mounted: Mounted) -> dict[str, str]:
    """Device -> the simulated muscle in it, with the plant file that describes it."""
    named = {device.name: device.options["plant"] for device in mounted.bench.devices if "plant" in device.options}
    return {
        device: f"{plant['name']} ({plant['file']})" if isinstance(plant, dict) else str(plant)
        for device, plant in named.items()
    }


def _simulate(plan: Plan, mounted: Mounted) -> dict[str, Any]:
    from pmabench.engine.run import run_plan

    muscle = ""
    left_out: tuple[str, ...] = ()
    if mounted.bench.realtime:
        from pmabench.bench.dry_run import dry_run, options_of, wants

        expected = mounted.specimen_file.expected
        if expected is None:
            raise UsageError(f"--simulate: {wants(mounted)}")
        dry = dry_run(mounted, options_of(expected, mounted), f"as expected in the specimen file: {expected.source}")
        mounted, muscle, left_out = dry.mounted, dry.muscle, dry.left_out
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=None)
    return {
        "muscle": muscle,
        "left_out": left_out,
        **fields(outcome, "status", "exit_code", "why"),
        "duration": outcome.bench_seconds,
        "measured": {name: {"lowest": low, "highest": high} for name, (low, high) in outcome.extremes.items()},
        "trials_failed": [index + 1 for index in outcome.trials_failed],
    }


def _print(ui: Ui, plan: Plan, summary: dict[str, Any], peaks: dict[str, Any] | None, warnings: list[str]) -> None:
    from pmabench.cli.prepare import size

    console = ui.console()
    console.print(f"{plan.name} ({plan.kind})\n  source    {plan.source}\n  bench     {summary['bench']}")
    for plant in summary["plants"].values():
        console.print(f"  plant     {plant}, simulated")
    shortest, longest = summary["duration"]["shortest"], summary["duration"]["longest"]
    length = in_words(longest) if shortest == longest else f"{in_words(shortest)} to {in_words(longest)}"
    asks, session = sum(step.kind == "ask" for step in plan.steps), summary["session"]
    if session is not None and session["due"]:
        asks += session["hands"]
    console.print(
        f"  length    {length}, without the operator's time; hands are needed {asks} time{'' if asks == 1 else 's'}"
    )
    if session is not None and session["due"]:
        parts, least = ", ".join(session["parts"]) or "nothing in it", in_words(session["shortest"])
        console.print(
            f"            the session before it is in that: {parts}, at least {least}, hands {session['hands']}"
        )
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
    if peaks is not None:
        ending = "" if peaks["status"] == "finished" else f": {peaks['why']}"
        console.print(f"simulated: {peaks['status']}{ending}, {in_words(peaks['duration'])}")
        if peaks["muscle"]:
            console.print(f"  this bench with a simulated muscle, {peaks['muscle']}")
        for sentence in peaks["left_out"]:
            console.print(f"  {sentence}")
        for name, span in peaks["measured"].items():
            quantity = CHANNEL_QUANTITY[name]
            console.print(
                f"  {name:18} {show(span['lowest'], quantity, 4):>12} to {show(span['highest'], quantity, 4)}"
            )
    console.print("nothing was sent to a bench")


def _idle_lines(plan: Plan, idle: Idle | None, written: Path | None) -> list[str]:
    """What is said of trials that cannot move, and what to type."""
    if idle is None or not idle.all:
        return []
    count = f"!  {len(idle.idle)} of {len(plan.trials)} trials are not expected to lift their load"
    doubtful = f", {len(idle.doubtful)} more may not" if idle.doubtful else ""
    first = [f"   {idle.first}"] if idle.first else []
    if written is not None:
        return [count + doubtful, *first, f"   {written} has the sweep without them"]
    return [count + doubtful, *first, "   the same command with --drop-idle -o FILE writes the protocol without them"]


def _write_without(prepared: Prepared, idle: Idle | None, path: Path, settings: list[tuple[str, str]]) -> None:
    from pmabench.bench.dry_run import wants
    from pmabench.kinds.compile import read_protocol

    if idle is None:
        raise UsageError(f"--drop-idle: {wants(prepared.mounted)}")
    if path.exists():
        raise UsageError(f"{path} is there already; give the name of a new file")
    document, model = read_protocol(Path(prepared.sources["protocol"]), settings)
    text = without(document, model.sweep, prepared.protocol_text, idle.all)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path} cannot be written: {error.strerror}") from error


def _print_steps(plan: Plan) -> None:
    counts: Counter[str] = Counter()
    for number, step in enumerate(plan.steps):
        counts[step.kind] += 1
        fields = {key: value for key, value in vars(step).items() if key != "phase" and value is not None}
        text = "  ".join(f"{key}={_plain(value)}" for key, value in fields.items())
        click.echo(f"{number:5d}  {step.kind:10} {step.phase:12} {text}")
    click.echo("      " + ", ".join(f"{count} {kind}" for kind, count in counts.items()) + "; values in SI")


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
