"""How reports are written to files, and how their pages are rendered: self-contained HTML, every text escaped."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from pmabench.base.errors import RecordError
from pmabench.base.text import clean
from pmabench.plotting.svg import symbol_parts


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Raise RecordError for an operating system error inside: `what` (as "the report") cannot be written to `path`."""
    try:
        yield
    except OSError as error:
        raise RecordError(f"{path}: {what} cannot be written: {error.strerror or error}") from error


def write_file(path: Path, data: str | bytes, what: str) -> Path:
    """Write text (UTF-8, line ends as they are) or bytes, the folder made where needed. Raises RecordError."""
    with writing(path, what):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def render(template: str, context: dict[str, Any], **filters: Callable[[Any], Any]) -> str:
    """A page from a template of this package; `filters` are added to `sym` and `css`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({"sym": symbols_marked, "css": css_text} | filters)
    return environment.get_template(template).render(context) + "\n"


def symbols_marked(text: object) -> Any:
    """Escaped text with symbols in italics and their subscripts lowered."""
    from markupsafe import Markup

    tags = {"symbol": ("<i>", "</i>"), "sub": ("<sub>", "</sub>"), "text": ("", "")}
    parts = symbol_parts(str(text))
    return Markup("".join(f"{tags[kind][0]}{escape(part)}{tags[kind][1]}" for kind, part in parts))  # noqa: S704


def css_text(text: object) -> Any:
    """Text inside a CSS string: everything but letters, digits and blanks as an escape."""
    from markupsafe import Markup

    inert = (c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in clean(text, 90))
    return Markup("".join(inert))  # noqa: S704
