"""Protocol file to plan, by its kind of test, and the checks that every plan passes; pure, nothing is sent anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import in_words
from pmabench.bench.compile import Mounted
from pmabench.files.document import Document, Location, check_schema, read_document, validate
from pmabench.files.quantity import parse_quantity
from pmabench.kinds import registry
from pmabench.protocol.common import Compilation, ProtocolHead
from pmabench.protocol.plan import Plan


def kind_class(name: str) -> type[ProtocolHead]:
    """The model of the protocol files of a kind; KeyError for an unknown one."""
    loaded: type[ProtocolHead] = registry.protocols()[name].part("protocol")
    return loaded


def read_protocol(path: Path, settings: Sequence[tuple[str, str]] = ()) -> tuple[Document, Any]:
    """The document and the model of a protocol file, with `--set` values put in."""
    document = read_document(path)
    for name, text in settings:
        document.override(name, text)
    check_schema(ProtocolHead, document)
    kind = document.data.get("kind")
    known = registry.protocols()
    if not isinstance(kind, str) or kind not in known:
        message = f'unknown kind of protocol "{kind}"{did_you_mean(str(kind), known)}' if kind else '"kind" is missing'
        raise InvalidFile([document.problem(("kind",), message)])
    return document, validate(kind_class(str(kind)), document)


def compile_protocol(document: Document, protocol: Any, mounted: Mounted) -> Plan:
    """The plan of a protocol on a bench with a specimen; raises `InvalidFile` with every problem."""
    c = Compilation(document, mounted, protocol)
    c.needs_bench()
    c.needs_coefficients()
    try:
        plan: Plan = protocol.compile(c)
    except InvalidFile as error:
        raise InvalidFile([*c.problems, *error.problems]) from None
    if not c.problems:
        c.problems += list(_beyond(plan, c))
    if c.problems:
        raise InvalidFile(c.problems)
    return plan


LONGEST = 30 * 86400.0
"""Longest plan [s]."""


def _beyond(plan: Plan, c: Compilation) -> list[Problem]:
    """What no located check found: a plan without end, and any step that could leave the active limits."""
    longest = plan.duration()[1]
    if longest > LONGEST:
        where = max(_times(c.document.data), key=lambda found: found[0], default=(0.0, ("sweep",)))[1]
        c.fault(
            where,
            f"the whole plan can take {in_words(longest)}; at most {in_words(LONGEST)} are allowed "
            "(this is the longest time in it; shorten it, or take fewer trials)",
        )
    for output, (low, high) in plan.commands().items():
        c.within(output, low, ("trial",))
        c.within(output, high, ("trial",))
    return []


def _times(data: Any, at: Location = ()) -> Iterator[tuple[float, Location]]:
    """Every time that is written in the protocol [s], with its place."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _times(value, (*at, key))
    elif isinstance(data, str):
        with suppress(ValueError):
            yield parse_quantity(data, "time"), at


def slower(plan: Plan, document: Document, mounted: Mounted) -> tuple[str, ...]:
    """A line for each device that cannot sample at the plan's rate, with the places of both rates."""
    lines = []
    for device in mounted.bench.devices:
        names = [channel.name for channel in device.channels if channel.name in plan.record]
        if names and 0 < device.fastest < plan.rate * (1 - 1e-9):
            most = f"{device.fastest:g} Hz"
            lines.append(
                f"{document.where(('sample_rate',))}  {plan.rate:g} Hz is more than {device.name} gives, {most} "
                f"({device.fastest_from}): {', '.join(names)} {'is' if len(names) == 1 else 'are'} recorded at {most}; "
                "ask for less, or raise its rate where the device can"
            )
    return tuple(lines)


def make_plan(path: Path, mounted: Mounted, settings: Sequence[tuple[str, str]] = ()) -> tuple[Plan, Document]:
    """Read and compile; the document goes into the run's snapshot."""
    document, protocol = read_protocol(path, settings)
    return compile_protocol(document, protocol, mounted), document
