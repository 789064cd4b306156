"""The table of docs/clients.md: a row for each client, its calls by what came of them."""

import re
from pathlib import Path

from tests.clients.harness import AGREES, DISAGREES, NOT_TRIED
from tests.clients.table import CLIENTS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "clients.md"
BEGIN, END = "<!-- clients: written by `python -m tests.clients --write` -->", "<!-- end of clients -->"
HEAD = "| client / device | agrees | disagrees | not tried |\n| --- | --- | --- | --- |\n"
STATES = (AGREES, DISAGREES, NOT_TRIED)


def rows():
    """What the page says: client -> state -> calls."""
    text = PAGE.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
    found = {}
    for line in text.strip().splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        found[cells[0]] = dict(zip(STATES, (re.findall(r"`([^`]+)`", cell) for cell in cells[1:]), strict=True))
    return found


def written(client, results):
    """Put the row of a client into the page; the others stay."""
    known = rows()
    known[client.what] = {state: [item.call for item in results if item.state == state] for state in STATES}
    lines = [
        f"| {item.what} | {' | '.join(', '.join(f'`{name}`' for name in known[item.what][state]) for state in STATES)} |\n"
        for item in CLIENTS
        if item.what in known
    ]
    text = PAGE.read_text("utf-8")
    head, tail = text.partition(BEGIN)[0], text.partition(END)[2]
    PAGE.write_text(f"{head}{BEGIN}\n{HEAD}{''.join(lines)}{END}{tail}", "utf-8")
