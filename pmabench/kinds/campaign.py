"""Campaigns: several protocols on one specimen, in order, each on a bench with the free end that it needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from pmabench.base.errors import InvalidFile, Problem
from pmabench.bench.compile import Mounted, mount
from pmabench.files.document import Document, Location, Strict, document_text, read_document, validate
from pmabench.files.shipped import find_file
from pmabench.kinds.compile import compile_protocol, read_protocol, slower
from pmabench.protocol.plan import Plan
from pmabench.protocol.sweep import long_ranges


class CampaignRun(Strict):
    """One run: a protocol, what is changed in it, and a bench other than the one for its free end."""

    protocol: str
    bench: str | None = None
    set: dict[str, str | int | float | list[str]] = {}


class CampaignFile(Strict):
    """A campaign; file names are relative to it, or names of shipped files."""

    schema_: Annotated[Literal["pmabench.campaign/1"], Field(alias="schema")]
    name: Annotated[str, Field(max_length=120)]
    specimen: str
    benches: dict[Literal["weights", "actuator"], str]
    runs: Annotated[list[CampaignRun], Field(min_length=1, max_length=200)]


@dataclass(frozen=True)
class PlannedRun:
    """A run of a campaign, checked."""

    plan: Plan
    mounted: Mounted
    protocol_text: str
    deviations: tuple[str, ...]
    """What the campaign changes in the protocol, in words."""
    sources: dict[str, Any] = field(default_factory=dict)
    """Absolute paths of protocol, bench and specimen, and what was `set`."""
    slower: tuple[str, ...] = ()
    """Devices that cannot sample at the plan's rate, a line each."""
    doubts: tuple[str, ...] = ()
    """What the files say that may be a mistake, a line each."""


def plan_campaign(path: Path) -> tuple[str, list[PlannedRun]]:
    """The campaign's name and its runs, all compiled; raises `InvalidFile` with every problem of every file."""
    document = read_document(path)
    campaign = validate(CampaignFile, document)
    problems: list[Problem] = []
    planned: list[PlannedRun] = []
    mounted: dict[str, Mounted] = {}
    for index, run in enumerate(campaign.runs):
        at: Location = ("runs", index)
        try:
            planned.append(_plan(path.parent, document, campaign, run, at, mounted))
        except InvalidFile as error:
            problems.extend(problem for problem in error.problems if problem not in problems)
    if problems:
        raise InvalidFile(problems)
    return campaign.name, planned


def _plan(
    folder: Path,
    document: Document,
    campaign: CampaignFile,
    run: CampaignRun,
    at: Location,
    mounted: dict[str, Mounted],
) -> PlannedRun:
    settings = [(name, _yaml(value)) for name, value in run.set.items()]
    protocol_path = _find(folder, "protocol", run.protocol)
    protocol_document, protocol = read_protocol(protocol_path, settings)
    bench = run.bench or campaign.benches.get(protocol.needs.free_end)
    if bench is None:
        message = f'names no bench whose free end is "{protocol.needs.free_end}", which "{run.protocol}" needs'
        raise InvalidFile([document.problem((*at, "protocol"), message)])
    paths = {"bench": _find(folder, "bench", bench), "specimen": _find(folder, "specimen", campaign.specimen)}
    if bench not in mounted:
        mounted[bench] = mount(paths["bench"], paths["specimen"])
    plan = compile_protocol(protocol_document, protocol, mounted[bench])
    text = document_text(protocol_document)
    sources: dict[str, Any] = {
        kind: str(path.resolve()) for kind, path in (("protocol", protocol_path), *paths.items())
    }
    sources["set"] = [list(pair) for pair in settings]
    deviations = tuple(f"{name} set to {value}" for name, value in settings)
    late = slower(plan, protocol_document, mounted[bench])
    doubts = (*long_ranges(getattr(protocol, "sweep", None), protocol_document), *mounted[bench].doubts)
    return PlannedRun(plan, mounted[bench], text, deviations, sources, late, doubts)


def _find(folder: Path, kind: str, name: str) -> Path:
    return folder / name if (folder / name).is_file() else find_file(kind, name)


def _yaml(value: str | float | list[str]) -> str:
    return "[" + ", ".join(value) + "]" if isinstance(value, list) else str(value)
