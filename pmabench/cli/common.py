"""What every command shares: output for people and for programs, and failures as sentences with exit codes."""

from __future__ import annotations

import codecs
import io
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from errno import EPIPE
from functools import reduce, wraps
from pathlib import Path
from textwrap import wrap
from threading import Timer
from typing import TYPE_CHECKING, Any, TextIO, cast

import click

from pmabench.base.errors import InvalidFile, PmaError, RecordError, UsageError
from pmabench.base.text import Spelled, in_ascii, raw, spelled
from pmabench.cli.names import BENCH, FOLDER, PROTOCOL, SPECIMEN

if TYPE_CHECKING:
    from rich.console import Console


@dataclass
class Ui:
    """Output of a command: results on stdout, everything else on stderr; quiet: results and errors only."""

    json: bool = False
    verbose: bool = False
    quiet: bool = False
    color: bool = True
    lost: OSError | None = None
    """Why the result did not reach stdout."""
    begun: bool = False
    """Whether the line of `begin` is there."""

    def begin(self, what: str) -> None:
        """On a terminal, a line with what takes long, until there is a result."""
        self.begun = not self.json and not self.quiet and sys.stderr.isatty()
        if self.begun:
            rewrite(f"{what} …")

    def end(self) -> None:
        """Take the line of `begin` away."""
        if self.begun:
            rewrite()
        self.begun = False

    def note(self, text: str) -> None:
        """A line for people, on stderr."""
        if not self.quiet:
            say(text)

    def result(self, data: Mapping[str, Any], human: Callable[[], None], brief: Iterable[str] | None = None) -> None:
        """The result: one JSON object, or what `human` prints, or with --quiet the lines of `brief`.

        A full disk or closed pipe behind stdout never ends the command; it has its own exit code at the end.
        """
        self.end()
        try:
            if self.json:
                from pmabench.store.folder import plain

                click.echo(json.dumps(plain(data), indent=1, sort_keys=True, allow_nan=False))
            elif self.quiet and brief is not None:
                click.echo("".join(f"{line}\n" for line in brief), nl=False)
            else:
                human()
            if sys.stdout is not None:
                sys.stdout.flush()
        except OSError as error:
            if error.filename is not None:
                raise
            self.lost = error

    def console(self, *, err: bool = False, columns: int = 100) -> Console:
        """A rich console; `columns` wide where there is no terminal."""
        from rich.console import Console
        from rich.segment import Segment

        class Plain(Console):
            """A console that leaves a closed pipe to the command, and spells control characters."""

            def on_broken_pipe(self) -> None:
                raise BrokenPipeError(EPIPE, os.strerror(EPIPE))

            def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
                for text, style, control in super().render(*args, **kwargs):
                    yield Segment(text if control else spelled(text), style, control)

        stream = sys.stderr if err else sys.stdout
        width = None if stream.isatty() or "COLUMNS" in os.environ else columns
        file = raw(stream)  # the console's colours go there as they are
        return Plain(file=file, no_color=not self.color, width=width, highlight=False, markup=False, emoji=False)


def common(function: Callable[..., int | None]) -> Callable[..., None]:
    """The options of every command, and failures as sentences; the command returns its exit code or None."""

    @click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
    @click.option("-v", "--verbose", is_flag=True, help="Say more.")
    @click.option("-q", "--quiet", is_flag=True, help="Results and errors only.")
    @click.option("--no-color", is_flag=True, help="Plain text; also with NO_COLOR set.")
    @wraps(function)
    def command(*args: Any, as_json: bool, verbose: bool, quiet: bool, no_color: bool, **kwargs: Any) -> None:
        ui = Ui(as_json, verbose, quiet, not no_color and "NO_COLOR" not in os.environ)
        try:
            if as_json and kwargs.get("as_csv"):
                raise UsageError("--csv or --json, not both")
            try:
                code = function(ui, *args, **kwargs)
            finally:
                ui.end()
        except PmaError as error:
            _explain(ui, error)
            code = error.exit_code
        except OSError as error:
            name = os.fsdecode(error.filename) if isinstance(error.filename, bytes) else error.filename
            where = "a file, a device or another program" if name is None else name
            say(f"{where}: cannot be read or written: {error.strerror or error}")
            code = NOT_WRITTEN
        except KeyboardInterrupt:
            say("interrupted")
            code = 130
        if ui.lost is not None:
            lost = output_lost(ui.lost)
            code = code or lost
        sys.exit(code or 0)

    return command


class Group(click.Group):
    """Commands below one name; the first sentence of each is shown in full."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Print the table of commands; click itself would cut each sentence at the end of its line."""
        with formatter.section("Commands"):
            commands = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
            formatter.write_dl([(name, one.get_short_help_str(300)) for name, one in commands if one is not None])


def labelled(label: str, text: str, width: int) -> str:
    """A line with a label, and further lines of the same text below its beginning; words are never broken."""
    head = f"  {label:<10}"
    lines = wrap(text, width, initial_indent=head, subsequent_indent=" " * len(head), break_long_words=False)
    return "\n".join(lines) or head.rstrip()


def prepare_streams() -> None:
    """Streams that take any text: closed ones lead nowhere, signs that a terminal lacks or would obey are spelled."""
    codecs.register_error("in-ascii", in_ascii)
    sys.stdout, sys.stderr = _prepared(sys.stdout), _prepared(sys.stderr)


