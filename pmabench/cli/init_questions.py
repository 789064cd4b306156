"""The questions of `pmabench init` at a terminal or in a pipe, line by line: menus, defaults, explanations, back."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import UsageError
from pmabench.bench.lab.questions import MOST
from pmabench.cli.common import Ui, say

if TYPE_CHECKING:
    from pmabench.bench.lab.answers import Answers
    from pmabench.bench.lab.questions import Question

BACK, EXPLAIN, UNKNOWN = "b", "?", "-"


def ask(ui: Ui, answers: Answers, keep: Callable[[], None]) -> None:
    """Ask every question that has no answer yet; `keep` is called after each answer.

    Raises UsageError where the answers end too early.
    """
    ui.note("Enter takes the value in brackets; ? explains, b goes back, - is for what you do not know yet.")
    done: list[str] = []
    while True:
        questions = answers.questions()
        question = next((one for one in questions if one.key not in answers.given), None)
        if question is None:
            return
        place = questions.index(question) + 1
        try:
            typed = _typed(question, answers, f"{place} of at most {MOST}")
        except click.Abort:
            raise UsageError(f"no answer to {question.key}; `pmabench init` in the same folder goes on here") from None
        if typed == BACK:
            if done:
                del answers.given[done.pop()]
            continue
        answers.given[question.key] = None if typed == UNKNOWN else typed
        done.append(question.key)
        keep()


def _typed(question: Question, answers: Answers, place: str) -> str:
    """One valid answer as it is kept, `BACK` or `UNKNOWN`."""
    choices = list(question.choices(answers).items())
    default = None if question.needed else question.default(answers)
    hint = question.hint(answers)
    click.echo(f"\n{place}  {question.text}" + (f"   ({hint})" if hint else ""), err=True)
    for number, (key, words) in enumerate(choices, start=1):
        click.echo(f"   {number}  {words}" + ("" if key == words else f"  [{key}]"), err=True)
    while True:
        typed = str(click.prompt("  ", default=default, prompt_suffix="> ", err=True)).strip()
        if typed == EXPLAIN:
            say(f"   {question.explain}")
            continue
        if typed == BACK:
            return BACK
        if typed == UNKNOWN:
            if not question.needed and default is not None:
                return UNKNOWN
            say("   this answer is needed: nothing else says it")
            continue
        if choices and typed.isdecimal() and 0 < int(typed) <= len(choices):
            typed = choices[int(typed) - 1][0]
        try:
            question.read(typed, answers)
        except ValueError as error:
            say(f"   {error}")
            continue
        return typed
