"""Entry point: the table of commands; `--help` is printed from it without importing any of them."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

import click

from pmabench import __version__
from pmabench.cli.common import output_lost, prepare_streams

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(
        _threads, "1"
    )  # small matrices: threads cost time, and sums in another order change last digits

COMMANDS = {
    "demo": ("demo", "Characterise a simulated muscle from protocol to report."),
    "init": ("init", "Write a lab folder to begin with: bench, specimen, protocol, README."),
    "check": ("check", "Check protocol, bench and specimen; show the plan. Nothing touches a device."),
    "run": ("run", "Execute a protocol on a bench and record it in a run folder."),
    "watch": ("watch", "Watch a run while it goes on; only reads its folder."),
    "emulate": ("emulate", "Serve a bench's Modbus and serial devices with a simulated muscle behind them."),
    "campaign": ("campaign", "Run several protocols on one specimen, in order."),
    "vent": ("vent", "The safe state now, whatever the owner of the bench does; --reset clears a latch."),
    "monitor": ("monitor", "Every channel of a bench, live; --jog moves outputs by keys within the set-up pressure."),
    "devices": ("devices", "Drivers that are installed; what the devices of a bench answer; the self-test of a bench."),
    "calibrate": ("calibrate", "Calibrate a channel or the regulator by reference points, guided; a new file."),
    "import": ("import_", "Make runs of files that other programs recorded, by a column map."),
    "process": ("process", "Fit the coefficients of one or more runs, with their uncertainty."),
    "recalibrate": ("recalibrate", "The same raw samples with other calibrations; what changes in each coefficient."),
    "report": ("report", "Write the characterisation report as one HTML file."),
    "export": ("export", "Runs or coefficients as CSV, Parquet, MATLAB, LaTeX, JSON or a python-control model."),
    "compare": ("compare", "Two analyses, methods or benches, coefficient by coefficient, with E_n numbers."),
    "history": ("history", "One specimen over its life: coefficients, cycles and time at pressure."),
    "tune": ("tune", "Controller settings from an ultimate gain and period."),
    "model": ("model", "Models of muscles, regulators, loads and compositions: list, show, evaluate, simulate, fit."),
    "cascade": ("cascade", "Muscles end to end with pressures of their own: simulate, draw, play again."),
    "bench": ("bench", "Write the card of a bench: one page to hang at the rig."),
    "runs": ("runs", "List, show and verify recorded runs."),
    "note": ("note", "Append a note, a file or an exclusion to a recorded run."),
    "schema": ("schema", "Print the JSON Schema of a kind of file."),
}
"""Command -> its module in this package and the line that `--help` shows."""


class Commands(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the table, in its order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"pmabench.cli.{COMMANDS[cmd_name][0]}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Print the table of commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run a command; a full disk or closed pipe behind the output ends it with a sentence."""
        prepare_streams()
        try:
            return super().main(*args, **kwargs)
        except OSError as error:
            sys.exit(output_lost(error))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """A wrong name gets the nearest right one."""
        if args and args[0] not in COMMANDS:
            from pmabench.base.errors import did_you_mean

            ctx.fail(f'no command "{args[0]}"{did_you_mean(args[0], COMMANDS)}')
        return super().resolve_command(ctx, args)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pmabench")
def main() -> None:
    """Test benches for pneumatic muscle actuators: run protocols, reprocess old runs, write reports.

    Exit codes: 0 done and accepted, 1 error in the program, 2 wrong usage, 3 a file is invalid, 4 device or
    communication, 5 limit tripped or vent not confirmed, 6 done but a verdict failed, 7 record not written,
    130 interrupted by the operator, 143 by SIGTERM.
    """
