"""The RO-Crate 1.1 of a publication: what each file is, on what and with what it was measured, where numbers come from.

https://www.researchobject.org/ro-crate/specification/1.1/. Manifests are untrusted; what is missing there is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
    about = contents.about
    name, url = LICENCES[about.licence]
    values = [_value(n, a, e) for a in contents.analyses for n, e in enumerate(a[1].estimates) if e.value is not None]
    actions = [*(_recording(folder, run) for folder, run in contents.runs), _processing(contents)]
    root = {
        "@id": "./", "@type": "Dataset", "name": contents.title, "description": contents.description,
        "datePublished": about.published, "license": {"@id": url}, "keywords": ", ".join(contents.keywords),
        "author": [{"@id": _person(n, author.orcid)} for n, author in enumerate(about.authors)],
        "publisher": {"@id": _place(about.publisher)}, "variableMeasured": _ids(value for value, _ in values),
        "mentions": _ids(actions), "about": _ids(_specimens(contents.runs)),
        "hasPart": [*({"@id": f"{quote(folder)}/"} for folder, _ in _folders(contents)),
                    *({"@id": quote(item.path)} for item in contents.items if not _folder_of(item, contents))],
    }  # fmt: skip
    if about.doi:
        root["identifier"] = f"https://doi.org/{about.doi}"
    descriptor = {
        "@id": CRATE, "@type": "CreativeWork", "about": {"@id": "./"}, "sdPublisher": {"@id": SOFTWARE},
        "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"}, "license": {"@id": url},
    }  # fmt: skip
    licence: Node = {"@id": url, "@type": "CreativeWork", "name": name, "identifier": about.licence}
    licence["description"] = f"{name} ({about.licence}); its text is at {url}"
    graph: list[Node] = [
        descriptor, root, licence, *_people(contents), *_parts(contents), _software(), *_specimens(contents.runs),
        *_devices(contents.runs), *actions, *(node for pair in values for node in pair if node),
    ]  # fmt: skip
    unique = {node["@id"]: node for node in graph}
    context: list[Any] = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "http://schema.org/sha256"}]
    return {"@context": context, "@graph": list(unique.values())}


def _ids(nodes: Iterable[Node]) -> list[Node]:
    return [{"@id": node["@id"]} for node in nodes]


def _person(number: int, orcid: str) -> str:
    return f"https://orcid.org/{orcid}" if orcid else f"#author-{number + 1}"


def _people(contents: Contents) -> list[Node]:
    """Authors, operators, the publisher and where authors work."""
    about, nodes = contents.about, []
    places = dict.fromkeys([about.publisher, *(author.affiliation for author in about.authors if author.affiliation)])
    for n, author in enumerate(about.authors):
        node: Node = {"@id": _person(n, author.orcid), "@type": "Person", "name": f"{author.given} {author.family}"}
        node |= {"givenName": author.given, "familyName": author.family}
        if author.affiliation:
            node["affiliation"] = {"@id": _place(author.affiliation)}
        nodes.append(node)
    for place in places:
        node = {"@id": _place(place), "@type": "Organization", "name": place.name}
        nodes.append(node | ({"url": place.url} if place.url else {}))
    operators = {text_of(run.manifest.get("operator")) for _, run in contents.runs} - {""}
    return nodes + [{"@id": _operator(name), "@type": "Person", "name": name} for name in sorted(operators)]


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


def _parts(contents: Contents) -> list[Node]:
    nodes: list[Node] = [
        {
            "@id": f"{quote(folder)}/", "@type": "Dataset", "name": what, "description": what,
            "hasPart": [{"@id": quote(i.path)} for i in contents.items if _folder_of(i, contents) == folder],
        }
        for folder, what in _folders(contents)
    ]  # fmt: skip
    for item in contents.items:
        node = {"@id": quote(item.path), "@type": "File", "name": item.path, "description": item.what}
        node |= {"encodingFormat": item.media, "contentSize": str(item.size), "sha256": item.sha256}
        nodes.append(node)
    return nodes


def _software() -> Node:
    what = "Bench data acquisition and evaluation for pneumatic muscle actuators"
    node = {"@id": SOFTWARE, "@type": "SoftwareApplication", "name": "pmabench", "softwareVersion": __version__}
    return node | {"version": __version__, "description": what}


def _specimen_id(run: RunData) -> str:
    return "#specimen-" + quote(text_of(get(run.manifest, "specimen", "serial")) or "unnamed", safe="")


def _specimens(runs: Iterable[tuple[str, RunData]]) -> list[Node]:
    nodes: dict[str, Node] = {}
    for _, run in runs:
        about = run.manifest.get("specimen")
        words = {key: text_of(get(about, key)) for key in ("make", "type", "serial")}
        node: Node = {"@id": _specimen_id(run), "@type": "IndividualProduct"}
        node["name"] = " ".join(word for word in words.values() if word) or "specimen"
        node |= {key: words[of] for key, of in (("model", "type"), ("serialNumber", "serial")) if words[of]}
        sizes = [("nominal length", "nominal_length", "m"), ("inner diameter", "inner_diameter", "m"),
                 ("braid angle", "braid_angle", "rad"), ("cycles before these runs", "cycles_before", "1")]  # fmt: skip
        node["additionalProperty"] = [
            {"@type": "PropertyValue", "@id": f"{node['@id']}-{key}", "name": name, "value": value, "unitCode": unit}
            for name, key, unit in sizes
            if is_number(value := get(about, key))
        ]
        nodes.setdefault(node["@id"], node)
    return _flat(nodes.values())


def _flat(nodes: Iterable[Node]) -> list[Node]:
    """Entities with their properties as entities next to them, as a crate wants it."""
    found: list[Node] = []
    for node in nodes:
        inner = node.pop("additionalProperty", [])
        found.append(node | ({"additionalProperty": _ids(inner)} if inner else {}))
        found += inner
    return found


def _devices(runs: Sequence[tuple[str, RunData]]) -> list[Node]:
    """The bench with its channels' calibrations, and its devices."""
    nodes: list[Node] = []
    names = "; ".join(name for name, _ in benches([run for _, run in runs])) or "bench"
    properties: dict[str, Node] = {}
    for _, run in runs:
        for info in run.channels.values():
            unit = QUANTITIES[info.quantity].unit if info.quantity in QUANTITIES else ""
            text = f"{clean(info.calibration, 80) or 'none'}; 95 %: offset {info.offset_uncertainty:.3g} {unit}"
            text += f", gain {info.gain_uncertainty:.3g}"
            key = f"#calibration-{quote(clean(info.name, 60), safe='')}-{quote(clean(info.calibration, 80), safe='')}"
            node = {"@id": key, "@type": "PropertyValue", "name": f"calibration of {clean(info.name, 60)}"}
            properties.setdefault(key, node | {"value": text})
        devices = run.manifest.get("devices")
        for name, device in devices.items() if isinstance(devices, Mapping) else ():
            node = {"@id": f"#device-{quote(clean(name, 60), safe='')}", "@type": "IndividualProduct"}
            words = {key: text_of(get(device, key), 80) for key in ("maker", "model", "serial", "firmware")}
            node["name"] = f"{words['maker']} {words['model']}".strip() or clean(name, 60)
            node |= {key: words[of] for key, of in (("model", "model"), ("serialNumber", "serial")) if words[of]}
            node["description"] = f"device of the bench, firmware {words['firmware'] or 'not known'}"
            nodes.append(node | {"isRelatedTo": {"@id": BENCH}})
    bench = {"@id": BENCH, "@type": "IndividualProduct", "name": names}
    return [*_flat([bench | {"additionalProperty": list(properties.values())}]), *nodes]


