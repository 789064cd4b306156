"""`pmabench watch`: what a run is doing now, from its folder alone; nothing of the bench is touched.

In a browser `watch --web` serves it, and `run --web` starts that as a process that only reads.
"""

from __future__ import annotations

import ipaddress
import json
import os
import secrets
import select
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import Interrupted, UsageError, invalid
from pmabench.base.system import ordinary
from pmabench.cli.common import Ui, common, fields, output_lost
from pmabench.cli.names import RunFolder
from pmabench.guard.station import root as state_folder

if TYPE_CHECKING:
    from pmabench.display.state import RunState
    from pmabench.display.web.server import Server


AFTER_SESSION = 10.0
"""How long after the end of a session its test is waited for [s]."""


@click.command(name="watch")
@click.argument("run", default="runs", type=RunFolder())
@click.option("--plain", is_flag=True, help="One line per event and trial; so it is where the output is no terminal.")
@click.option("--wait", is_flag=True, help="Wait for a run that is not there yet.")
@click.option("--web", is_flag=True, help="In a browser, until Ctrl-C: prints the address to open.")
@click.option("--listen", metavar="ADDRESS", help="With --web: also for others, at this address of this computer.")
@click.option("--vent", is_flag=True, help="With --web: a vent button, where the bench file has `web_vent: true`.")
@common
def command(ui: Ui, run: Path, listen: str | None, *, plain: bool, wait: bool, web: bool, vent: bool) -> int | None:
    """Watch RUN, or the newest run of a folder of runs, until it ends; q leaves the run alone.

    Of a folder, also what is newer when that run has ended, and the test that follows a session.

    For instance: pmabench watch --web
    """
    if web:
        return serve(ui, run, listen, vent=vent)
    if listen or vent:
        raise UsageError("--listen and --vent belong to --web")
    folder = _find(ui, run, wait=wait)
    from pmabench.display.console import watch
    from pmabench.display.lines import last_line

    try:
        state = watch(folder, plain=plain, color=ui.color, quiet=ui.json or ui.quiet)
        while state.ended and (newest := _newer(ui, run, state)) != folder:
            folder = newest
            state = watch(folder, plain=plain, color=ui.color, quiet=ui.json or ui.quiet)
        if ui.json or ui.quiet:
            ui.result(_json(state.files.folder, state), lambda: click.echo(last_line(state)))
    except BrokenPipeError as error:
        return output_lost(error)
    return None


def _find(ui: Ui, place: Path, *, wait: bool) -> Path:
    """The run folder that is meant; raises InvalidFile where there is none."""
    from pmabench.store.folder import newest_run

    noted = False
    while True:
        if (place / "manifest.json").exists():
            return place
        if (newest := newest_run(place)) is not None:
            return newest
        if not wait:
            why = "holds no run" if place.is_dir() else "there is no such run"
            raise invalid(place, f"{why}; `pmabench runs list` shows those that are there, --wait waits for one")
        if not noted:
            ui.note(f"no run in {place} yet; waiting for it, Ctrl-C ends")
            noted = True
        time.sleep(0.25)


def _newer(ui: Ui, place: Path, state: RunState) -> Path:
    """The newest run when one has ended, which may be that one; after a session its test is waited for."""
    from pmabench.store.folder import SEAL

    folder, until = state.files.folder, 0.0
    if state.kind == "session" and state.status == "finished" and folder != place:
        until = (folder / SEAL).stat().st_mtime + AFTER_SESSION
    while (newest := _find(ui, place, wait=False)) == folder and time.time() < until:
        time.sleep(0.25)
    return newest


def _json(folder: Path, state: RunState) -> dict[str, Any]:
    """The documented object: the state of the run or how it ended, and each trial's line."""
    return {
        "schema": "pmabench.watch/1",
        "run": str(folder),
        **fields(state, "status", "why", "vent", "simulated", "rows"),
        "flagged": dict(state.counts),
        "trials_planned": state.trials,
        "trials": [
            fields(line, "point", "repeat", "status", "doubts")
            | {"trial": line.number, "numbers": [vars(number) for number in line.numbers]}
            for line in state.lines
        ],
    }


PORT = 8437
"""The port that is taken where it is free, so that a page finds its server again."""
TOKEN_HOURS = 12
"""A token is the same for so long, so that a page goes on after a restart of the server."""
STARTS_WITHIN = 5.0
"""A run waits so long for the address of its view [s], before anything is moved."""
LEFT = 30.0
"""A view that a run has started ends so long after the run, and after the last browser has left [s]."""
RISK = (
    "everybody in this network who has the address can read the runs in this folder, and the address is not encrypted; "
    "nobody can command anything. Ctrl-C ends it."
)

