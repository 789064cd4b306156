"""`pmabench drivers`: those that are installed, and the conformance of one with what every driver must keep."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, VerdictFailed, did_you_mean
from pmabench.base.kind import load
from pmabench.cli.common import Group, Ui, common, say
from pmabench.cli.names import BENCH
from pmabench.files.shipped import find_file
from pmabench.report.terminal import print_texts

if TYPE_CHECKING:
    from pmabench.conformance import Result

CAPABILITIES = {
    "Stream": "samples",
    "SetPoint": "set-points",
    "Follower": "ramps and sines",
    "Hands": "hands",
    "Switch": "valves",
    "Motion": "stops a motion",
    "Inputs": "digital inputs",
    "Watchdog": "watchdog",
    "Rescue": "second way",
}
"""Capability of `pmabench.bench.interface` -> what it is called here."""


@click.group(name="drivers", cls=Group)
def command() -> None:
    """Drivers that are installed: list them, try one against its emulator."""


@command.command(name="list")
@common
def list_(ui: Ui) -> None:
    """List the drivers that are installed, what each can do, and on what it was verified."""
    from pmabench.bench.driver_options import drivers

    rows = [_driver(name, target) for name, target in sorted(drivers().items())]
    table = [[row["name"], row["verified"], row["problem"] or ", ".join(row["can"])] for row in rows]
    data = {"schema": "pmabench.drivers/1", "drivers": rows}
    ui.result(data, lambda: print_texts(ui.console(), ["driver", "verified", "can"], table))


def _driver(name: str, target: str) -> dict[str, Any]:
    from pmabench.bench import interface
    from pmabench.bench.driver_options import verified

    try:
        made = load(target)
    except (ImportError, AttributeError) as error:
        return {"name": name, "driver": target, "can": [], "verified": "", "problem": f"cannot be loaded: {error}"}
    can = [word for kind, word in CAPABILITIES.items() if issubclass(made, getattr(interface, kind))]
    return {
        "name": name,
        "driver": target,
        "can": can,
        "verified": verified(made),
        "problem": "" if issubclass(made, interface.Device) else "does not implement the device interface",
    }


@command.command(name="conformance")
@click.argument("driver")
@click.option(
    "--bench", type=BENCH, help="Bench file with a device of this driver; else the shipped one with most to try."
)
@click.option("--device", help="Its name in the bench file; else the one of this driver with most to try.")
@click.option("--hostile", type=click.IntRange(0, 10_000_000), default=300, show_default=True, help="Damaged answers.")
@click.option("--seed", type=int, default=1, show_default=True, help="Which damage; the same seed, the same damage.")
@click.option("--check", "only", multiple=True, metavar="NAME", help="Only this one; may be repeated.")
@common
def conformance(
    ui: Ui, driver: str, bench: str | None, device: str | None, hostile: int, seed: int, only: tuple[str, ...]
) -> int:
    """Try DRIVER (its name, or module:Class) against its own emulator: one line for each promise of a driver.

    What is tried is a device of a bench file, with the emulator behind its own wire; no address of the file is
    reached. Exit code 6 where a check fails. How to write a driver: docs/drivers.md.
    """
    from pmabench.conformance import FAILED, run, subject
    from pmabench.conformance.suite import CHECKS, HOSTILE

    for name in only:
        if name not in CHECKS and name != HOSTILE:
            raise UsageError(f'no check "{name}"{did_you_mean(name, [*CHECKS, HOSTILE])}')
    tried = subject(driver, find_file("bench", bench) if bench else None, device)
    ui.note(f"{tried.record.driver} as {tried.record.name} of {tried.bench}")
    results: list[Result] = []
    for result in run(tried, hostile=hostile, seed=seed, only=only):
        results.append(result)
        if not ui.json and (result.verdict == FAILED or not ui.quiet):
            click.echo(f"{result.verdict:<15} {result.check:<16} {result.why}")
    failed = [result.check for result in results if result.verdict == FAILED]
    data = {
        "schema": "pmabench.conformance/1",
        "driver": tried.record.driver,
        "device": tried.record.name,
        "bench": tried.bench,
        "hostile": hostile,
        "seed": seed,
        "checks": [asdict(result) for result in results],
    }
    if ui.json:
        ui.result(data, lambda: None)
    if failed:
        say(f"{len(failed)} of {len(results)} checks failed: {', '.join(failed)}")
    return VerdictFailed.exit_code if failed else 0
