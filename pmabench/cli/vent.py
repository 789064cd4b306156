"""`pmabench vent`: the safe state now, from any terminal, no questions; imports little, because it must be fast."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from pmabench.base.errors import DeviceError, LimitRefused, PmaError, UsageError, did_you_mean
from pmabench.base.system import try_lock, user_name
from pmabench.cli.common import Ui, common
from pmabench.cli.names import BENCH
from pmabench.files.shipped import find_file
from pmabench.guard.station import Station, folder_name, root, stations
from pmabench.guard.wire import Messages, encode, keys

ANSWERS_WITHIN = 0.1
"""A guard that does not answer for so long [s] is gone round."""
ENDS_WITHIN = 2.0
"""Longest wait for the end of the vented run before a reset is refused [s]."""
CONFIRMS_WITHIN = 70.0
"""Longest time that the outcome is waited for [s]: a bench file allows 60 s to confirm a vent."""


@dataclass(frozen=True)
class Vented:
    """What came of one bench."""

    bench: str
    way: str
    result: str
    actions: tuple[str, ...]
    commanded_in: float
    """Time from the key to the command, the start of Python not counted [s]."""


@click.command(name="vent")
@click.argument("bench", type=BENCH, required=False)
@click.option("--reset", is_flag=True, help="Clear the latch of a tripped bench after a confirmed vent.")
@click.option("--operator", default="", help="Who resets it; with --reset.")
@click.option("--because", default="", help="Why it may be used again; with --reset.")
@common
def command(ui: Ui, bench: str | None, operator: str, because: str, *, reset: bool) -> int:
    """Drive BENCH to its safe state now, whatever its owner does; without BENCH, every bench that is in use."""
    began = time.monotonic()
    if reset and not (operator.strip() and because.strip()):
        raise UsageError("a reset is recorded: say who and why, with --operator NAME --because TEXT")
    if reset and bench is None:
        raise UsageError("say which bench is to be reset")
    found = list(_find(bench))
    if reset and len(found) > 1:
        names = ", ".join(f'"{saved["name"]}"' for _, saved in found)
        raise UsageError(f'several benches are called "{bench}": {names}; name the one that is to be reset')
    vented = _all_at_once(ui, found, began)
    worst = 0 if all(item.result == "confirmed" for item in vented) else 5
    tripped = ""
    if reset and worst == 0:
        for station, saved in found:
            tripped = _reset(station, saved, operator.strip(), because.strip())
    after = "reset: the bench may be used again" if tripped else "it was not tripped: the bench may be used"
    ui.result(
        {
            "schema": "pmabench.vent/1",
            "benches": [{**vars(item), "actions": list(item.actions)} for item in vented],
            "reset": reset and worst == 0,
            "exit_code": worst,
        },
        lambda: _print(vented, after if reset and worst == 0 else ""),
    )
    return worst


def _find(bench: str | None) -> Iterator[tuple[Station, dict[str, Any]]]:
    """The benches that are meant, each with its compiled bench as it was armed last (empty: never)."""
    known = [(station, station.read("bench")) for station in stations()]
    if bench is None:
        used = [(s, saved) for s, saved in known if s.read("guard") or s.latched()]
        if not used:
            names = ", ".join(f'"{saved["name"]}"' for _, saved in known if saved)
            there = f"; known here: {names}" if names else " and none was ever armed here"
            raise UsageError(f"no bench is in use{there}")
        yield from used
        return
    path = Path(bench)
    here = str(path.resolve()) if path.suffix else ""
    named = [
        (station, saved)
        for station, saved in known
        if saved
        and (
            bench in {saved["name"], station.folder.name, Path(saved["path"]).stem}
            or (here and here == str(Path(saved["path"]).resolve()))
        )
    ]
    if named:
        yield from named
        return
    yield _from_file(bench, [word for _, saved in known if saved for word in (Path(saved["path"]).stem, saved["name"])])


def _from_file(bench: str, known: list[str]) -> tuple[Station, dict[str, Any]]:
    """A bench that was never armed here, from its file."""
    from pmabench.bench.compile import mount_alone

    try:
        path = find_file("bench", bench)
    except PmaError as error:
        raise UsageError(f'no bench "{bench}" was armed here, and no such file{did_you_mean(bench, known)}') from error
    compiled = mount_alone(path).bench
    return Station(compiled.name), json.loads(compiled.to_json())


def _all_at_once(ui: Ui, found: list[tuple[Station, dict[str, Any]]], began: float) -> list[Vented]:
    """Vent each bench in its own thread: none waits for another. Raises the first error when all are done."""
    vented: dict[int, list[Vented]] = {number: [] for number in range(len(found))}
    errors: dict[int, Exception] = {}

    def vent(number: int, station: Station, saved: dict[str, Any]) -> None:
        try:
            vented[number].extend(_vent(ui, station, saved, began))  # keeps what comes before an error
        except Exception as error:  # raised below
            errors[number] = error

    order = sorted(range(len(found)), key=lambda number: not found[number][0].read("guard"))
    threads = [threading.Thread(target=vent, args=(number, *found[number])) for number in order]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    done = [item for items in vented.values() for item in items]
    if errors:
        _print(done)
        raise errors[min(errors)]
    return done


def _vent(ui: Ui, station: Station, saved: dict[str, Any], began: float) -> Iterator[Vented]:
    """Vent a bench by its guard; without one, by the guard of another bench that holds its devices, or directly.

    Another bench that has only some of its devices is vented first, and comes first: its run has ended.
    """
    if (vented := _by_guard(ui, station, saved, began)) is not None:
        yield vented
        return
    others = [other for other in stations() if other.folder != station.folder and other.read("guard")]
    mine = _places(saved) if others else set()
    for other in others:
        try:
            its = other.read("bench")
            has = _places(its, resolve=False) | set(other.read("state").get("devices", ()))
            if not _held(mine & has):
                continue
            vented = _by_guard(ui, other, its, began) or _directly(other, its, began)
        except Exception as error:  # of another bench: this one is vented in any case
            ui.note(f"{other.folder.name}: {error}")
            continue
        if mine <= has:
            way = f'{vented.way} (of "{vented.bench}", which has its devices)'
            yield replace(vented, bench=saved["name"], way=way)
            return
        yield vented
    yield _directly(station, saved, began)


def _places(saved: dict[str, Any], *, resolve: bool = True) -> set[str]:
    """Addresses of the devices of a compiled bench, as they are locked; looking up host names may take seconds."""
    from pmabench.bench.interface import place

    return {place(each["address"], each["options"], resolve=resolve) for each in saved.get("devices", ())} - {""}


def _held(places: Iterable[str]) -> str:
    """The first of these devices that a program uses now, and which; empty if there is none."""
    for where in sorted(places):
        path = root() / f"{folder_name(where)}.device"
        lock = try_lock(path) if path.exists() else -1
        if lock is None:
            return f"its device at {where} is in use by {path.read_text('utf-8').strip() or 'another program'}"
        if lock >= 0:
            os.close(lock)
    return ""


def _directly(station: Station, saved: dict[str, Any], began: float) -> Vented:
    from pmabench.bench.interface import CompiledBench
    from pmabench.guard.remote import vent_directly

    if not saved:
        raise PmaError(f"{station.folder.name}: its guard does not answer and its compiled bench is not kept")
    compiled = CompiledBench.from_json(json.dumps(saved))
    if not compiled.realtime:
        raise UsageError(f'"{compiled.name}" exists in virtual time only: there is nothing to vent')
    commanded = time.monotonic() - began
    vent = vent_directly(compiled, station, f"vent by {_who()}")
    way = "the devices, opened here" + (": the guard does not answer" if station.read("guard") else "")
    return Vented(compiled.name, way, vent.result, vent.actions, commanded)


def _by_guard(ui: Ui, station: Station, saved: dict[str, Any], began: float) -> Vented | None:
    """Ask the guard; None where there is none, or it does not answer in time, or not to the end."""
    guard, name, commanded = station.read("guard"), saved.get("name", station.folder.name), 0.0
    try:
        asking, answering = keys(guard["token"])
        messages = Messages(answering)
        with socket.create_connection(("127.0.0.1", guard["port"]), timeout=ANSWERS_WITHIN) as link:
            link.sendall(encode({"do": "vent", "who": _who()}, asking))
            while True:
                for answer, _ in messages.feed(link.recv(1 << 16) or _closed()):
                    if not commanded:
                        commanded = time.monotonic() - began
                        ui.note(f"{name}: vent commanded after {1e3 * commanded:.0f} ms")
                        link.settimeout(CONFIRMS_WITHIN)
                    if (vent := answer.get("vent")) is not None:
                        return Vented(name, "its guard", vent["result"], tuple(vent["actions"]), commanded)
    except (OSError, ValueError, KeyError):  # no guard, a stranger on its port, or one that went before it was over
        return None


def _closed() -> bytes:
    raise ConnectionResetError("closed")


def _reset(station: Station, saved: dict[str, Any], operator: str, because: str) -> str:
    """Clear the latch, and say why it was tripped; refused while a run is going on."""
    deadline = time.monotonic() + ENDS_WITHIN
    while True:
        try:
            if held := _held(_places(saved) | set(station.read("state").get("devices", ()))):
                raise DeviceError(station.name, held)
            station.take()
            break
        except PmaError as error:
            if time.monotonic() > deadline:
                raise LimitRefused(f"vented, and not reset: {error}") from error
            time.sleep(0.05)
    was = station.latched()
    if was:  # a bench that was not tripped keeps its session
        station.note("safe", why="reset", operator=operator, because=because, was=was, bench=saved.get("name", ""))
    return was


def _who() -> str:
    try:
        return f"{user_name()} at {os.ttyname(0)}"
    except (OSError, AttributeError):
        return user_name()


def _print(vented: list[Vented], after: str = "") -> None:
    for item in vented:
        click.echo(f"{item.bench}: {item.result}, by {item.way}")
        for action in item.actions:
            click.echo(f"  {action}")
    if after:
        click.echo(after)
