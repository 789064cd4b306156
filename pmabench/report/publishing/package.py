"""Puts a publication together: a folder or a zip with records, analyses, report and what describes them; fits nothing.

What catalogues and readers get of it: DataCite, CITATION.cff, Data Package, README.

The same runs, analyses and facts about the publication give the same bytes. Records are copied as they are and checked
before; what somebody else put into their folders stays out.
"""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pmabench import __version__
from pmabench.base.errors import UsageError, invalid
from pmabench.notebook import estimates_frame
from pmabench.report.document.provenance import benches, operators, specimens, when
from pmabench.report.files.csv_files import csv_text, write_with_tables
from pmabench.report.publishing.about import LICENCES, About, Author
from pmabench.report.publishing.crate import CRATE, Contents, Item, crate_of
from pmabench.report.words import kind_title
from pmabench.report.writing import write_file, writing
from pmabench.store.analyses.folder import file_names, in_lines
from pmabench.store.analyses.results import Analysis
from pmabench.store.catalogue import chain_of
from pmabench.store.folder import files_of, read_manifest, sha256_of
from pmabench.store.records import RunData
from pmabench.store.since import late_folder
from pmabench.store.verify import verify

TABLE = "coefficients.csv"
SUMS = "sha256sums.txt"
MEDIA = {
    ".csv": "text/csv", ".json": "application/json", ".jsonl": "application/jsonl", ".html": "text/html",
    ".md": "text/markdown", ".txt": "text/plain", ".yaml": "application/yaml", ".cff": "application/yaml",
    ".parquet": "application/vnd.apache.parquet", ".png": "image/png", ".jpg": "image/jpeg", ".pdf": "application/pdf",
}  # fmt: skip
WHAT = {
    "report.html": "Report: a certificate of two pages, and appendices", TABLE: "Coefficients with 95 % intervals, SI",
    "README.md": "What is in this publication", "CITATION.cff": "How to cite it", "datacite.json": "DataCite 4.5",
    "datapackage.json": "Data Package",
}  # fmt: skip
WHAT_IN_A_RUN = {
    "manifest.json": "what was tested, when, with which versions", "plan.json": "the plan",
    "seal.json": "status and hashes", "events.jsonl": "commands, trials, findings",
    "README.txt": "how to read the record", "bench.yaml": "bench file", "specimen.yaml": "specimen file",
    "protocol.yaml": "protocol file",
}  # fmt: skip
YEAR_0 = (1980, 1, 1, 0, 0, 0)
"""Time of each entry of a zip, so that the same content gives the same bytes."""


def publish(analyses: Sequence[Analysis], runs: Sequence[RunData], report: str, about: About, out: Path) -> Path:
    """Write the publication as the folder `out`, or as a file where it ends in `.zip`; `report` is the report's page.

    UsageError where `out` is there already or a run is not at hand, InvalidFile for a record that is damaged or open,
    RecordError where it cannot be written.
    """
    if out.exists():
        raise UsageError(f"{out} is there already: a publication is not mixed with other files; give a new name")
    lacking = ", ".join(sorted({run for a in analyses for run in a.runs} - {run.id for run in runs}))
    if lacking or not runs:
        raise UsageError(f"the records of {lacking or 'the analyses'} are not at hand: name the runs")
    with writing(out, "the publication"):
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".publish-", dir=out.parent) as place:
            folder = Path(place) / out.stem
            _fill(folder, analyses, runs, report, about)
            if out.suffix.lower() == ".zip":
                whole = Path(place) / "whole"
                _zip(folder, whole)
                whole.replace(out)
            else:
                folder.replace(out)
    return out


def _fill(folder: Path, analyses: Sequence[Analysis], runs: Sequence[RunData], report: str, about: About) -> None:
    unique = {run.id: run for run in runs}
    places = [f"runs/{run_id}" for run_id in unique]
    for path in {part.resolve() for run in unique.values() for part in chain_of(Path(run.path))}:
        _copy(path, folder / "runs" / str(read_manifest(path)["id"]))
    names = [f"analyses/{name}" for name in file_names([analysis.kind for analysis in analyses])]
    for name, analysis in zip(names, analyses, strict=True):
        write_with_tables(analysis, folder / name)
    write_file(folder / "report.html", report, "the publication")
    frame = estimates_frame(analyses).drop(columns="trials", errors="ignore")
    heads = [str(head) for head in frame.columns]
    rows: list[dict[str, Any]] = [
        dict(zip(heads, row, strict=True)) for row in frame.itertuples(index=False, name=None)
    ]
    for row in rows:
        row |= {name: str(bool(row[name])).lower() for name in ("withheld", "simulated")}
    write_file(folder / TABLE, csv_text(rows, heads), "the publication")
    contents = _described(analyses, list(unique.values()), about)
    named = zip(names, analyses, strict=True)
    recorded = tuple(zip(places, unique.values(), strict=True))
    contents = replace(contents, analyses=tuple(named), runs=recorded, items=_items(folder))
    texts = {"README.md": readme(contents), "CITATION.cff": citation_cff(contents)}
    texts |= {"datacite.json": in_lines(datacite(contents)), "datapackage.json": in_lines(datapackage(contents, heads))}
    for name, text in texts.items():
        write_file(folder / name, text, "the publication")
    write_file(folder / CRATE, in_lines(crate_of(replace(contents, items=_items(folder)))), "the publication")
    sums = [f"{sha256_of(path)}  {name}\n" for name, path in files_of(folder)]
    write_file(folder / SUMS, "".join(sums), "the publication")


