"""Entry point: the table of commands; `--help` is printed from it without importing any of them."""

from __future__ import annotations

import atexit
import gc
import os
import re
import sys
from importlib import import_module
from typing import Any

import click

from pmabench import __version__
from pmabench.base.errors import did_you_mean
from pmabench.base.system import keep_freed_memory
from pmabench.cli.common import output_lost, prepare_streams
from pmabench.cli.names import typed_lines

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    # small matrices: threads cost time, and sums in another order change last digits
    os.environ.setdefault(_threads, "1")
# Arrow in the memory of the C library: what it frees holds the next arrays, and no new pages are cleared for them
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")

SECTIONS = {
    "Start": {
        "demo": ("campaign:demo", "Characterise a simulated muscle from protocol to report.", "--out demo-run"),
        "init": ("init", "Ask what a lab has, and write its folder: bench, specimen, protocol.", "our-lab"),
        "check": ("check", "Check protocol, bench and specimen; show the plan; move nothing.",
                 "contraction-relaxation --bench mock --specimen mas-20-250-paper0 --simulate"),
        "emulate": ("emulate", "Serve the devices of a bench with a simulated muscle behind them.", "wires"),
    },
    "At the bench": {
        "monitor": ("monitor", "Every channel of a bench, live; --jog moves outputs by keys.", "our-lab/bench.yaml"),
        "calibrate": ("calibrate", "Calibrate a channel or the regulator by reference points, guided.",
                 'force --bench bench.yaml --specimen specimen.yaml --reference "weights no. 12" '
                 '--reference-uncertainty "0.1 N" --points "0 N, 58.86 N, 107.91 N"'),
        "run": ("run", "Execute a protocol on a bench and record it in a run folder.",
                 "contraction-relaxation --bench mock --specimen mas-20-250-paper0 --yes"),
        "next": ("until", "Which trials to do next for narrower intervals, as a protocol file.",
                 'runs/2026... --until "K 1 %, B_r 2 %" --time "40 min" -o next.yaml'),
        "continue": ("run:continue_", "How the last run ended; reset the bench, do the trials that are left.", ""),
        "watch": ("watch", "Watch a run while it goes on; only reads its folder.", ""),
        "vent": ("vent", "The safe state now; --reset clears a latch.", "bench.yaml"),
        "note": ("runs:note", "Append a note, a file or an exclusion to a recorded run.",
                 'runs/2026... "room was cold"'),
        "campaign": ("campaign", "Run several protocols on one specimen, in order.", "real-muscle --yes"),
    },
    "Results": {
        "process": ("process", "Fit the coefficients of one or more runs, with their uncertainty.", "runs/2026..."),
        "report": ("report", "Write the characterisation report as one HTML file.", "runs/2026... -o report.html"),
        "compare": ("compare", "Two analyses, methods or benches, coefficient by coefficient.",
                 "analyses/A analyses/B"),
        "history": ("history", "One specimen over its life: coefficients, cycles, time at pressure.",
                 "SERIAL -o history.html"),
        "tune": ("tune", "Controller settings from an ultimate gain and period.", '--ku "7.1 bar/cm" --tu "9 s"'),
        "export": ("export", "Runs or coefficients as CSV, Parquet, MATLAB, LaTeX, JSON, models.",
                 "runs/2026... --format csv -o samples"),
        "publish": ("export:publish", "Records, coefficients and report for a repository of research data.",
                 'runs/2026... -o ours.zip --author "Doe, Jane" --licence CC-BY-4.0 --publisher Zenodo'),
    },
    "Records": {
        "import": ("import_", "Make runs of files of other programs, by a column map.", "old.csv --guess"),
        "recalibrate": ("recalibrate", "The same raw samples with other calibrations, and what changes.",
                 "runs/2026... --calibration P-0300.yaml"),
        "runs": ("runs", "List, show and verify recorded runs.", "list"),
        "list": ("files:list_", "Benches, protocols, specimens and other files by name.", "benches"),
    },
    "Behind it": {
        "bench": ("bench", "A bench's card to hang at the rig; probe, read and set its devices.",
                 "card bench.yaml -o card.html"),
        "drivers": ("drivers", "Drivers that are installed; try one against its emulator.", "list"),
        "model": ("model", "Models: list, show, evaluate, simulate, fit, cascade.",
                 'eval tondu-lopez --set "pressure=300 kPa"'),
        "schema": ("files:schema", "Print the JSON Schema of a kind of file.", "bench"),
    },
}  # fmt: skip
"""Section of `--help` -> command -> its module in this package (with `:name` where not `command`), its line there, and
what somebody types after it, which is the end of its own `--help`."""
COMMANDS = {name: entry for section in SECTIONS.values() for name, entry in section.items()}
MOST = 74
"""Columns of a line of an example, so that with its indent it fits 80."""


class Commands(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the table, in its order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command."""
        if cmd_name not in COMMANDS:
            return None
        keep_freed_memory()
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(import_module(f"pmabench.cli.{module}"), name or "command")
        first, *rest = re.split(r" (?=-)", f"pmabench {cmd_name} {COMMANDS[cmd_name][2]}".rstrip())
        example = "\n".join(f"  {line}" for line in typed_lines(first, rest, MOST, 4))
        command.epilog = command.epilog or f"\b\nExample:\n{example}"
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Print the table of commands."""
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(name, line) for name, (_, line, _) in commands.items()])

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run a command; a full disk or closed pipe behind the output ends it with a sentence."""
        prepare_streams()
        gc.set_threshold(50_000, 20, 50)  # most of a command's objects go by their count; a twentieth of its time
        atexit.register(gc.freeze)  # nor are cycles sought in what goes with the process
        try:
            return super().main(*args, **kwargs)
        except OSError as error:
            sys.exit(output_lost(error))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """A wrong name gets the nearest right one."""
        if args and args[0] not in COMMANDS:
            ctx.fail(f'no command "{args[0]}"{did_you_mean(args[0], COMMANDS)}')
        return super().resolve_command(ctx, args)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pmabench")
def main() -> None:
    """Test benches for pneumatic muscle actuators: run protocols, reprocess old runs, write reports.

    Exit codes: 0 done and accepted, 1 error in the program, 2 wrong usage, 3 a file is invalid, 4 device or
    communication, 5 limit tripped or vent not confirmed, 6 done but a verdict failed, 7 record not written,
    130 interrupted by the operator, 143 by SIGTERM.

    Completion by Tab in bash: eval "$(_PMABENCH_COMPLETE=bash_source pmabench)"; zsh_source, fish_source alike.
    """
