"""Folders of the shipped protocols and fixtures: in the installed package, else in the checkout."""

from __future__ import annotations

from pathlib import Path

from pmabench.base.errors import invalid, nearest

_PACKAGE = Path(__file__).resolve().parent.parent
SHIPPED = {
    "protocol": "protocols",
    "bench": "fixtures/benches",
    "truth": "fixtures/truths",
    "specimen": "fixtures/specimens",
    "plant": "fixtures/plants",
    "campaign": "fixtures/campaigns",
    "map": "fixtures/maps",
    "cascade": "fixtures/cascades",
}
"""Kind of file -> its shipped folder."""


def shipped_folder(kind: str) -> Path:
    """Folder with the shipped files of a kind."""
    inside = _PACKAGE / "shipped" / SHIPPED[kind]
    return inside if inside.is_dir() else _PACKAGE.parent / SHIPPED[kind]


def find_file(kind: str, name: str) -> Path:
    """The file at the path `name`, else the shipped file of that name; raises `InvalidFile` if there is neither."""
    path = Path(name)
    if not name:
        raise invalid('""', f"names no {kind}; give a file or the name of a shipped one")
    try:
        if path.exists():
            return path
    except (OSError, ValueError) as error:
        raise invalid(name[:80], f"cannot be the name of a file: {getattr(error, 'strerror', '') or error}") from error
    shipped = shipped_folder(kind) / (name if name.endswith(".yaml") else f"{name}.yaml")
    if path.name == name and shipped.is_file():
        return shipped
    others = (other for other in SHIPPED if (shipped_folder(other) / shipped.name).is_file())
    if path.name == name and (other := next(others, None)):
        raise invalid(name, f"is a shipped {other}, where a {kind} is expected")
    near = nearest(name, sorted(file.stem for file in shipped_folder(kind).glob("*.yaml")))
    more = near or "; `pmabench list` shows what there is"
    raise invalid(name, f"there is no such file, and no shipped {kind} of that name{more}")
