"""Protocol files to plans, one alone or the several of a campaign, and the checks that every plan passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import in_words
from pmabench.bench.compile import Mounted, mount
from pmabench.files.document import Document, Location, Strict, check_schema, document_text, read_document, validate
from pmabench.files.shipped import find_file
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
        _check_whole(plan, c)
    if c.problems:
        raise InvalidFile(c.problems)
    return plan


LONGEST = 30 * 86400.0
"""Longest plan [s]."""


def _check_whole(plan: Plan, c: Compilation) -> None:
    """Checks that have no place in the file: a plan without end, and steps that could leave the active limits."""
    longest = plan.duration()[1]
    if longest > LONGEST:
        text = f"the whole plan can take {in_words(longest)}; at most {in_words(LONGEST)} are allowed"
        c.fault(("sweep",), f"{text}: shorten its times, or take fewer trials")
    for output, (low, high) in plan.commands().items():
        c.within(output, low, ("trial",))
        c.within(output, high, ("trial",))


def slower(plan: Plan, document: Document, mounted: Mounted) -> tuple[str, ...]:
    """A line for each device that cannot sample at the plan's rate, with where each rate is set."""
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
    """Read and compile; the document is kept for the run's snapshot."""
    document, protocol = read_protocol(path, settings)
    return compile_protocol(document, protocol, mounted), document


class CampaignRun(Strict):
    """One run: a protocol, changed settings, and its bench unless it is the one for the protocol's free end."""

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
    """A run to come, checked: a plan with the bench and specimen that it is for."""

    plan: Plan
    mounted: Mounted
    protocol_text: str
    deviations: tuple[str, ...]
    """Changes made to the protocol for this run, in words."""
    sources: dict[str, Any] = field(default_factory=dict)
    """Absolute paths of protocol, bench and specimen, and the values of `set`, to go on later."""
    slower: tuple[str, ...] = ()
    """Devices that cannot sample at the plan's rate, a line each."""
    doubts: tuple[str, ...] = ()
    """Possible mistakes in the files, a line each."""

    def warnings(self) -> list[str]:
        """What people must know before anything moves, a line each."""
        hazards = [f"HAZARD: {hazard}" for hazard in self.plan.hazards]
        return [*hazards, *(f"this bench has {lack}" for lack in self.mounted.lacks), *self.slower, *self.doubts]


def planned_run(
    paths: Mapping[str, Path],
    document: Document,
    protocol: Any,
    mounted: Mounted,
    settings: Sequence[tuple[str, str]],
) -> PlannedRun:
    """A protocol with changed settings on a bench with a specimen, compiled; `paths` of the three files by kind."""
    plan = compile_protocol(document, protocol, mounted)
    sources: dict[str, Any] = {kind: str(path.resolve()) for kind, path in paths.items()}
    sources["set"] = [list(pair) for pair in settings]
    deviations = tuple(f"{name} set to {value}" for name, value in settings)
    late = slower(plan, document, mounted)
    return PlannedRun(plan, mounted, document_text(document), deviations, sources, late, mounted.doubts)


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
    lists = {name: f"[{', '.join(value)}]" for name, value in run.set.items() if isinstance(value, list)}
    settings = [(name, lists.get(name, str(value))) for name, value in run.set.items()]
    protocol_path = _find(folder, "protocol", run.protocol)
    protocol_document, protocol = read_protocol(protocol_path, settings)
    bench = run.bench or campaign.benches.get(protocol.needs.free_end)
    if bench is None:
        message = f'names no bench whose free end is "{protocol.needs.free_end}", which "{run.protocol}" needs'
        raise InvalidFile([document.problem((*at, "protocol"), message)])
    paths = {"bench": _find(folder, "bench", bench), "specimen": _find(folder, "specimen", campaign.specimen)}
    if bench not in mounted:
        mounted[bench] = mount(paths["bench"], paths["specimen"])
    return planned_run({"protocol": protocol_path} | paths, protocol_document, protocol, mounted[bench], settings)


def _find(folder: Path, kind: str, name: str) -> Path:
    return folder / name if (folder / name).is_file() else find_file(kind, name)
