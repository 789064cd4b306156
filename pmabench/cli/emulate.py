"""`pmabench emulate`: the simulated muscle behind the wires of a bench, for practice and tests; knows no driver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pmabench.cli.common import Ui, common


@click.command(name="emulate")
@click.argument("bench")
@click.option("--plant", type=click.Choice(["paper0", "serres2009"]), default="paper0", help="The muscle.")
@click.option(
    "--preset", type=click.Choice(["bench", "ideal"]), default="bench", help="bench: lag, friction, noise; or ideal."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the noise.")
@click.option("--log", type=click.Path(dir_okay=False, path_type=Path), help="Append what is commanded, as JSON lines.")
@click.option("--control", type=click.IntRange(0, 65535), default=0, help="Port for loads and faults; 0: a free one.")
@common
def command(ui: Ui, bench: str, plant: str, preset: str, seed: int, log: Path | None, control: int) -> int | None:
    """Serve the devices of BENCH whose drivers have an emulator on this machine, in real time, until Ctrl-C.

    Devices stand at the addresses of the bench file: Modbus TCP on 127.0.0.1, serial ports as links to
    pseudo-terminals. Nothing else is reached. The operator's hands are the lines typed here: "load 6 kg", "load
    58.86 N", "load 0 kg"; the load is all that hangs on the free end.
    """
    import signal
    import threading
    from importlib.metadata import entry_points

    from pmabench.base.errors import UsageError
    from pmabench.bench.compile import mount_alone
    from pmabench.files.shipped import find_file

    mounted = mount_alone(find_file("bench", bench))
    found = entry_points(group="pmabench.emulators")
    if not found:
        raise UsageError("no emulator is installed")
    served: Any = next(iter(found)).load()(
        mounted.bench.devices, plant=plant, preset=preset, seed=seed, log=log, control=control
    )
    ended = threading.Event()
    try:
        signal.signal(signal.SIGTERM, lambda *_: ended.set())
        ui.result(
            {
                "schema": "pmabench.emulate/1",
                "devices": {name: device.address for name, device in served.devices.items()},
                "control": served.control.address,
            },
            lambda: click.echo("\n".join([*served.lines(), f"control: {served.control.address}"])),
        )
        ui.note("serving until Ctrl-C")
        gravity, carriage = mounted.bench.gravity, mounted.bench.carriage
        threading.Thread(target=_hands, args=(ui, served, gravity, carriage), daemon=True).start()
        ended.wait()
    except KeyboardInterrupt:
        pass
    finally:
        served.close()
    return None


def _hands(ui: Ui, served: Any, gravity: float, carriage: float) -> None:
    """Carry out the lines that are typed."""
    import sys

    from pmabench.files.quantity import parse_mass_or_force

    for line in sys.stdin:
        word, _, value = line.strip().partition(" ")
        if not word:
            continue
        try:
            if word != "load":
                raise ValueError(f'"{word}" is not known here; type for instance "load 6 kg"')
            kind, number = parse_mass_or_force(value)
            if not number >= 0:
                raise ValueError(f'"{value}" is less than nothing')
        except ValueError as error:
            ui.note(str(error))
            continue
        force, mass = (number * gravity, number) if kind == "mass" else (number, number / gravity)
        served.plant.load(force, mass + carriage)
        ui.note(f"the free end carries {force:g} N")
