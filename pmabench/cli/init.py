"""`pmabench init`: asks what a lab has, and writes its folder: bench, specimen, protocol, all that they need."""

from __future__ import annotations

import datetime
import shlex
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.base.errors import InvalidFile, RecordError, UsageError, did_you_mean, invalid
from pmabench.cli.common import Ui, common, say
from pmabench.cli.names import BENCH, FILE, PATH, next_lines
from pmabench.files.shipped import find_file, shipped_folder

if TYPE_CHECKING:
    from pmabench.bench.lab.questions import Answers, Question
    from pmabench.kinds.compile import PlannedRun


ANSWERS = "answers.yaml"
CHECK = "protocol.yaml --bench bench.yaml --specimen specimen.yaml"
README = """# Lab folder

| file | what |
| --- | --- |
| `bench.yaml` | what is wired where, limits, safe state{bench} |
| `specimen.yaml` | the muscle{specimen} |
| `protocol.yaml` | what is tested{protocol} |
| `calibrations/` | of the bench's channels{calibrations}; `pmabench calibrate CHANNEL ...` writes new ones |{answers}
| `schemas/` | for editors, which complete and check the files with them |

```
pmabench check {check} --simulate    # nothing moves
pmabench run {check}                 # records into runs/
pmabench process runs/*              # coefficients, into analyses/
pmabench report runs/* -o report.html
```

{open}Before air is on: `pmabench check` names what the bench lacks,
`pmabench bench card bench.yaml -o card.html` is the page to hang at the rig, `pmabench bench probe bench.yaml` asks the
devices who they are. Keep this folder under version control, all but `runs/` and `analyses/`. pmabench is not a safety
function.
"""
OF_ANSWERS = """
| `answers.yaml` | what was answered; `pmabench init NEW --answers answers.yaml` writes the same files again |"""
TO_CONFIRM = """Values marked TO CONFIRM were derived. Nothing runs on real devices before each was looked up and its
entry deleted from `to_confirm`, and bench.yaml says who read it over: `reviewed: {{by: NAME, date: {day}}}`. """


@click.command(name="init")
@click.argument("folder", metavar="DIR", type=PATH)
@click.option("--answers", type=FILE, help="Answers from a file; nothing asked.")
@click.option("--answer", "single", multiple=True, metavar="KEY=VALUE", help="One answer; nothing is asked.")
@click.option("--like", type=BENCH, help="No questions: a copy of a shipped bench, to be changed by hand.")
@common
def command(ui: Ui, folder: Path, answers: Path | None, single: tuple[str, ...], like: str | None) -> None:
    """Write a lab folder DIR from at most 20 questions: bench, specimen, protocol, and all that they need.

    Enter takes the value in brackets, which is to be confirmed later; ? explains; b goes back.
    Answers are kept in DIR/answers.yaml: an interrupted `init DIR` goes on there.
    """
    _refuse_full(folder)
    if like is not None:
        if answers is not None or single:
            raise UsageError("--like copies a bench and takes no answers; give one or the other")
        files, simulated = copy_of(like)
        note = "" if simulated else "where ?? is written only you know what is true; check names each place"
    else:
        asked = _answers(ui, folder, answers, single)
        files = {**_lab(asked), ANSWERS: asked.text_of_file()}
        count = sum(
            files[name].partition("\nto_confirm:")[2].count("\n  - ") for name in ("bench.yaml", "specimen.yaml")
        )
        note = f"{count} values are marked TO CONFIRM: look them up; nothing runs on real devices before"
    files |= _schemas(files)
    _write(folder, files)
    data = {"schema": "pmabench.init/1", "folder": str(folder), "files": sorted(files)}
    ui.result(data, lambda: click.echo("\n".join(_end(folder, note))))


def _refuse_full(folder: Path) -> None:
    try:
        if folder.exists() and (not folder.is_dir() or any(one.name != ANSWERS for one in folder.iterdir())):
            raise UsageError(f"{folder} is there and not an empty folder; give a new one")
    except OSError as error:
        raise UsageError(f"{folder} cannot be looked into: {error.strerror or error}") from error


def _answers(ui: Ui, folder: Path, path: Path | None, single: tuple[str, ...]) -> Answers:
    """What was answered, in a file, in words or at the terminal; UsageError where a needed answer is missing."""
    from pmabench.bench.lab.questions import Answers, check_answers, read_answers
    from pmabench.report.writing import write_file

    kept = folder / ANSWERS
    given: dict[str, str | None] = {}
    day = None
    if path is not None or kept.is_file():
        given, day = read_answers(path if path is not None else kept)
    given |= dict(_pair(text) for text in single)
    answers = Answers(given, day or datetime.date.today())
    check_answers(answers)
    if path is None and not single:
        ask(ui, answers, lambda: write_file(kept, answers.text_of_file(), "the answers"))
    missing = answers.missing()
    if missing:
        from pmabench.bench.lab.questions import QUESTIONS

        lines = [f"  --answer {key}=...   {QUESTIONS[key].text}: {QUESTIONS[key].explain}" for key in missing]
        raise UsageError("\n".join(["these answers are needed, and nobody gave them:", *lines]))
    return answers


