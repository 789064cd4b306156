"""Reads JSON files that are not trusted: limited size and depth, known schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pmabench.base.errors import invalid, reading

DEEPEST = 20
"""Largest nesting of objects and lists, since readers use recursion."""


def read_json(path: Path, schema: str, what: str, most: int, missing: str = "there is no such file") -> dict[str, Any]:
    """The object in a JSON file with the entry `schema`; all numbers are finite.

    `what`: name of such a file in messages. `most`: largest size [bytes]. `missing`: message for a missing file. Raises
    InvalidFile for a file that is missing, too large, cut off, nested too deeply, or of another schema or version.
    """
    with reading(path):
        if not path.is_file():
            raise invalid(path, missing)
        if path.stat().st_size > most:
            raise invalid(path, f"is larger than {most // 1_000_000} MB: no {what}")
        raw = path.read_bytes()
    try:
        data = json.loads(raw, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise invalid(path, f"is not JSON, or was cut off: {' '.join(str(error).split())[:120]}") from error
    found = str(data.get("schema")) if isinstance(data, dict) else ""
    if found != schema and found.startswith(schema.rpartition("/")[0] + "/"):
        raise invalid(path, f"was written by another pmabench ({found[:40]}); this one reads {schema}")
    if found != schema:
        raise invalid(path, f"is no {what}: its schema is not {schema}")
    if not _shallow(data, DEEPEST):
        raise invalid(path, f"is damaged: it has more than {DEEPEST} levels")
    return dict(data)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number of JSON")


def _shallow(value: Any, left: int) -> bool:
    """Whether a value is nested at most `left` levels deep."""
    if isinstance(value, dict | list):
        inner = value.values() if isinstance(value, dict) else value
        return left > 0 and all(_shallow(item, left - 1) for item in inner)
    return True
