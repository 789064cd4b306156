"""What catalogues and readers get of a publication: DataCite, CITATION.cff, Data Package, README; no file is read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from pmabench import __version__
from pmabench.report.document.provenance import benches, operators, specimens, when
from pmabench.report.publishing.about import LICENCES, Author
from pmabench.report.publishing.crate import CRATE, Contents, Item

TABLE = "coefficients.csv"
SUMS = "sha256sums.txt"
COLUMNS = {
    "kind": "kind of test",
    "symbol": "coefficient, as in the literature",
    "coordinate": "which term of a curve, where the coefficient is one",
    "value": "best estimate in the unit of the row; empty where none can be given",
    "low95": "lower end of the 95 % interval",
    "high95": "upper end of the 95 % interval",
    "unit": "SI unit of value and interval (UCUM)",
    "n": "number of trials behind it",
    "method": "how it was evaluated",
    "withheld": "whether the data contradict the form that the method assumes; then there is no value",
    "note": "reason or remark",
    "simulated": "whether the muscle was simulated",
}
"""Column of the table of coefficients -> what it is; others are coordinates of the operating point [SI]."""


def datacite(contents: Contents) -> dict[str, Any]:
    """Metadata by the schema of DataCite, version 4.5; without a DOI they lack it until the repository gives one."""
    about = contents.about
    name, url = LICENCES[about.licence]
    found: dict[str, Any] = {
        "creators": [_creator(author) for author in about.authors],
        "titles": [{"title": contents.title}],
        "publisher": {"name": about.publisher.name},
        "publicationYear": about.published[:4],
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Characterisation of a pneumatic muscle actuator"},
        "subjects": [{"subject": word} for word in contents.keywords],
        "dates": [{"date": about.published, "dateType": "Issued"}],
        "language": "en",
        "sizes": [f"{sum(item.size for item in contents.items)} bytes"],
        "formats": sorted({item.media for item in contents.items}),
        "version": "1",
        "rightsList": [{
            "rights": name, "rightsUri": url, "rightsIdentifier": about.licence, "rightsIdentifierScheme": "SPDX",
            "schemeUri": "https://spdx.org/licenses/",
        }],
        "descriptions": [{"description": contents.description, "descriptionType": "Abstract"}],
        "schemaVersion": "http://datacite.org/schema/kernel-4",
    }  # fmt: skip
    return ({"doi": about.doi} if about.doi else {}) | found


def _creator(author: Author) -> dict[str, Any]:
    found: dict[str, Any] = {"name": author.name, "nameType": "Personal"}
    found |= {"givenName": author.given, "familyName": author.family}
    if author.orcid:
        scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org"}
        found["nameIdentifiers"] = [{"nameIdentifier": f"https://orcid.org/{author.orcid}"} | scheme]
    if author.affiliation:
        found["affiliation"] = [{"name": author.affiliation.name}]
    return found


def citation_cff(contents: Contents) -> str:
    """How to cite it, as Citation File Format 1.2.0; each text as a quoted scalar, so that none is markup."""
    about, text = contents.about, json.JSONEncoder(ensure_ascii=False).encode
    lines = ["cff-version: 1.2.0", "message: If you use these data, please cite them as below.", "type: dataset"]
    lines += [f"title: {text(contents.title)}", f"abstract: {text(contents.description)}", "authors:"]
    for author in about.authors:
        lines += [f"  - family-names: {text(author.family)}", f"    given-names: {text(author.given)}"]
        lines += [f"    orcid: {text(f'https://orcid.org/{author.orcid}')}"] if author.orcid else []
        lines += [f"    affiliation: {text(author.affiliation.name)}"] if author.affiliation else []
    lines += [f"date-released: {text(about.published)}", f"license: {about.licence}", 'version: "1"', "keywords:"]
    lines += [f"  - {text(word)}" for word in contents.keywords]
    lines += [f"doi: {text(about.doi)}"] if about.doi else []
    return "\n".join(lines) + "\n"


def datapackage(contents: Contents, heads: Sequence[str]) -> dict[str, Any]:
    """A Data Package (Frictionless): the table of coefficients with its columns `heads`, each file with its hash."""
    name, url = LICENCES[contents.about.licence]
    return {
        "name": "pmabench-publication",
        "title": contents.title,
        "description": contents.description,
        "version": "1.0.0",
        "created": f"{contents.about.published}T00:00:00Z",
        "licenses": [{"name": contents.about.licence, "title": name, "path": url}],
        "contributors": [{"title": author.name, "role": "author"} for author in contents.about.authors],
        "keywords": list(contents.keywords),
        "resources": [_resource(n, item, heads) for n, item in enumerate(contents.items, 1)],
    }


def _resource(number: int, item: Item, heads: Sequence[str]) -> dict[str, Any]:
    found: dict[str, Any] = {"name": f"file-{number}", "path": item.path, "title": item.what, "mediatype": item.media}
    found |= {
        "type": "file",
        "format": item.path.rpartition(".")[2].lower(),
        "bytes": item.size,
        "hash": f"sha256:{item.sha256}",
    }
    if item.path != TABLE:
        return found
    fields = [
        {"name": head, "type": _type(head), "description": COLUMNS.get(head, "coordinate of the operating point")}
        for head in heads
    ]
    table = {"name": "coefficients", "type": "table", "profile": "tabular-data-resource", "encoding": "utf-8"}
    return found | table | {"schema": {"fields": fields, "missingValues": [""]}}


def _type(head: str) -> str:
    """What a column holds, as Table Schema names it; texts are the columns with a meaning, numbers all others."""
    named = {"withheld": "boolean", "simulated": "boolean", "n": "integer"}
    named |= dict.fromkeys(("value", "low95", "high95"), "number")
    return named.get(head, "string" if head in COLUMNS else "number")


def readme(contents: Contents) -> str:
    """For a person who opens the package without knowing pmabench."""
    about, runs = contents.about, [run for _, run in contents.runs]
    name, url = LICENCES[about.licence]
    by = "; ".join(author.name for author in about.authors)
    doi = f"\nhttps://doi.org/{about.doi}" if about.doi else ""
    lines = [
        f"# {contents.title}",
        "",
        contents.description,
        "",
        f"{by} ({about.published[:4]}). {about.publisher.name}.{doi}",
    ]
    lines += ["", f"Licence: {name} ({about.licence}), {url}", "", "## What was tested", ""]
    lines += [f"- specimen: {who}" + (f" ({what})" if what else "") for who, what in specimens(runs)]
    lines += [f"- bench: {who}" + (f" ({what})" if what else "") for who, what in benches(runs)]
    lines += [f"- tested: {when(runs)}" + (f", by {who}" if (who := operators(runs)) else "")]
    lines += ["", "## What is in it", ""]
    lines += [
        "- `report.html`: the certificate (first two pages) and its appendices; open it in a browser",
        f"- `{TABLE}`: every coefficient with its 95 % interval, SI",
        "- `analyses/`: one folder for each kind of test, with tables and the numbers behind the figures",
        "- `runs/`: the records as they were sealed at the bench; each has a README.txt that says how to read it",
        f"- `{CRATE}`, `datapackage.json`, `datacite.json`, `CITATION.cff`: the same for machines",
        f"- `{SUMS}`: check with `sha256sum -c {SUMS}`",
        "",
        f"Evaluated and put together with pmabench {__version__}; `pmabench process runs/*` computes it again.",
    ]
    return "\n".join(lines) + "\n"
