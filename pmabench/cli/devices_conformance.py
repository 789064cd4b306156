"""`pmabench devices conformance`: what every driver must keep, tried against its own emulator."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import InvalidFile, UsageError, VerdictFailed
from pmabench.cli.common import Ui, common, say

if TYPE_CHECKING:
    from pmabench.bench.interface import DeviceRecord
    from pmabench.conformance.verdict import Result


@click.command(name="conformance")
@click.argument("driver")
@click.option("--bench", help="Bench file with a device of this driver; else the first shipped one that has one.")
@click.option("--device", help="Its name in the bench file; else the first one of this driver.")
@click.option("--hostile", type=click.IntRange(0, 10_000_000), default=300, show_default=True, help="Damaged answers.")
@click.option("--seed", type=int, default=1, show_default=True, help="Which damage; the same seed, the same damage.")
@common
def conformance(ui: Ui, driver: str, bench: str | None, device: str | None, hostile: int, seed: int) -> int:
    """Try DRIVER (its name, or module:Class) against its own emulator: one line for each promise of a driver.

    What is tried is a device of a bench file, with the emulator behind a wire of its own; no address of the file is
    reached. Exit code 6 where a check fails. How to write a driver: docs/drivers.md.
    """
    from pmabench.conformance.suite import run
    from pmabench.conformance.verdict import FAILED

    record, realtime, source = _record(driver, bench, device)
    ui.note(f"{record.driver} as {record.name} of {source}")
    results: list[Result] = []
    for result in run(record, hostile=hostile, seed=seed, realtime=realtime):
        results.append(result)
        if not ui.json and (result.verdict == FAILED or not ui.quiet):
            click.echo(f"{result.verdict:<15} {result.check:<16} {result.why}")
    failed = [result.check for result in results if result.verdict == FAILED]
    data = {
        "schema": "pmabench.conformance/1",
        "driver": record.driver,
        "device": record.name,
        "bench": source,
        "hostile": hostile,
        "seed": seed,
        "checks": [asdict(result) for result in results],
    }
    if ui.json:
        ui.result(data, lambda: None)
    if failed:
        say(f"{len(failed)} of {len(results)} checks failed: {', '.join(failed)}")
    return VerdictFailed.exit_code if failed else 0


def _record(driver: str, bench: str | None, device: str | None) -> tuple[DeviceRecord, bool, str]:
    """The device to try, whether its bench runs in real time, and where it stands."""
    from pmabench.bench.compile import mount_alone
    from pmabench.bench.registry import driver_class
    from pmabench.files.shipped import find_file, shipped_folder

    try:
        target = driver_class(driver)
    except ValueError as error:
        raise UsageError(f"{error}; or give module:Class") from error
    paths = [find_file("bench", bench)] if bench else sorted(shipped_folder("bench").glob("*.yaml"))
    for path in paths:
        try:
            compiled = mount_alone(path).bench
        except InvalidFile:
            if bench:
                raise
            continue
        for record in compiled.devices:
            if record.driver == target and device in {None, record.name}:
                return record, compiled.realtime, Path(path).name
    where = bench or "the shipped benches"
    named = f' called "{device}"' if device else ""
    raise UsageError(
        f"no device{named} of the driver {target} in {where}; give --bench FILE with one, as docs/drivers.md says"
    )