def _pair(text: str) -> tuple[str, str | None]:
    from pmabench.bench.lab.questions import QUESTIONS

    key, equals, value = text.partition("=")
    if not equals or key not in QUESTIONS:
        raise UsageError(f'--answer {text}: "{key}" is no question{did_you_mean(key, QUESTIONS)}')
    return key, value.strip() or None


def _lab(answers: Answers) -> dict[str, str]:
    from pmabench.bench.lab.files import lab_files

    shipped = find_file("protocol", answers.text("protocol")).read_text(encoding="utf-8")
    is_open = TO_CONFIRM.format(day=answers.asked.isoformat())
    return lab_files(answers, shipped) | {"README.md": _readme(answers=OF_ANSWERS, open=is_open)}


def _readme(**about: str) -> str:
    """The page of a lab folder, with what is said about each file."""
    empty = dict.fromkeys(("bench", "specimen", "protocol", "calibrations", "answers", "open"), "")
    return README.format(**empty | {"check": CHECK} | about)


def _schemas(files: dict[str, str]) -> dict[str, str]:
    from pmabench.cli.files import schema_text

    kinds = ["protocol", "bench", "specimen", "calibration", *(["plant"] if "plant.yaml" in files else [])]
    return {f"schemas/{kind}.schema.json": schema_text(kind) for kind in kinds}


def _write(folder: Path, files: dict[str, str]) -> None:
    """Write them and check them where they are; nothing but the answers is left where that fails."""
    from pmabench.bench.compile import OPEN
    from pmabench.cli.prepare import prepare

    there = {path.name for path in folder.iterdir()} if folder.exists() else None
    try:
        for name, text in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        try:
            protocol, bench, specimen = (str(folder / f"{role}.yaml") for role in ROLES)
            prepare(protocol, bench, specimen)
        except InvalidFile as error:
            if not all(f"({OPEN})" in problem.message for problem in error.problems):
                raise  # else it is what is to be filled in
    except BaseException as error:
        with suppress(OSError):
            for name in {Path(name).parts[0] for name in files} - (there or set()):
                shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink(missing_ok=True)
            if there is None:
                folder.rmdir()
        if isinstance(error, OSError):
            raise RecordError(f"{folder}: no lab folder can be written here: {error.strerror or error}") from error
        raise


def _end(folder: Path, note: str) -> list[str]:
    lines = [f"{folder}: bench.yaml, specimen.yaml, protocol.yaml, README.md"]
    lines += [f"!  {note}"] if note else []
    return [
        *lines,
        *next_lines("cd", shlex.quote(str(folder)), "&&", "pmabench", "check", *CHECK.split(), "--simulate"),
    ]


BACK, EXPLAIN, UNKNOWN = "b", "?", "-"


def ask(ui: Ui, answers: Answers, keep: Callable[[], object]) -> None:
    """Ask every question that has no answer yet; `keep` is called after each answer.

    Raises UsageError where the answers end too early.
    """
    from pmabench.bench.lab.questions import MOST

    ui.note(
        "Enter takes the value in brackets, marked TO CONFIRM; type what you know yourself. ? explains, b goes back."
    )
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
    proposed = "  " if default is None else f"   [{default}]"
    while True:
        typed = str(click.prompt(proposed, default="", show_default=False, prompt_suffix="> ", err=True)).strip()
        if typed == EXPLAIN:
            say(f"   {question.explain}")
            continue
        if typed == BACK:
            return BACK
        if typed in {"", UNKNOWN}:
            if default is not None:
                return UNKNOWN
            say("   an answer is needed here: nothing else says it")
            continue
        if choices and typed.isdecimal() and 0 < int(typed) <= len(choices):
            typed = choices[int(typed) - 1][0]
        try:
            question.read(typed, answers)
        except ValueError as error:
            say(f"   {error}")
            continue
        return typed


