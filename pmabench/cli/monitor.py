"""`pmabench monitor`: every channel of a bench, live; --jog moves outputs by keys, as a run of kind `setup`."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import Interrupted, UsageError
from pmabench.cli.common import Ui, common, fields, recorded_options
from pmabench.cli.names import BENCH, SPECIMEN
from pmabench.cli.outcome import show_outcome

if TYPE_CHECKING:
    from pmabench.bench.compile import Mounted
    from pmabench.bench.interface import CompiledBench
    from pmabench.display.channel import Page
    from pmabench.session.guided import Jog, Series

PERIOD = 0.25
"""A picture at most so often [s]."""
NOTICES = 6
"""How many of the last things that were done are shown."""


@click.command(name="monitor")
@click.argument("bench", type=BENCH)
@click.option("--jog", is_flag=True, help="Move outputs by keys; needs --specimen, and is recorded.")
@click.option("--specimen", type=SPECIMEN, help="The specimen that is mounted; its limits hold with --jog.")
@recorded_options
@click.option("--plain", is_flag=True, help="A line a second; so it is where the output is no terminal.")
@click.option("--seconds", type=click.FloatRange(min=0), help="End by itself after so long.")
@common
def command(
    ui: Ui, bench: str, specimen: str | None, out: Path, operator: str, seconds: float | None, jog: bool, plain: bool
) -> int | None:
    """Show every channel of BENCH live: raw, value, noise, rate, age, limits. Arms nothing and commands nothing."""
    from pmabench.cli.prepare import mounted_of

    if jog:
        if specimen is None:
            raise UsageError("--jog moves the muscle: say which one is mounted, with --specimen")
        if plain or ui.json or not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise UsageError("--jog needs a terminal for its keys")
        return _jog(ui, mounted_of(bench, specimen), out, operator, seconds)
    _monitor(ui, mounted_of(bench, specimen).bench, seconds, plain=plain or not sys.stdout.isatty())
    return None


def _monitor(ui: Ui, bench: CompiledBench, seconds: float | None, *, plain: bool) -> None:
    from pmabench.display.channel import monitor_line
    from pmabench.session.guided import listen, looking

    with looking(bench) as look:
        end = time.monotonic() + seconds if seconds is not None else float("inf")
        live = _Live(bench, simulated=any(identity.simulated for identity in look.identities.values()))
        clock, period = look.acquisition.clock, 1.0 if plain or ui.json else PERIOD
        with _screen(ui, live.page, "q quits", wanted=not plain and not ui.json) as keys:
            while time.monotonic() < end and "q" not in keys.taken():
                began = time.monotonic()
                live.update(listen(look.acquisition, period), clock.now(), look.acquisition.rate)
                if ui.json:
                    ui.result(live.as_json(clock.now()), lambda: None)
                    return
                if plain:
                    click.echo(monitor_line(live.page, clock.now()))
                if not bench.realtime:
                    time.sleep(max(0.0, period - (time.monotonic() - began)))


def _jog(ui: Ui, mounted: Mounted, out: Path, operator: str, seconds: float | None) -> int:
    from pmabench.session.guided import BLOCK, jog, keys_of

    live = _Live(mounted.bench, simulated=False)
    live.page.title = f"jog: {mounted.bench.name}"
    end = time.monotonic() + seconds if seconds is not None else float("inf")
    notices: list[str] = []

    def shown(series: Mapping[str, Series], work: Jog, messages: Sequence[str]) -> None:
        live.page.simulated = work.executor.bench.simulated
        live.update(series, work.executor.clock.now(), work.executor.acquisition.rate)
        live.page.settings = f"{work.settings()}   step {work.steps()}"
        notices.extend(messages)
        live.page.notices = tuple(notices[-NOTICES:])
        if not mounted.bench.realtime:
            time.sleep(BLOCK)

    with _screen(ui, live.page, keys_of(mounted.bench), wanted=True) as keys:

        def pressed() -> Sequence[str]:
            taken = keys.taken()
            if "z" in taken:
                live.tare()
                notices.append("tared: values marked z are differences from now on")
            return taken if time.monotonic() < end else [*taken, "q"]

        outcome = jog(mounted, _AtKeys(live.page, keys), out, pressed, shown, operator_name=operator)
    show_outcome(ui, outcome)
    return outcome.exit_code


class _Live:
    """The page of a bench, brought up to date with blocks of samples."""

    def __init__(self, bench: CompiledBench, *, simulated: bool) -> None:
        from pmabench.display.channel import Channel, Page, Row

        self._scales = {channel.name: channel.scale for channel in bench.channels}
        self._last: dict[str, float] = {}
        rows = {}
        for record in bench.channels:
            channel = Channel(record.name, record.quantity, record.low, record.high)
            for trip in bench.trips:
                if trip.channel == record.name and trip.kind == "range":
                    channel.trip_low = trip.low if channel.trip_low is None else channel.trip_low
                    channel.trip_high = trip.high if channel.trip_high is None else channel.trip_high
            for output in bench.outputs:
                if output.name == record.name:
                    channel.command_low, channel.command_high = output.low, output.high
            rows[record.name] = Row(channel, raw_unit=record.raw_unit)
        self._rows = rows
        self.page: Page = Page(bench.name, simulated, rows)

    def update(self, series: Mapping[str, Series], now: float, rate: float) -> None:
        """Update the page with a block of samples."""
        for name, one in series.items():
            row, reading = self._rows[name], one.reading()
            row.channel.value, row.noise = reading.mean, reading.noise
            row.raw = float(self._scales[name].to_raw(reading.mean))
            spread = float(one.t[-1] - one.t[0])
            row.rate = (len(one.t) - 1) / spread if spread > 0 else rate
            self._last[name] = float(one.t[-1])
        for name, last in self._last.items():
            self._rows[name].channel.age = max(0.0, now - last)

    def tare(self) -> None:
        """Show differences from the present values from now on."""
        for row in self._rows.values():
            row.tare = row.channel.value or 0.0

    def as_json(self, t: float) -> dict[str, object]:
        """The documented object."""
        return {
            "schema": "pmabench.monitor/1",
            "bench": self.page.title,
            "simulated": self.page.simulated,
            "t": t,
            "channels": {
                name: fields(row.channel, "value", "quantity", "age") | fields(row, "raw", "raw_unit", "noise", "rate")
                for name, row in self._rows.items()
            },
        }


class _Keys(deque[str]):
    """Keys pressed since they were taken last; one thread adds (both ends of a deque are safe), another takes."""

    def taken(self) -> list[str]:
        """Keys pressed since the last call."""
        return [self.popleft() for _ in range(len(self))]


class _AtKeys:
    """An operator in front of the screen: questions are among the notices, the key y answers."""

    def __init__(self, page: Page, keys: _Keys) -> None:
        self._page, self._keys = page, keys

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """Nothing: the keys belong to the jog."""
        return ()

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Wait for y; q and v end the run."""
        before, self._page.notices = self._page.notices, (*wrap(text, 76), "y goes on, q ends")
        while True:
            wait()
            taken = [key.lower() for key in self._keys.taken()]
            if "q" in taken or "v" in taken:
                raise Interrupted("the operator, at the question", 130)
            if "y" in taken:
                self._page.notices = before
                return "y"


@contextmanager
def _screen(ui: Ui, page: Page, footer: str, *, wanted: bool) -> Iterator[_Keys]:
    """Draw the page four times a second and read keys, in a thread: a terminal that blocks holds nothing up."""
    keys = _Keys()
    if not wanted:
        yield keys
        return

    from pmabench.base import terminal
    from pmabench.display.channel import monitor_screen
    from pmabench.display.console import Painter

    ended = threading.Event()
    with ExitStack() as stack:
        painter = Painter(sys.stdout, color=ui.color)
        keyboard = None
        stack.enter_context(painter.open())
        with suppress(UsageError):
            keyboard = stack.enter_context(terminal.key_by_key(0))
        page.keys = footer if keyboard is not None else "Ctrl-C ends"

        def draw() -> None:
            with suppress(EOFError, OSError):
                while not ended.is_set():
                    size = painter.size()
                    painter.draw(monitor_screen(page, *size), size)
                    if keyboard is None:
                        ended.wait(PERIOD)
                        continue
                    keys.extend(keyboard.read(PERIOD))

        thread = threading.Thread(target=draw, name="pmabench-screen", daemon=True)
        thread.start()
        try:
            yield keys
        finally:
            ended.set()
            thread.join(2 * PERIOD)