BUTTON = "the vent button is no emergency stop; it is there where the bench file has `web_vent: true`"


def serve(ui: Ui, run: Path, listen: str | None, *, vent: bool) -> int:
    """Serve the view of RUN, or of a folder of runs, until a signal ends it."""
    address = _address(listen)
    if vent and not ipaddress.ip_address(address).is_loopback:
        raise UsageError("--vent is for this computer only; leave out --listen")
    one = (run / "manifest.json").exists()
    folder = run.resolve().parent if one else run
    server = _start(folder, address, vent=vent)
    path = f"/run/{run.resolve().name}" if one else "/"
    _until_ended(server, lambda: _say(ui, server, path, vent=vent))
    return 0


def _say(ui: Ui, server: Server, path: str, *, vent: bool) -> None:
    """Where to look, and the risk."""
    link, folder = server.link(path), server.room.places.root
    data = {"schema": "pmabench.web/1", "address": link, "folder": str(folder), "pid": os.getpid()}
    if ui.json:
        click.echo(json.dumps(data))
    else:
        click.echo(link)
        ui.note(f"shows the runs in {folder}; reads only. Ctrl-C ends it")
        if not server.local:
            ui.note(f"risk: {RISK}")
        if vent:
            ui.note(BUTTON)
    sys.stdout.flush()


def _address(listen: str | None) -> str:
    """The address to listen at; raises UsageError where it is not one of a computer."""
    if listen is None:
        return "127.0.0.1"
    try:
        address = ipaddress.ip_address(listen)
    except ValueError:
        what = "--listen needs an address of this computer in numbers, as 192.168.1.20"
        raise UsageError(f'{what}; not "{listen}"') from None
    if address.is_unspecified or address.is_multicast:
        raise UsageError(f"--listen {listen} is every network; name the address of the one that the phone is in")
    return str(address)


def _start(folder: Path, address: str, *, vent: bool) -> Server:
    """The server, at the usual port where it is free; below the priority of every bench."""
    ordinary()
    if hasattr(os, "nice"):
        with suppress(OSError):
            os.nice(10)
    from pmabench.display.web.server import start

    try:
        return start(folder, token(), address, (PORT, 0), vent=vent)
    except OSError as error:
        why = error.strerror or error
        raise UsageError(f"cannot listen at {address}: {why}; is it an address of this computer?") from error


def token() -> str:
    """128 random bits, kept for hours in a file that only this user can read."""
    path = state_folder() / "web-token"
    with suppress(OSError, ValueError):
        kept = path.read_text("ascii").strip()
        if len(kept) >= 22 and 0 <= time.time() - path.stat().st_mtime < TOKEN_HOURS * 3600:
            return kept
    fresh = secrets.token_urlsafe(16)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.unlink(missing_ok=True)
        path.touch(0o600, exist_ok=False)
        path.write_text(fresh, "ascii")
    return fresh


def _until_ended(server: Server, begin: Callable[[], None]) -> None:
    """`begin`, then until a signal; where a run has started this, until the run has ended and nobody looks any more."""
    from pmabench.display.console import Terminate, tidy_signals

    parent = os.getppid() if os.environ.get("PMABENCH_WEB_OF_RUN") else 0
    alone_since = time.monotonic()
    try:
        with tidy_signals(child=False):
            begin()
            while True:
                time.sleep(0.5)
                if server.room.viewers or (parent and os.getppid() == parent):
                    alone_since = time.monotonic()
                if parent and time.monotonic() - alone_since > LEFT:
                    return
    except Terminate as end:
        raise Interrupted(str(end), 128 + end.number) from None
    finally:
        server.stop()


def start_view(ui: Ui, out: Path, *, vent: bool = False) -> None:
    """Start the view of a run that is about to begin, and say its address; without one the run goes on all the same."""
    options = ["--web", *(["--vent"] if vent else []), "--json"]
    command = [sys.executable, "-P", "-m", "pmabench", "watch", *options, str(out)]
    quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    try:
        environment = {**os.environ, "PMABENCH_WEB_OF_RUN": "1"}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, **quiet)
        said = b""
        if process.stdout is not None and select.select([process.stdout], [], [], STARTS_WITHIN)[0]:
            said = os.read(process.stdout.fileno(), 10_000)
        link = json.loads(said)["address"]
    except (OSError, ValueError, KeyError):
        ui.note("the view in a browser did not start; the run goes on without it")
        return
    ui.note(f"in a browser: {link}")
    if vent:
        ui.note(BUTTON)
