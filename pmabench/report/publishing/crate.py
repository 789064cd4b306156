"""The RO-Crate 1.1 of a publication: what each file is, on what and with what it was measured, where numbers come from.

https://www.researchobject.org/ro-crate/specification/1.1/. Manifests are untrusted; what is missing there is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from pmabench import __version__
from pmabench.base.quantities import QUANTITIES
from pmabench.plotting.wording import clean
from pmabench.report.document.provenance import benches, get, text_of
from pmabench.report.publishing.about import LICENCES, About, Place
from pmabench.report.words import kind_title
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Estimate
from pmabench.store.records import RunData, is_number

CRATE = "ro-crate-metadata.json"
SOFTWARE, BENCH = "#pmabench", "#bench"
Node = dict[str, Any]


@dataclass(frozen=True)
class Item:
    """A file of a publication."""

    path: str
    """From the folder of the publication, with `/`."""
    what: str
    sha256: str
    size: int
    """[bytes]"""
    media: str


@dataclass(frozen=True)
class Contents:
    """What a publication holds."""

    about: About
    title: str
    description: str
    keywords: tuple[str, ...]
    analyses: tuple[tuple[str, Analysis], ...]
    """With their folders."""
    runs: tuple[tuple[str, RunData], ...]
    """With their folders."""
    items: tuple[Item, ...]


def crate_of(contents: Contents) -> Node:
    """The content of `ro-crate-metadata.json`; the same contents give the same graph."""
    about, (name, url) = contents.about, LICENCES[contents.about.licence]
    values = [_value(n, a, e) for a in contents.analyses for n, e in enumerate(a[1].estimates) if e.value is not None]
    actions = [*(_recording(folder, run) for folder, run in contents.runs), _processing(contents)]
    specimens = _specimens(contents.runs)
    alone = [_ref(quote(item.path)) for item in contents.items if not _folder_of(item, contents)]
    root = _node(
        "./", "Dataset", name=contents.title, description=contents.description, datePublished=about.published,
        license=_ref(url), keywords=", ".join(contents.keywords), publisher=_ref(_place(about.publisher)),
        author=[_ref(_person(n, author.orcid)) for n, author in enumerate(about.authors)],
        variableMeasured=_ids(value for value, _ in values), mentions=_ids(actions), about=_ids(specimens),
        hasPart=[*(_ref(f"{quote(folder)}/") for folder, _ in _folders(contents)), *alone],
        identifier=about.doi and f"https://doi.org/{about.doi}",
    )  # fmt: skip
    descriptor = _node(
        CRATE, "CreativeWork", about=_ref("./"), sdPublisher=_ref(SOFTWARE), license=_ref(url),
        conformsTo=_ref("https://w3id.org/ro/crate/1.1"),
    )  # fmt: skip
    text = f"{name} ({about.licence}); its text is at {url}"
    licence = _node(url, "CreativeWork", name=name, identifier=about.licence, description=text)
    what = "Bench data acquisition and evaluation for pneumatic muscle actuators"
    software = _node(SOFTWARE, "SoftwareApplication", name="pmabench", softwareVersion=__version__,
                     version=__version__, description=what)  # fmt: skip
    graph: list[Node] = [
        descriptor, root, licence, *_people(contents), *_parts(contents), software, *specimens,
        *_devices(contents.runs), *actions, *(node for pair in values for node in pair if node),
    ]  # fmt: skip
    unique = {node["@id"]: node for node in graph}
    context: list[Any] = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "http://schema.org/sha256"}]
    return {"@context": context, "@graph": list(unique.values())}


def _node(key: str, kind: str, **entries: Any) -> Node:
    """An entity of the graph, without entries that say nothing."""
    return {"@id": key, "@type": kind} | {name: value for name, value in entries.items() if value not in ("", None)}


def _ref(key: str) -> Node:
    return {"@id": key}


def _ids(nodes: Iterable[Node]) -> list[Node]:
    return [_ref(node["@id"]) for node in nodes]


def _person(number: int, orcid: str) -> str:
    return f"https://orcid.org/{orcid}" if orcid else f"#author-{number + 1}"


def _people(contents: Contents) -> list[Node]:
    """Authors, operators, the publisher and where authors work."""
    about = contents.about
    places = dict.fromkeys([about.publisher, *(author.affiliation for author in about.authors if author.affiliation)])
    operators = {text_of(run.manifest.get("operator")) for _, run in contents.runs} - {""}
    return [
        *(
            _node(_person(n, author.orcid), "Person", name=f"{author.given} {author.family}", givenName=author.given,
                  familyName=author.family, affiliation=author.affiliation and _ref(_place(author.affiliation)))
            for n, author in enumerate(about.authors)
        ),
        *(_node(_place(place), "Organization", name=place.name, url=place.url) for place in places),
        *(_node(_operator(name), "Person", name=name) for name in sorted(operators)),
    ]  # fmt: skip


def _place(place: Place) -> str:
    return place.url or f"#place-{quote(place.name, safe='')}"


def _operator(name: str) -> str:
    return f"#operator-{quote(name, safe='')}"


def _folders(contents: Contents) -> list[tuple[str, str]]:
    """Folders that are data sets themselves, with what they are."""
    runs = [(folder, f"Record of a run, {kind_title(run.kind).lower()}: {run.id}") for folder, run in contents.runs]
    return runs + [(folder, f"Analysis, {kind_title(a.kind).lower()}") for folder, a in contents.analyses]


def _folder_of(item: Item, contents: Contents) -> str:
    return next((folder for folder, _ in _folders(contents) if item.path.startswith(f"{folder}/")), "")


def _parts(contents: Contents) -> Iterator[Node]:
    for folder, what in _folders(contents):
        parts = [_ref(quote(item.path)) for item in contents.items if _folder_of(item, contents) == folder]
        yield _node(f"{quote(folder)}/", "Dataset", name=what, description=what, hasPart=parts)
    for item in contents.items:
        yield _node(quote(item.path), "File", name=item.path, description=item.what, encodingFormat=item.media,
                    contentSize=str(item.size), sha256=item.sha256)  # fmt: skip


def _specimen_id(run: RunData) -> str:
    return "#specimen-" + quote(text_of(get(run.manifest, "specimen", "serial")) or "unnamed", safe="")


SIZES = (
    ("nominal length", "nominal_length", "m"), ("inner diameter", "inner_diameter", "m"),
    ("braid angle", "braid_angle", "rad"), ("cycles before these runs", "cycles_before", "1"),
)  # fmt: skip
"""Name, entry of the specimen in a manifest, and unit."""


def _specimens(runs: Iterable[tuple[str, RunData]]) -> list[Node]:
    """Each specimen once, with its sizes as entities next to it, as a crate wants it."""
    nodes: dict[str, list[Node]] = {}
    for _, run in runs:
        about, key = run.manifest.get("specimen"), _specimen_id(run)
        words = [text_of(get(about, name)) for name in ("make", "type", "serial")]
        sizes = [
            _node(f"{key}-{entry}", "PropertyValue", name=name, value=value, unitCode=unit)
            for name, entry, unit in SIZES
            if is_number(value := get(about, entry))
        ]
        name = " ".join(filter(None, words)) or "specimen"
        nodes.setdefault(key, _product(key, name, sizes, model=words[1], serialNumber=words[2]))
    return [node for each in nodes.values() for node in each]


def _product(key: str, name: str, properties: Sequence[Node], **entries: Any) -> list[Node]:
    """A thing, and its properties."""
    own = _ids(properties) or None
    return [_node(key, "IndividualProduct", name=name, additionalProperty=own, **entries), *properties]


def _devices(runs: Sequence[tuple[str, RunData]]) -> list[Node]:
    """The bench with its channels' calibrations, and its devices."""
    nodes: list[Node] = []
    properties: dict[str, Node] = {}
    for _, run in runs:
        for info in run.channels.values():
            unit = QUANTITIES[info.quantity].unit if info.quantity in QUANTITIES else ""
            text = f"{clean(info.calibration, 80) or 'none'}; 95 %: offset {info.offset_uncertainty:.3g} {unit}"
            text += f", gain {info.gain_uncertainty:.3g}"
            key = f"#calibration-{quote(clean(info.name, 60), safe='')}-{quote(clean(info.calibration, 80), safe='')}"
            name = f"calibration of {clean(info.name, 60)}"
            properties.setdefault(key, _node(key, "PropertyValue", name=name, value=text))
        devices = run.manifest.get("devices")
        for name, device in devices.items() if isinstance(devices, Mapping) else ():
            maker, model, serial, firmware = (
                text_of(get(device, entry), 80) for entry in ("maker", "model", "serial", "firmware")
            )
            nodes += _product(
                f"#device-{quote(clean(name, 60), safe='')}", f"{maker} {model}".strip() or clean(name, 60), (),
                model=model, serialNumber=serial, isRelatedTo=_ref(BENCH),
                description=f"device of the bench, firmware {firmware or 'not known'}",
            )  # fmt: skip
    names = "; ".join(name for name, _ in benches([run for _, run in runs])) or "bench"
    return [*_product(BENCH, names, list(properties.values())), *nodes]


