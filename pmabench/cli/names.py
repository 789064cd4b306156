"""Arguments that name a file or a run, and what the shell completes them with: names and places only, no file is read
beyond its first lines, so that Tab answers as fast as --help.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from pmabench.base.errors import UsageError
from pmabench.files.shipped import shipped_folder

HEAD = 2000
"""Characters at the start of a file in which its schema and its name are looked for."""
TAIL = re.compile("[0-9a-f]{4}(-[a-z]+)?")
"""The end of the name of a run, which tells it from others of the same minute."""
MOST = 50
"""Runs that are proposed, the newest first."""

WIDTH = 80
"""Columns of a terminal that every line of advice fits."""


class Named(click.ParamType[str]):
    """A file of one kind by its path, or by the name of a shipped one."""

    name = "text"

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files of this kind here and in the folder of their kind, shipped ones, and whatever else lies here."""
        own = [str(path) for path in own_files(self.kind)]
        names = [*own, *(path.stem for path in shipped_files(self.kind))]
        found = [CompletionItem(name) for name in names if name.startswith(incomplete)]
        return found or [CompletionItem(incomplete, type="file")]


class RunFolder(click.Path):
    """The folder of a run or of an analysis."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """A path, or the last four signs of a name, which no other folder there has: `runs/3efe`, `3efe`."""
        try:
            return super().convert(in_full(Path(value)), param, ctx)
        except UsageError as error:
            self.fail(str(error), param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """The newest folders below `runs` and `analyses` here that begin like `incomplete`, else any folder."""
        places = [Path(name) for name in ("runs", "analyses")]
        found = [str(one) for place in places if place.is_dir() for one in place.iterdir() if one.is_dir()]
        found = sorted((name for name in found if name.startswith(incomplete)), reverse=True)[:MOST]
        return [CompletionItem(name) for name in found] or [CompletionItem(incomplete, type="dir")]


def in_full(path: Path) -> Path:
    """The folder that a short path names (`runs/3efe`, `3efe`), else the path itself."""
    if not TAIL.fullmatch(path.name) or path.exists():
        return path
    places = [path.parent] if len(path.parts) > 1 else [Path(), Path("runs"), Path("analyses")]
    ends = [one for place in places for one in place.glob(f"*_{path.name}") if one.is_dir()]
    found = list({one.name: one for one in reversed(ends)}.values())  # a run before the analysis called after it
    if len(found) > 1:
        raise UsageError(f'"{path}" is the end of several names: {", ".join(map(str, found))}')
    return found[0] if found else path


def tail_of(name: str) -> str:
    """The last signs of the name of a run or an analysis, as it is typed; the whole name where it has none."""
    tail = name.rpartition("_")[2]
    return tail if TAIL.fullmatch(tail) else name


def short(folder: Path) -> str:
    """A run or analysis as it is shortest typed here: `runs/3efe`, where no other folder there ends so."""
    path = folder.resolve()
    tail = tail_of(path.name)
    alone = tail != path.name and len([one for one in folder.parent.glob(f"*_{tail}") if one.is_dir()]) == 1
    return typed(path.with_name(tail) if alone else path)


def typed(path: Path, kind: str = "") -> str:
    """A resolved path as it can be typed here; a shipped file of a `kind` by its name."""
    if kind and path.parent == shipped_folder(kind).resolve():
        return path.stem
    return shlex.quote(str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path))


def own_files(kind: str) -> Iterator[Path]:
    """Files of a kind in this folder and in the folder below it that is called after the kind, by their schema."""
    for folder in (Path(), Path(Path(shipped_folder(kind)).name)):
        for path in sorted(folder.glob("*.yaml")):
            if f"schema: pmabench.{kind}/" in head_of(path):
                yield path


def head_of(path: Path) -> str:
    """The first lines of a file; empty where it cannot be read."""
    with suppress(OSError), path.open(encoding="utf-8", errors="replace") as file:
        return file.read(HEAD)
    return ""


def shipped_files(kind: str) -> list[Path]:
    """Shipped files of a kind."""
    return sorted(shipped_folder(kind).glob("*.yaml"))


class HtmlFile(click.Path):
    """The file of a page; a name of another format would mislead."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, unless it ends like a file of another program."""
        path = Path(str(super().convert(value, param, ctx)))
        if path.suffix.lower() in OTHERS:
            option = f"--{path.suffix.lower()[1:]}"
            known = ctx is not None and any(option in one.opts for one in ctx.command.params)
            instead = f"; `{option} {path}` writes that" if known else ""
            self.fail(f"{path} would be a page of HTML: name it {path.with_suffix('.html')}{instead}", param, ctx)
        return path


OTHERS = {".pdf", ".xlsx", ".docx", ".csv", ".json", ".png", ".svg"}
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
HTML = HtmlFile(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
BENCH, SPECIMEN, PROTOCOL, CAMPAIGN = (Named(kind) for kind in ("bench", "specimen", "protocol", "campaign"))


def next_lines(*words: str, indent: int = 8) -> list[str]:
    """`next    COMMAND` in lines of at most 80 columns where its words allow it; it can be typed as it is printed."""
    return typed_lines(f"{'next':<{indent}}{words[0]}", words[1:], WIDTH - 3, 10)


def typed_lines(first: str, rest: Iterable[str], most: int, indent: int) -> list[str]:
    """A command in lines that can be typed as they are printed, each broken where the next part would pass `most`."""
    lines = [first]
    for part in rest:
        if len(lines[-1]) + len(part) > most:
            lines[-1] += " \\"
            lines.append(" " * indent + part)
        else:
            lines[-1] += f" {part}"
    return lines
