"""Which run an address of the page means, and which runs are listed next to it; reads manifests and seals only.

`/` is the newest run of the folder, and the next one when it begins; `/run/ID` one run; `/campaign/NAME` the newest run
of a campaign, `/session/DATE` that of a day, with the others of it.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from pmabench.base.errors import InvalidFile
from pmabench.display.wording import clean
from pmabench.store import folder as files
from pmabench.store.folder import read_manifest, read_seal, status_of

LISTED = 200
"""Newest runs that are looked at for a list."""
SHOWN = 40
"""Runs of a list."""


class Places:
    """The runs of one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[str, dict[str, Any]] = {}
        """Runs that have ended, by the name of their folder."""

    def run_at(self, address: str) -> Path | None:
        """The run folder that an address means now; None where there is none."""
        what, _, name = address.strip("/").partition("/")
        name = unquote(name)
        if not what:
            return self._newest()
        if what == "run":
            if name in {"", ".", ".."} or len(name) > 255 or any(sign in name for sign in "/\\\0"):
                return None
            return self.root / name if (self.root / name / files.MANIFEST).is_file() else None
        listed = self.listed(address)
        return self.root / listed[0]["id"] if listed else None

    def listed(self, address: str, run: Path | None = None) -> list[dict[str, Any]]:
        """The runs of a campaign or of a day, newest first; for other addresses those of the run's campaign or day."""
        what, _, name = address.strip("/").partition("/")
        wanted = unquote(name)
        if what not in {"campaign", "session"}:
            about = self._about(run) if run is not None else None
            if about is None:
                return []
            what = "campaign" if about["campaign"] else "session"
            wanted = about[what]
        names = sorted((path.parent.name for path in self.root.glob(f"*/{files.MANIFEST}")), reverse=True)[:LISTED]
        found = [about for entry in names if (about := self._about(self.root / entry)) and about[what] == wanted]
        return sorted(found, key=lambda about: about["started"], reverse=True)[:SHOWN]

    def _newest(self) -> Path | None:
        runs = []
        for path in self.root.glob(f"*/{files.MANIFEST}"):
            with suppress(OSError):
                runs.append((path.stat().st_mtime, path.parent))
        return max(runs)[1] if runs else None

    def _about(self, run: Path) -> dict[str, Any] | None:
        """What a list says of a run; None where it cannot be read."""
        if run.name in self._known:
            return self._known[run.name]
        try:
            manifest, seal = read_manifest(run), None
            with suppress(InvalidFile):
                seal = read_seal(run)
        except (InvalidFile, OSError):
            return None
        campaign = manifest.get("campaign") if isinstance(manifest.get("campaign"), dict) else {}
        about = {
            "id": run.name,
            "kind": clean(manifest.get("kind", "")),
            "started": clean(manifest.get("started_utc", "")),
            "session": clean(manifest.get("started_utc", ""))[:10],
            "campaign": clean((campaign or {}).get("name", "")),
            "status": clean(status_of(manifest, seal)),
            "trials": int(manifest.get("trials_planned") or 0),
        }
        if seal is not None:
            self._known[run.name] = about
        return about
