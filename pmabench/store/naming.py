"""Names of run folders and of the files in them, legal on every file system; must not touch the disk."""

from __future__ import annotations

import re
import secrets
from datetime import UTC, datetime

from pmabench.base.errors import RecordError

_PART = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")


def run_name(utc: datetime, specimen: str, kind: str, simulated: bool) -> str:
    """A folder name that sorts as time does, of `[A-Za-z0-9._-]` only.

    For instance `20261121-1432_MAS20-A017_contraction-relaxation_7f3a`, with `SIMULATED` before the last part where
    it is so. The last part distinguishes runs of the same minute.
    """
    parts = [utc.astimezone(UTC).strftime("%Y%m%d-%H%M"), _word(specimen, "specimen"), _word(kind, "run")]
    return "_".join([*parts, *(["SIMULATED"] if simulated else []), secrets.token_hex(2)])


def is_run_name(name: str) -> bool:
    """Whether a folder has a name that `run_name` gave, whatever it still holds."""
    return re.fullmatch(r"\d{8}-\d{4}_[A-Za-z0-9._-]+_[0-9a-f]{4}", name) is not None


def _word(text: str, otherwise: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text)[:40].strip("-.") or otherwise


def check_name(name: str) -> str:
    """`name` itself where it stays inside the run folder and is legal on every file system; else RecordError."""
    if not all(_PART.fullmatch(part) for part in name.split("/")):
        raise RecordError(f'"{name}" cannot be a file of a run; use letters, digits, ".", "_" and "-", and no blank')
    return name
