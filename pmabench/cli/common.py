"""What every command shares: output for people and for programs, and failures as sentences with exit codes."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, PmaError

if TYPE_CHECKING:
    from rich.console import Console


@dataclass
class Ui:
    """Where a command prints: results on stdout, everything else on stderr."""

    json: bool = False
    verbose: bool = False
    quiet: bool = False
    color: bool = True

    def note(self, text: str) -> None:
        """A line for people, on stderr."""
        if not self.quiet:
            click.echo(text, err=True)

    def detail(self, text: str) -> None:
        """A line for people who asked for more."""
        if self.verbose:
            click.echo(text, err=True)

    def result(self, data: Mapping[str, Any], human: Callable[[], None]) -> None:
        """The result: as one JSON object, or as `human` prints it."""
        if self.json:
            click.echo(json.dumps(data, indent=1, sort_keys=True, allow_nan=False, default=str))
        else:
            human()

    def console(self, *, err: bool = False, columns: int = 100) -> Console:
        """A rich console; `columns` wide where there is no terminal."""
        from rich.console import Console

        stream = sys.stderr if err else sys.stdout
        width = None if stream.isatty() or "COLUMNS" in os.environ else columns
        return Console(stderr=err, no_color=not self.color, width=width, highlight=False, markup=False, emoji=False)


def common(function: Callable[..., int | None]) -> Callable[..., None]:
    """The options of every command, and failures as sentences; the command returns its exit code or None."""

    @click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
    @click.option("-v", "--verbose", is_flag=True, help="Say more.")
    @click.option("-q", "--quiet", is_flag=True, help="Say only what is needed.")
    @click.option("--no-color", is_flag=True, help="Plain text; also with NO_COLOR set.")
    @wraps(function)
    def command(*args: Any, as_json: bool, verbose: bool, quiet: bool, no_color: bool, **kwargs: Any) -> None:
        ui = Ui(as_json, verbose, quiet, not no_color and "NO_COLOR" not in os.environ)
        try:
            code = function(ui, *args, **kwargs)
        except PmaError as error:
            _explain(ui, error)
            code = error.exit_code
        except KeyboardInterrupt:
            click.echo("interrupted", err=True)
            code = 130
        sys.exit(code or 0)

    return command


def _explain(ui: Ui, error: PmaError) -> None:
    if ui.json:
        data: dict[str, Any] = {"schema": "pmabench.error/1", "error": str(error), "exit_code": error.exit_code}
        if isinstance(error, InvalidFile):
            data["problems"] = [vars(problem) for problem in error.problems]
        click.echo(json.dumps(data, indent=1, sort_keys=True))
        return
    click.echo(str(error), err=True)
    if isinstance(error, InvalidFile) and len(error.problems) > 1:
        click.echo(f"{len(error.problems)} problems", err=True)


def plan_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """What a plan is made of: PROTOCOL, `--bench`, `--specimen`, `--set`."""

    def split(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> list[tuple[str, str]]:
        pairs = []
        for value in values:
            name, equals, text = value.partition("=")
            if not equals or not name:
                raise click.BadParameter(f'"{value}" is not name=value, for instance sweep.repeat.count=1')
            pairs.append((name, text))
        return pairs

    for option in (
        click.option("--set", "settings", multiple=True, callback=split, metavar="NAME=VALUE", help="Change a value."),
        click.option("--specimen", required=True, help="Specimen file, or the name of a shipped one."),
        click.option("--bench", required=True, help="Bench file, or the name of a shipped one."),
        click.argument("protocol"),
    ):
        function = option(function)
    return function
