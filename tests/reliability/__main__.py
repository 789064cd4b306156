"""Runs the parts of the reliability harness with many cases and writes what came of them into docs/reliability.md.

`python -m tests.reliability [PART ...]`; all parts where none is named. Rows of parts that are not run this time stay; a
part that was never run has a row that says so.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

from tests.reliability.cases import VARIABLE
from tests.reliability.parts import PARTS, Part

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reliability.md"
HEAD = """\
# What was tried to break it

Each row is written by `make reliability PART=name` from what was run; `make reliability` runs all of them. The numbers
are cases and those of them that failed. Every commit runs the same tests with fewer cases. A part that says "not run
yet" was never run with its many cases, only with the few of every commit.
`tests/reliability/README.md` says what a part is and how to add one.

| part | promise | what | cases | failures | seconds | date | commit |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""
NOT_RUN = "not run yet"


def main(names: list[str]) -> int:
    """Exit code 1 where a part failed, 2 where there is no such part."""
    known = {part.name: part for part in PARTS}
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"no part {', '.join(unknown)}; there are: {', '.join(known)}", file=sys.stderr)
        return 2
    rows = _rows()
    failed = False
    for name in names or known:
        row, bad = _run(known[name])
        rows[name] = row
        failed |= bad
        print(row, flush=True)
        PAGE.write_text(page(rows), "utf-8")
    return 1 if failed else 0


def page(rows: dict[str, str]) -> str:
    """The page: a row for every part, in their order."""
    return HEAD + "".join(f"{rows.get(part.name) or _cells(part, NOT_RUN, '', '', '', '')}\n" for part in PARTS)


def _cells(part: Part, *found: str) -> str:
    """One row: what the part is, then cases, failures, seconds, date and commit."""
    return f"| {' | '.join((part.name, part.promise, part.what, *found))} |"


def _rows() -> dict[str, str]:
    """Rows of the page by the names of their parts, but for those that say that a part was not run."""
    text = PAGE.read_text("utf-8") if PAGE.is_file() else ""
    return {
        found[1]: found[0]
        for found in re.finditer(r"^\| ([a-z-]+) \|.*\|$", text, re.MULTILINE)
        if found[1] != "part" and NOT_RUN not in found[0]
    }


def _run(part: Part) -> tuple[str, bool]:
    """The row of one part, and whether it failed."""
    commit = _commit()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "--timeout=3600",
            "-o",
            "junit_family=xunit1",
        ]
        environment = {**os.environ, VARIABLE: str(part.cases)}
        began = time.monotonic()
        code = subprocess.run(
            [*command, f"--junitxml={report}", *part.tests], cwd=ROOT, env=environment, check=False
        ).returncode
        seconds = time.monotonic() - began
        count, missed = _count(report)
    cases, failures = count["cases"], max(count["failures"], int(code not in (0, 5)))
    tried = str(cases) if not missed else f"{cases}; {'; '.join(missed)}"
    date = datetime.now(UTC).date().isoformat()
    return _cells(part, tried, str(failures), f"{seconds:.0f}", date, commit), failures > 0


def _count(report: Path) -> tuple[Counter[str], list[str]]:
    """Cases and failures, and why tests were not run."""
    count: Counter[str] = Counter()
    missed: dict[str, None] = {}
    for test in ET.parse(report).iter("testcase") if report.is_file() else ():
        properties = {entry.get("name"): entry.get("value") or 0 for entry in test.iter("property")}
        skipped = test.find("skipped")
        if skipped is not None:
            missed[str(skipped.get("message"))] = None
            continue
        bad = test.find("failure") is not None or test.find("error") is not None
        count["cases"] += int(properties.get("cases", 1))
        count["failures"] += int(properties.get("failures", bad)) or int(bad)
    return count, list(missed)


def _commit() -> str:
    """The commit that is tried, and whether files differ from it."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    changed = git("status", "--porcelain", "--", "pmabench", "drivers", "tests")
    return f"{git('rev-parse', '--short', 'HEAD') or 'none'}{' and changes' if changed else ''}"


if __name__ == "__main__":
    sys.exit(main([name for argument in sys.argv[1:] for name in argument.split(",") if name]))
