"""`pmabench emulate`: the simulated muscle behind the wires of a bench, for practice and tests; knows no driver."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pmabench.bench.interface import OutputRecord
    from pmabench.cli.emulated_faults import Faults, Schedule

PRESETS = (
    "paper0",
    "paper0-air",
    "serres2009",
    "dmsp-40-305",
    *(f"contractor-{cm}" for cm in (15, 20, 25, 30, 40)),
    "arm-30",
)
NOT_PROVEN = "scales not proven: wiring and scales are taken from the bench file itself, so its errors cancel out"


@click.command(name="emulate")
@click.argument("bench")
@click.option("--plant", default="paper0", help=f"The muscle: {', '.join(PRESETS)}, or the path of a plant file.")
@click.option(
    "--preset", type=click.Choice(["bench", "ideal"]), default="bench", help="bench: lag, friction, noise; or ideal."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the noise.")
@click.option("--log", type=click.Path(dir_okay=False, path_type=Path), help="Append every exchange as JSON lines.")
@click.option(
    "--faults", type=click.Path(dir_okay=False, path_type=Path), help="YAML file of what goes wrong, and when."
)
@click.option("--truth", help="What is really wired, and by which scales: a shipped rig's name, or a truth file.")
@click.option(
    "--wrong",
    multiple=True,
    help="What differs from that, as scale:force=0.5, sign:displacement, swap:pressure=force, offset:force=120 N.",
)
@click.option("--expose", is_flag=True, help="Serve also at addresses that other machines can reach.")
@click.option("--control", type=click.IntRange(0, 65535), default=0, help="Port for loads and faults; 0: a free one.")
@common
def command(
    ui: Ui,
    bench: str,
    plant: str,
    preset: str,
    seed: int,
    log: Path | None,
    faults: Path | None,
    control: int,
    truth: str | None,
    wrong: tuple[str, ...],
    *,
    expose: bool,
) -> int | None:
    """Serve the devices of BENCH whose drivers have an emulator on this machine, in real time, until Ctrl-C.

    Devices answer at the addresses of the bench file: TCP at its address (port 0 takes a free one, which is printed),
    serial ports as links to pseudo-terminals. What is typed here happens: "load 6 kg" (all that hangs on the free
    end), "fault DEVICE delay 300 ms count 5", "fault DEVICE clear", "plant burst for 2 s"; "after 5 s" behind a line
    lets it happen then.

    A shipped bench is emulated from its truth file, which says from data sheets what is wired and by which scales. For
    another bench without --truth that is taken from the bench file itself: then its scales are not proven.
    """
    from importlib.metadata import entry_points

    from pmabench.base.errors import RecordError, UsageError
    from pmabench.base.system import ENGINE, real_time
    from pmabench.bench.compile import mount_alone
    from pmabench.bench.truth import read_truth, truth_of
    from pmabench.cli.emulated_faults import Faults
    from pmabench.files.shipped import find_file

    real_time(ENGINE)  # a device does not wait for other programs
    path = find_file("bench", bench)
    mounted = mount_alone(path)
    real = truth_of(path) if truth is None else find_file("truth", truth)
    found = entry_points(group="pmabench.emulators")
    if not found:
        raise UsageError("no emulator is installed")
    served: Any = next(iter(found)).load()(
        mounted.bench.devices,
        truth=None if real is None else read_truth(real),
        wrong=[_in_si(text) for text in wrong],
        plant=_muscle(plant, mounted.bench.outputs),
        preset=preset,
        seed=seed,
        log=log,
        control=control,
        expose=expose,
    )
    try:
        _serve(ui, served, real, Faults(served, mounted.bench.gravity, mounted.bench.carriage), faults)
    except KeyboardInterrupt:
        pass
    finally:
        served.close()
    if served.log.problem:
        raise RecordError(served.log.problem)
    return None


def _serve(ui: Ui, served: Any, truth: Path | None, faults: Faults, file: Path | None) -> None:
    """Say what is served and by which wiring, then let what `file` and the keyboard ask happen, until SIGTERM."""
    import signal
    import threading

    from pmabench.cli.emulated_faults import Schedule

    planned = [] if file is None else faults.of_file(file)
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    ui.result(
        {
            "schema": "pmabench.emulate/1",
            "devices": {name: device.address for name, device in served.devices.items()},
            "control": served.control.address,
            "truth": None if truth is None else str(truth),
            "wrong": served.wrong,
        },
        lambda: click.echo("\n".join([*served.lines(), f"control: {served.control.address}"])),
    )
    ui.note(f"wiring and scales from {truth}" if truth is not None else NOT_PROVEN)
    for sentence in served.wrong:
        ui.note(f"wrong on purpose: {sentence}")
    ui.note("serving until Ctrl-C")
    schedule = Schedule(served.act, ui.note)
    schedule.add(planned)
    threading.Thread(target=_typed, args=(ui, faults, schedule), daemon=True).start()
    ended.wait()


def _in_si(text: str) -> str:
    """What is wrong on purpose, its value without a unit, in SI."""
    from pmabench.base.errors import UsageError
    from pmabench.files.quantity import parse_quantity

    head, equals, value = text.partition("=")
    if not head.startswith("offset:") or not equals or value.lstrip("+-").replace(".", "").isdigit():
        return text
    for quantity in ("length", "pressure", "force", "angle"):
        with suppress(ValueError):
            return f"{head}={parse_quantity(value, quantity)!r}"
    raise UsageError(f'--wrong {text}: a length, pressure, force or angle is expected, as "12 mm", not "{value}"')


def _muscle(name: str, outputs: Iterable[OutputRecord]) -> str | dict[str, Any]:
    """A preset by name, or what a plant file says."""
    from pmabench.base.errors import UsageError, did_you_mean
    from pmabench.bench.plant import read_plant

    if not name.endswith(".yaml"):
        if name not in PRESETS:
            raise UsageError(f'--plant: no plant "{name}"{did_you_mean(name, PRESETS)}; a plant file ends in .yaml')
        return name
    plant = read_plant(Path(name))
    if wrong := list(plant.beyond(outputs)):
        raise UsageError("\n".join(f"--plant: {sentence}" for sentence in wrong))
    return {**plant.numbers, "file": name}


def _typed(ui: Ui, happenings: Faults, schedule: Schedule) -> None:
    """Carry out the lines that are typed."""
    import sys

    for line in sys.stdin:
        if not line.strip():
            continue
        try:
            schedule.add(happenings.of_line(line))
        except ValueError as error:
            ui.note(str(error))