def _prepared(stream: TextIO | None) -> TextIO:
    if stream is None:
        stream = Path(os.devnull).open("w")  # noqa: SIM115
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="in-ascii")
    return stream if isinstance(stream, Spelled) else cast("TextIO", Spelled(stream))


UNREAD = 10.0
"""How long the end of a run waits to be read [s]."""


@contextmanager
def read_or_not(code: int) -> Iterator[None]:
    """Print what is said inside; where nobody takes it for `UNREAD` [s], end the program with this exit code.

    A terminal that is stopped, or a pipe that is full, would keep a program whose run is over and recorded.
    """
    waits = Timer(UNREAD, os._exit, (code,))
    waits.daemon = True
    waits.start()
    try:
        yield
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
    finally:
        waits.cancel()


def rewrite(text: str = "") -> None:
    """Replace the line of progress on stderr, if any, by `text` there."""
    with suppress(OSError):
        stream = raw(sys.stderr)
        stream.write("\r\x1b[2K" + spelled(text))
        stream.flush()


def say(text: str) -> None:
    """A line on stderr; nothing fails where nobody reads it."""
    with suppress(OSError):
        click.echo(text, err=True)


NOT_WRITTEN = RecordError.exit_code


def output_lost(error: OSError) -> int:
    """The exit code where stdout took no more: a closed pipe is no failure, anything else is reported."""
    for stream in (sys.stdout, sys.stderr):  # what is left in them would fail again at the end of the program
        with suppress(OSError, ValueError, AttributeError):
            if stream is sys.stdout or error.errno == EPIPE:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if error.errno == EPIPE:
        return 0
    say(f"the output could not be written: {error.strerror or error}; give it a place that takes it")
    return NOT_WRITTEN


def _explain(ui: Ui, error: PmaError) -> None:
    if ui.json:
        data: dict[str, Any] = {"schema": "pmabench.error/1", "error": str(error), "exit_code": error.exit_code}
        if isinstance(error, InvalidFile):
            data["problems"] = [vars(problem) for problem in error.problems]
        ui.result(data, lambda: None)
        return
    say(str(error))
    if isinstance(error, InvalidFile) and len(error.problems) > 1:
        say(f"{len(error.problems)} problems")


def plan_options(*, required: bool = True) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """What a plan is made of: PROTOCOL, `--bench`, `--specimen`, `--set`."""

    def split(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> list[tuple[str, str]]:
        for value in values:
            if value.find("=") < 1:
                raise click.BadParameter(f'"{value}" is not name=value, for instance sweep.repeat.count=1')
        return [(name, text) for name, _, text in (value.partition("=") for value in values)]

    return with_options(
        click.option(
            "--set",
            "settings",
            multiple=True,
            callback=split,
            metavar="NAME=VALUE",
            help="Change a value of the protocol: sweep.repeat.count=1.",
        ),
        click.option(
            "--specimen", type=SPECIMEN, required=required, help="Specimen file, or the name of a shipped one."
        ),
        click.option("--bench", type=BENCH, required=required, help="Bench file, or the name of a shipped one."),
        click.argument("protocol", type=PROTOCOL, required=required),
    )


def with_options(*options: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that adds these options, the last of them first in the help."""
    return lambda function: reduce(lambda made, option: option(made), options, function)


recorded_options = with_options(
    click.option("--operator", default="", help="Who is at the bench; the login name if not given."),
    click.option("--out", default="runs", show_default=True, type=FOLDER, help="Where run folders go."),
)
"""Options of what is recorded as a run: `out`, `operator`."""


def session_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of the session before a run; passed on as one argument `session`."""

    @click.option("--new-session", is_flag=True, help="Warm-up, self-test and zeros again, though a session counts.")
    @click.option("--skip-warm-up", is_flag=True, help="Leave the warm-up of the session out; with --because.")
    @click.option("--because", default="", help="Why the warm-up is left out; the record says so.")
    @wraps(function)
    def command(*args: Any, new_session: bool, skip_warm_up: bool, because: str, **kwargs: Any) -> Any:
        if skip_warm_up != bool(because.strip()):
            raise click.UsageError("--skip-warm-up and --because TEXT belong together")
        return function(*args, session={"anew": new_session, "skip_warm_up": because.strip()}, **kwargs)

    return command


def read_quantity(option: str, text: str, quantity: str) -> float:
    """The value [SI] of what was typed with its unit; UsageError that names the option."""
    from pmabench.files.quantity import parse_quantity

    try:
        return parse_quantity(text.strip(), quantity)
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from error


class Problems(list[str]):
    """What is wrong with what was typed, a line each, to be refused together."""

    @contextmanager
    def of(self, option: str) -> Iterator[None]:
        """A ValueError inside is wrong with this option, in as many lines as it has."""
        try:
            yield
        except ValueError as error:
            self.extend(f"{option}: {line}" for line in str(error).splitlines() or [""])

    def refuse(self) -> None:
        """Raise UsageError with every line, where there is one."""
        if self:
            raise UsageError("\n".join(self))


def no_overwriting(path: Path | None) -> None:
    """UsageError for the name of a file that is there."""
    if path is not None and path.exists():
        raise UsageError(f"{path} is there already; give the name of a new file")


def no_pipes(*paths: Path | None) -> None:
    """UsageError for a name of an output that is that of a pipe."""
    for path in paths:
        if path is not None and path.is_fifo():
            raise UsageError(f"{path} is a pipe; give the name of a file")


def fields(thing: object, *names: str) -> dict[str, Any]:
    """These attributes by name, for JSON."""
    return {name: getattr(thing, name) for name in names}