def _recording(folder: str, run: RunData) -> Node:
    done = run.status in {"finished", "failed"}
    begun, closed = (text_of(run.manifest.get(entry), 40) for entry in ("started_utc", "closed_utc"))
    operator = text_of(run.manifest.get("operator"))
    return _node(
        f"#recording-{quote(run.id, safe='')}", "CreateAction", name=f"Recording of {run.id}", instrument=_ref(BENCH),
        description=f"{kind_title(run.kind)}; the run is {clean(run.status, 40)}", object=_ref(_specimen_id(run)),
        result=_ref(f"{quote(folder)}/"), startTime=begun, endTime=closed,
        agent=_ref(_operator(operator)) if operator else None,
        actionStatus=_ref(f"http://schema.org/{'Completed' if done else 'Failed'}ActionStatus"),
    )  # fmt: skip


def _processing(contents: Contents) -> Node:
    return _node(
        "#processing", "CreateAction", name="Evaluation of the runs", instrument=_ref(SOFTWARE),
        description="Coefficients with their 95 % intervals, and the report", endTime=contents.about.published,
        agent=_ref(_person(0, contents.about.authors[0].orcid)),
        object=[_ref(f"{quote(folder)}/") for folder, _ in contents.runs],
        result=[_ref(f"{quote(folder)}/") for folder, _ in contents.analyses],
        actionStatus=_ref("http://schema.org/CompletedActionStatus"),
    )  # fmt: skip


def _value(number: int, of: tuple[str, Analysis], e: Estimate) -> tuple[Node, Node | None]:
    """A coefficient [SI], and where it was measured."""
    folder, analysis = of
    known = [name for name in e.at if name in POINT_QUANTITIES]
    point = None
    if known:
        name = "pressure" if "pressure" in known else known[0]
        unit = QUANTITIES[POINT_QUANTITIES[name]].unit
        point = _node(f"#{name}-{e.at[name]:.12g}", "PropertyValue", name=name, value=e.at[name], unitText=unit,
                      unitCode=unit)  # fmt: skip
    low, high = e.ci95 or (None, None)
    node = _node(
        f"#{quote(folder.rpartition('/')[2], safe='')}-{number + 1}", "PropertyValue", value=e.value, unitText=e.unit,
        unitCode=e.unit, name=f"{clean(e.symbol, 40)} {clean(e.coordinate, 40)}".strip(), minValue=low, maxValue=high,
        description=kind_title(analysis.kind) + (" (simulated)" if analysis.simulated else ""),
        measurementTechnique=clean(e.method, 120), valueReference=point and _ref(point["@id"]),
    )  # fmt: skip
    return node, point