def _recording(folder: str, run: RunData) -> Node:
    done = run.status in {"finished", "failed"}
    node: Node = {
        "@id": f"#recording-{quote(run.id, safe='')}", "@type": "CreateAction", "name": f"Recording of {run.id}",
        "description": f"{kind_title(run.kind)}; the run is {clean(run.status, 40)}", "instrument": {"@id": BENCH},
        "object": {"@id": _specimen_id(run)}, "result": {"@id": f"{quote(folder)}/"},
        "actionStatus": {"@id": f"http://schema.org/{'Completed' if done else 'Failed'}ActionStatus"},
    }  # fmt: skip
    for key, entry in (("startTime", "started_utc"), ("endTime", "closed_utc")):
        if text := text_of(run.manifest.get(entry), 40):
            node[key] = text
    if name := text_of(run.manifest.get("operator")):
        node["agent"] = {"@id": _operator(name)}
    return node


def _processing(contents: Contents) -> Node:
    return {
        "@id": "#processing", "@type": "CreateAction", "name": "Evaluation of the runs",
        "description": "Coefficients with their 95 % intervals, and the report",
        "endTime": contents.about.published, "instrument": {"@id": SOFTWARE},
        "agent": {"@id": _person(0, contents.about.authors[0].orcid)},
        "object": [{"@id": f"{quote(folder)}/"} for folder, _ in contents.runs],
        "result": [{"@id": f"{quote(folder)}/"} for folder, _ in contents.analyses],
        "actionStatus": {"@id": "http://schema.org/CompletedActionStatus"},
    }  # fmt: skip


def _value(number: int, of: tuple[str, Analysis], e: Estimate) -> tuple[Node, Node | None]:
    """A coefficient [SI], and where it was measured."""
    folder, analysis = of
    key = f"#{quote(folder.rpartition('/')[2], safe='')}-{number + 1}"
    node: Node = {"@id": key, "@type": "PropertyValue", "value": e.value, "unitText": e.unit, "unitCode": e.unit}
    node["name"] = f"{clean(e.symbol, 40)} {clean(e.coordinate, 40)}".strip()
    node["description"] = kind_title(analysis.kind) + (" (simulated)" if analysis.simulated else "")
    node["measurementTechnique"] = clean(e.method, 120)
    if e.ci95:
        node |= {"minValue": e.ci95[0], "maxValue": e.ci95[1]}
    where = [(name, value, QUANTITIES[POINT_QUANTITIES[name]].unit) for name, value in e.at.items()
             if name in POINT_QUANTITIES]  # fmt: skip
    if not where:
        return node, None
    name, value, unit = next((place for place in where if place[0] == "pressure"), where[0])
    point = {"@id": f"#{name}-{value:.12g}", "@type": "PropertyValue", "name": name, "value": value}
    return node | {"valueReference": {"@id": point["@id"]}}, point | {"unitText": unit, "unitCode": unit}
