"""The run that comes after one in the same program: the run behind a session, the next one of a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile
from pmabench.store import folder as files
from pmabench.store.folder import read_manifest, status_of

GOES_ON = {"session": ("finished",), "campaign": ("finished", "failed")}
"""How a session, or a run of a campaign, ends where another run follows."""


def awaits_another(manifest: Mapping[str, Any], status: str) -> bool:
    """Whether the program that wrote this run still lives and is going to begin another one."""
    if status_of(manifest, None) != "running":
        return False
    place = manifest.get("campaign")
    if isinstance(place, dict) and place.get("number", 0) + 1 < place.get("of", 0):
        return status in GOES_ON["campaign"]
    return manifest.get("kind") == "session" and status in GOES_ON["session"]


def run_after(folder: Path, manifest: Mapping[str, Any]) -> Path | None:
    """The first run next to `folder` that the same program began later; None where there is none yet."""
    later = []
    for path in folder.resolve().parent.glob(f"*/{files.MANIFEST}"):
        with suppress(InvalidFile, OSError):
            other = read_manifest(path.parent)
            if other.get("writer") == manifest.get("writer") and _began(other) > _began(manifest):
                later.append((_began(other), path.parent))
    return min(later)[1] if later else None


def _began(manifest: Mapping[str, Any]) -> str:
    return str(manifest.get("started_utc", ""))
