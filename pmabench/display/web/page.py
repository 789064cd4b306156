"""The one file that a browser loads: markup, style and script in one, and the policy that allows just these."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from importlib.resources import files

SCRIPTS = ("text.js", "curves.js", "figures.js", "parts.js", "link.js", "main.js")
"""Files of the script in `page/`, in their order."""
NOT_SHOWN = r"\.u-(legend|inline|series|title)\b[^{}]*\{[^{}]*\}"
"""Rules of uPlot's style for legend and title, which no plot of this page has."""


def _read(package: str, name: str) -> str:
    return files(package).joinpath(name).read_text("utf-8")


def _short(text: str) -> str:
    """Script or markup without indents and comments of a whole line, which a browser need not load."""
    lines = (line.strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("//"))


def _hash(text: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


@cache
def page() -> tuple[bytes, str]:
    """The page, and its Content-Security-Policy: its script and style, data of the same address, nothing else."""
    vendored, own = "pmabench.plotting", "pmabench.display.web"
    style = re.sub(NOT_SHOWN, "", _read(vendored, "web/uplot.min.css"))
    style += "".join(_read(own, "page/page.css").splitlines())
    parts = "\n".join(_short(_read(own, f"page/{name}")) for name in SCRIPTS)
    script = f"{_read(vendored, 'web/uplot.iife.min.js')}\n(() => {{'use strict';\n{parts}\n}})()"
    text = _short(_read(own, "page/page.html")).replace("<style></style>", f"<style>{style}</style>")
    text = text.replace("<script></script>", f"<script>{script}</script>")
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; connect-src 'self'; "
        "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return text.encode(), policy
