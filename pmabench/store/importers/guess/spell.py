"""Texts as YAML: comments, questions and scalars of a proposed map."""

from __future__ import annotations

import json
import re

from pmabench.base.text import printable
from pmabench.store.importers.guess.asked import Asked
from pmabench.store.importers.questions import OPEN

TRUTH = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
"""Texts that YAML may take for something else."""


def comment(text: str) -> str:
    """A comment line."""
    return f"# {printable(text, 400)}"


def question(asked: Asked) -> str:
    """The comment above a value that is asked for."""
    return comment(f"{OPEN} {asked.text}")


def scalar(text: str) -> str:
    """A YAML scalar that is that text and nothing else."""
    if re.fullmatch(r"[A-Za-z@][A-Za-z0-9@ _./()-]*", text) and text.lower() not in TRUTH:
        return text.strip() if text == text.strip() else json.dumps(text)
    return json.dumps(text, ensure_ascii=not text.isprintable())
