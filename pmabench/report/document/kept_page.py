"""The page of the last report of stored analyses, kept next to them: the same report once more is a copy.

Standard library only, so that a copy costs no more than looking whether anything changed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.store.analyses.folder import key_of
from pmabench.store.folder import open_regular
from pmabench.store.since import stamp

NAME = ".report.kept"
LONGEST = 200_000_000
"""Bytes of a kept page that is read."""


@dataclass(frozen=True)
class Page:
    """A report as text."""

    text: str
    since: Mapping[str, Any]
    """What came to its runs after they were closed, by run."""
    remarks: Sequence[str]
    """The same as lines for the terminal."""


def page_key(folders: Sequence[Path], runs: Sequence[Path], about: Mapping[str, Any]) -> str:
    """Hash of analyses, runs, program and what else the page says; empty where it cannot be known to be the same."""
    stamps = [stamp(folder) for folder in folders]
    return key_of(runs, {"analyses": stamps, **about}) if all(stamps) else ""


def keep(place: Path, key: str, page: Page) -> None:
    """Keep a page in `place`, in place of an earlier one; a folder that cannot be written keeps none."""
    body = page.text.encode()
    head = {"key": key, "sha256": hashlib.sha256(body).hexdigest(), "since": page.since, "remarks": list(page.remarks)}
    with suppress(OSError):
        (place / NAME).write_bytes(json.dumps(head).encode() + b"\n" + body)


def kept(place: Path, key: str) -> Page | None:
    """The page of `key` that was kept in `place`; None where there is none, or it was changed."""
    with suppress(OSError, ValueError, TypeError, KeyError), open_regular(place / NAME) as file:
        head, body = json.loads(file.readline(LONGEST)), file.read(LONGEST)
        if key and head["key"] == key and head["sha256"] == hashlib.sha256(body).hexdigest():
            return Page(body.decode(), head["since"], head["remarks"])
    return None