def _described(analyses: Sequence[Analysis], runs: Sequence[RunData], about: About) -> Contents:
    """Title, description and keywords, made of the specimen and the tests."""
    simulated = [run.simulated for run in runs] + [a.simulated for a in analyses]
    who = "; ".join(name for name, _ in specimens(runs)) or "a pneumatic muscle"
    kinds = list(dict.fromkeys(kind_title(run.kind).lower() for run in runs))
    word = "SIMULATED: no real muscle moved. " if all(simulated) else "PARTLY SIMULATED. " if any(simulated) else ""
    what = f"Characterisation of {who}: {', '.join(kinds)}. Sealed records of {len(runs)} "
    what += f"{'run' if len(runs) == 1 else 'runs'}, coefficients with 95 % intervals, and the report."
    title = about.title or f"Characterisation of {who}" + (" (simulated)" if any(simulated) else "")
    keywords = ("pneumatic muscle actuator", *kinds, *(["simulated"] if any(simulated) else []))
    return Contents(about, title, word + what, keywords, (), (), ())


def _copy(run: Path, target: Path) -> None:
    """A record with its notes, and what came late for it; raises InvalidFile where it is not as it was sealed."""
    found = verify(run)
    if damage := [str(finding) for finding in found if not finding.added]:
        raise invalid(run, f"is not a whole, closed record ({damage[0]}); see pmabench runs verify")
    strange = {finding.file for finding in found if finding.added}
    for name, path in files_of(run):
        if not any(name == other or name.startswith(f"{other.rstrip('/')}/") for other in strange):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target / name, follow_symlinks=False)
    late = late_folder(run)
    if late.is_dir() and not late.is_symlink():
        shutil.copytree(late, target.with_name(target.name + late.name.removeprefix(run.name)), symlinks=True)


def _items(folder: Path) -> tuple[Item, ...]:
    media = {name: MEDIA.get(path.suffix, "application/octet-stream") for name, path in files_of(folder)}
    return tuple(
        Item(name, _what(name), sha256_of(path), path.stat().st_size, media[name]) for name, path in files_of(folder)
    )


def _what(name: str) -> str:
    top, _, rest = name.partition("/")
    end = rest.partition("/")[2]
    if top == "runs":
        part = "calibration" if end.startswith("calibrations/") else "samples" if end.startswith("streams/") else ""
        return f"Record: {WHAT_IN_A_RUN.get(end, part or 'part of the run')}"
    if top == "analyses":
        return f"Analysis: {'numbers of a figure' if '/traces/' in name else end.partition('.')[0]}"
    return WHAT.get(name, name)


def _zip(folder: Path, path: Path) -> None:
    """Zip a folder under its name: entries in order and without times, so that the same files give the same bytes."""
    with zipfile.ZipFile(path, "w") as file:
        for name, source in files_of(folder):
            entry = zipfile.ZipInfo(f"{folder.name}/{name}", YEAR_0)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            file.writestr(entry, source.read_bytes())


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
    found |= {"type": "file", "format": item.path.rpartition(".")[2].lower()}
    found |= {"bytes": item.size, "hash": f"sha256:{item.sha256}"}
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
    return named.get(head, "string" if head in {*COLUMNS} - {"value", "low95", "high95"} else "number")


def readme(contents: Contents) -> str:
    """For a person who opens the package without knowing pmabench."""
    about, runs = contents.about, [run for _, run in contents.runs]
    name, url = LICENCES[about.licence]
    by = "; ".join(author.name for author in about.authors)
    doi = f"\nhttps://doi.org/{about.doi}" if about.doi else ""
    lines = [f"# {contents.title}", "", contents.description, ""]
    lines += [f"{by} ({about.published[:4]}). {about.publisher.name}.{doi}"]
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