SCHEMAS = "schemas"
ROLES = ("protocol", "bench", "specimen")
BLANK_SPECIMEN = """\
# yaml-language-server: $schema=schemas/specimen.schema.json
# `check` refuses this file until every ?? is what is true of your muscle.
schema: pmabench.specimen/1
make: ??
type: ??                                       # as on its label
serial: ??
nominal_length: ??                             # between the fittings, as ordered: 250 mm
inner_diameter: ??                             # 20 mm
mounted: {date: "??", length: "??", at: {load: 0 kg, pressure: 0 kPa}}  # in the rig, with that load
limits: {pressure: {command: "??", never_above: "??"}, contraction: "??", source: "??"}   # by the maker's data sheet
"""
CALIBRATION = """\
# yaml-language-server: $schema=../schemas/calibration.schema.json
# `check` refuses this file until every ?? is filled in: by the sensor's certificate or data sheet at first, later by
# `pmabench calibrate`, which compares the sensor with a reference at the bench and writes a file like this one.
schema: pmabench.calibration/1
id: {id}
quantity: {quantity}
reference: ??                                  # what the sensor was compared with, with its serial or certificate
date: ??                                       # 2026-11-23
points: ??                                     # readings, true values: [[0 V, 0 N], [10 V, 500 N]]
expanded_uncertainty: ??                       # k = 2, with a unit
"""


def copy_of(like: str) -> tuple[dict[str, str], bool]:
    """Path -> text of a lab folder with the shipped bench `like`, and whether that bench is simulated.

    For devices that `init` does not ask about. Of a simulated bench it passes `check`. Of a bench with devices, what is
    true at one lab only (calibrations, the muscle) is written as `??`, and `check` refuses each until it is filled in.
    """
    from pmabench.cli.prepare import prepare

    prepared = prepare("contraction-relaxation", like, "mas-20-250-paper0")
    return dict(_files(prepared)), _simulated(prepared)


def _files(prepared: PlannedRun) -> Iterator[tuple[str, str]]:
    """Path in the lab folder and text of each file."""
    from pmabench.files.document import Document

    paths = {role: Path(prepared.sources[role]) for role in ROLES}
    own = not _simulated(prepared)
    for role, path in paths.items():
        if own and role == "specimen" and _shipped(role, path):
            yield f"{role}.yaml", BLANK_SPECIMEN
            continue
        yield f"{role}.yaml", _own_text(path)
        yield from _included(path)
    bench_folder = paths["bench"].parent
    for name in prepared.mounted.documents:
        if own and name.startswith("calibrations/") and _shipped("bench", paths["bench"]):
            shipped = Document(name, _own_text(bench_folder / name)).data  # of another sensor: only its quantity counts
            yield name, CALIBRATION.format(id=Path(name).stem, quantity=shipped["quantity"])
        elif "/" in name:
            yield name, _own_text(bench_folder / name, depth=name.count("/"))
    yield "README.md", _readme_like(prepared, paths["bench"].stem)


def _shipped(role: str, path: Path) -> bool:
    return shipped_folder(role).resolve() in path.resolve().parents


def _included(path: Path) -> Iterator[tuple[str, str]]:
    """What a file includes, and what that includes."""
    from pmabench.files.document import Document

    name = Document(str(path), path.read_text()).data.get("include")
    if not isinstance(name, str):
        return
    if Path(name).parent != Path() or name in {f"{role}.yaml" for role in ROLES}:
        raise invalid(path, f'includes "{name}", which cannot lie in a lab folder; name a file next to it')
    yield name, _own_text(path.parent / name)
    yield from _included(path.parent / name)


def _own_text(path: Path, depth: int = 0) -> str:
    """A file's text; editors find its schema in the lab folder."""
    lines = path.read_text().splitlines(keepends=True)
    mark = "yaml-language-server: $schema="
    for i, line in enumerate(lines):
        if line.startswith("#") and mark in line:
            lines[i] = f"# {mark}{'../' * depth}{SCHEMAS}/{line.strip().rsplit('/', 1)[-1]}\n"
    return "".join(lines)


def _simulated(prepared: PlannedRun) -> bool:
    return all(device.driver.startswith("mock") for device in prepared.mounted.bench_file.devices.values())


def _readme_like(prepared: PlannedRun, bench: str) -> str:
    plan, simulated = prepared.plan, _simulated(prepared)
    kind = "addresses, ranges and limits are examples: put in yours"
    muscle = f": {prepared.mounted.specimen_file.type}" if simulated else ""
    if simulated:
        kind = "a simulated muscle: write your devices in its place, or copy the shipped bench that is most like yours"
    return _readme(
        bench=f"; the shipped bench `{bench}`, {kind}",
        specimen=f"{muscle}. Put in type, serial, lengths and limits of yours",
        protocol=f": {plan.name} (kind {plan.kind})",
        calibrations="; fill in what is `??`",
        open="" if simulated else "`pmabench check` refuses what is still `??`. ",
    )
