"""A publication is complete and says what it must, as a reader finds it who knows only the published formats.

Rules: RO-Crate 1.1 (root data entity, contextual entities), DataCite 4.5 (mandatory properties), Citation File Format
1.2.0 (required keys), Data Package v1 (resources with hash and bytes). Nothing of pmabench reads the package here.
"""

import csv
import hashlib
import json
import re
import shutil
import zipfile
from urllib.parse import unquote

import pytest
from ruamel.yaml import YAML

from tests.benchmarks.archive import stiffness_and_damping, write_run
from tests.calls import call

AUTHORS = ("--author", "Curie, Marie; 0000-0002-1825-0097; Our lab https://lab.example", "--author", "Doe, Jane")
FACTS = ("--licence", "CC-BY-4.0", "--publisher", "Zenodo https://zenodo.org", "--date", "2026-11-28")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A run, processed."""
    lab = tmp_path_factory.mktemp("lab")
    write_run(lab / "runs", 1)
    call("process", the_run(lab))
    return lab


def the_run(lab):
    (run,) = (lab / "runs").iterdir()
    return run


@pytest.fixture(scope="module")
def published(lab):
    """The run as a folder that is published."""
    call("publish", the_run(lab), "-o", lab / "ours", *AUTHORS, *FACTS, "--doi", "10.5281/zenodo.1234567")
    return lab / "ours"


def graph_of(folder):
    crate = json.loads((folder / "ro-crate-metadata.json").read_text())
    assert crate["@context"][0] == "https://w3id.org/ro/crate/1.1/context"
    ids = [node["@id"] for node in crate["@graph"]]
    assert len(ids) == len(set(ids))
    return {node["@id"]: node for node in crate["@graph"]}


def references(value):
    if isinstance(value, dict):
        if set(value) == {"@id"}:
            yield value["@id"]
        for item in value.values():
            yield from references(item)
    elif isinstance(value, list):
        for item in value:
            yield from references(item)


def files_in(folder):
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def test_the_crate_has_what_the_specification_asks_for(published):
    graph = graph_of(published)
    descriptor, root = graph["ro-crate-metadata.json"], graph["./"]
    assert descriptor["about"] == {"@id": "./"}
    assert descriptor["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert (root["@type"], root["datePublished"]) == ("Dataset", "2026-11-28")
    assert root["name"]
    assert (
        root["description"].startswith("SIMULATED")
        == json.loads((next((published / "runs").iterdir()) / "manifest.json").read_text())["simulated"]
    )
    licence = graph[root["license"]["@id"]]
    assert (licence["@type"], licence["identifier"]) == ("CreativeWork", "CC-BY-4.0")
    people = [graph[author["@id"]] for author in root["author"]]
    assert [person["name"] for person in people] == ["Marie Curie", "Jane Doe"]
    assert people[0]["@id"] == "https://orcid.org/0000-0002-1825-0097"
    assert graph[people[0]["affiliation"]["@id"]]["url"] == "https://lab.example"
    outside = {"https://w3id.org/ro/crate/1.1"}
    outside |= {f"http://schema.org/{status}ActionStatus" for status in ("Completed", "Failed")}
    lost = {r for node in graph.values() for r in references(list(node.values()))} - set(graph) - outside
    assert lost == set()
    reached, todo = set(), ["./", "ro-crate-metadata.json"]
    while todo:
        node = todo.pop()
        if node in graph and node not in reached:
            reached.add(node)
            todo += references(list(graph[node].values()))
    apart = set(graph) - reached
    assert all(name.startswith("#device-") for name in apart), apart  # these point at the bench


def test_each_file_is_described_with_its_hash(published):
    graph, found = graph_of(published), files_in(published)
    files = {unquote(name): node for name, node in graph.items() if node["@type"] == "File"}
    assert set(found) - set(files) == {"ro-crate-metadata.json", "sha256sums.txt"}
    for name, node in files.items():
        data = found[name].read_bytes()
        assert (node["sha256"], node["contentSize"]) == (hashlib.sha256(data).hexdigest(), str(len(data)))
        assert node["encodingFormat"]
        assert node["description"]
    sums = dict(reversed(line.split("  ")) for line in (published / "sha256sums.txt").read_text().splitlines())
    assert sums == {n: hashlib.sha256(p.read_bytes()).hexdigest() for n, p in found.items() if n != "sha256sums.txt"}


def test_the_coefficients_are_those_behind_the_run(published):
    K, _ = stiffness_and_damping(1)
    with (published / "coefficients.csv").open() as file:
        rows = list(csv.DictReader(file))
    [row] = [row for row in rows if row["symbol"] == "K" and row["value"]]
    assert row["unit"] == "N/m"
    assert float(row["value"]) == pytest.approx(K, rel=0.05)  # of one step, by its ringing
    [node] = [n for n in graph_of(published).values() if n["@type"] == "PropertyValue" and n["name"] == "K"]
    assert (node["value"], node["unitCode"]) == (float(row["value"]), "N/m")
    assert node["measurementTechnique"] == row["method"]


def test_a_coefficient_has_its_interval_and_its_operating_point():
    from pmabench.report.publishing.about import About, Author, Place
    from pmabench.report.publishing.crate import Contents, crate_of
    from pmabench.store.analyses.results import Analysis, Estimate, Parts

    K = Estimate("K", 7000.0, "N/m", "stiffness", "a method", {"load": 58.86, "pressure": 3e5}, Parts(100.0), n=4)
    none = Estimate("B_r", None, "N.s/m", "damping", "a method", {"pressure": 3e5})
    about = About((Author("Doe", "Jane"),), "CC0-1.0", "2026-11-28", Place("Our lab"))
    analysis = Analysis("contraction-relaxation", (), simulated=False, estimates=(K, none))
    graph = crate_of(Contents(about, "t", "d", ("k",), (("analyses/a", analysis),), (), ()))["@graph"]
    found = {node["name"]: node for node in graph if node["@type"] == "PropertyValue"}
    assert set(found) == {"K", "pressure"}
    assert {key: found["K"][key] for key in ("value", "minValue", "maxValue", "unitText")} == {
        "value": 7000.0,
        "minValue": 6900.0,
        "maxValue": 7100.0,
        "unitText": "N/m",
    }
    assert found["K"]["valueReference"] == {"@id": found["pressure"]["@id"]}
    assert (found["pressure"]["value"], found["pressure"]["unitCode"]) == (3e5, "Pa")


def test_who_did_what_to_what(published):
    graph = graph_of(published)
    actions = [node for node in graph.values() if node["@type"] == "CreateAction"]
    recording, processing = sorted(actions, key=lambda node: node["@id"] == "#processing")
    assert graph[recording["object"]["@id"]]["@type"] == "IndividualProduct"
    assert graph[recording["result"]["@id"]]["@type"] == "Dataset"
    assert graph[processing["instrument"]["@id"]]["softwareVersion"]
    assert recording["result"] in processing["object"]
    calibrations = graph[recording["instrument"]["@id"]]["additionalProperty"]
    assert "calibration of pressure" in {graph[node["@id"]]["name"] for node in calibrations}


def test_catalogues_get_what_they_require(published, lab):
    cite = json.loads((published / "datacite.json").read_text())
    assert cite["doi"] == "10.5281/zenodo.1234567"
    assert cite["schemaVersion"] == "http://datacite.org/schema/kernel-4"
    assert (cite["publicationYear"], cite["publisher"]) == ("2026", {"name": "Zenodo"})
    assert cite["types"]["resourceTypeGeneral"] == "Dataset"
    assert [creator["name"] for creator in cite["creators"]] == ["Curie, Marie", "Doe, Jane"]
    assert cite["titles"][0]["title"]
    cff = YAML(typ="safe").load((published / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(cff)
    assert (cff["cff-version"], cff["license"], str(cff["date-released"])) == ("1.2.0", "CC-BY-4.0", "2026-11-28")
    assert cff["authors"][0]["orcid"] == "https://orcid.org/0000-0002-1825-0097"


def test_the_data_package_has_every_file_and_the_columns(published):
    package = json.loads((published / "datapackage.json").read_text())
    assert package["licenses"][0]["name"] == "CC-BY-4.0"
    for resource in package["resources"]:
        data = (published / resource["path"]).read_bytes()
        assert re.fullmatch(r"[-a-z0-9._/]+", resource["name"])
        assert (resource["bytes"], resource["hash"]) == (len(data), f"sha256:{hashlib.sha256(data).hexdigest()}")
    [table] = [resource for resource in package["resources"] if "schema" in resource]
    fields = {field["name"]: field["type"] for field in table["schema"]["fields"]}
    with (published / table["path"]).open() as file:
        rows = list(csv.DictReader(file))
    read = {"number": float, "integer": int, "string": str, "boolean": {"true": True, "false": False}.__getitem__}
    assert list(rows[0]) == list(fields)
    for row in rows:
        for name, text in row.items():
            assert not text or read[fields[name]](text) is not None


def test_the_same_facts_give_the_same_bytes_also_as_a_zip(lab, tmp_path):
    zips = [tmp_path / "a" / "ours.zip", tmp_path / "b" / "ours.zip"]
    for path in zips:
        call("publish", the_run(lab), "-o", path, *AUTHORS, *FACTS)
    assert zips[0].read_bytes() == zips[1].read_bytes()
    assert [path.name for path in zips[0].parent.iterdir()] == ["ours.zip"]
    with zipfile.ZipFile(zips[0]) as file:
        assert file.testzip() is None
        assert {name.split("/")[0] for name in file.namelist()} == {"ours"}
        file.extractall(tmp_path / "out")
    record = next((tmp_path / "out" / "ours" / "runs").iterdir())
    call("runs", "verify", record)
    call("process", record, "--out", tmp_path / "again")
    (again,) = (tmp_path / "again").rglob("analysis.json")
    (given,) = (tmp_path / "out" / "ours" / "analyses").rglob("analysis.json")
    assert again.read_bytes() == given.read_bytes()


def copied(lab, place):
    shutil.copytree(lab / "runs", place / "runs")
    for path in (place / "runs").rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    return the_run(place)


def test_notes_go_along_and_strange_files_do_not(lab, tmp_path):
    run = copied(lab, tmp_path)
    call("note", run, "room was cold", "--operator", "A. B.")
    (run / ".DS_Store").write_bytes(b"x")
    call("publish", run, "-o", tmp_path / "ours", *AUTHORS, *FACTS)
    [record] = (tmp_path / "ours" / "runs").iterdir()
    assert not (record / ".DS_Store").exists()
    assert any("room was cold" in path.read_text() for path in (record / "notes").rglob("*") if path.is_file())


def test_a_damaged_or_open_record_is_refused(lab, tmp_path):
    run = copied(lab, tmp_path)
    (run / "events.jsonl").write_bytes((run / "events.jsonl").read_bytes()[:-1])
    answer = call("publish", run, "-o", tmp_path / "ours", *AUTHORS, *FACTS, code=3)
    assert run.name in answer.output
    assert [path.name for path in tmp_path.iterdir() if "ours" in path.name or "publish" in path.name] == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("--author", "Jane Doe"), "Family, Given"),
        (("--author", "Doe, Jane; 0000-0002-1825-0098"), "ORCID"),
        (("--author", "Doe, Jane; Our lab; 0000-0002-1825-009X; x"), "Family, Given"),
        (("--doi", "zenodo.1234567"), "10.5281"),
        (("--date", "28.11.2026"), "2026-11-28"),
        (("--licence", "free"), "CC-BY-4.0"),
    ],
)
def test_facts_that_are_none_are_refused_with_how_to_write_them(lab, tmp_path, change, said):
    answer = call("publish", the_run(lab), "-o", tmp_path / "ours", *AUTHORS, *FACTS, *change, code=2)
    assert said in answer.output
    assert not (tmp_path / "ours").exists()


def test_it_is_not_mixed_with_other_files(lab, tmp_path):
    answer = call("publish", the_run(lab), "-o", tmp_path, *AUTHORS, *FACTS, code=2)
    assert "is there already" in answer.output
    assert list(tmp_path.iterdir()) == []


def test_names_of_a_stranger_stay_text(tmp_path):
    from pmabench.report.publishing.about import Author

    author = Author.read('Doe", x: y, {Jane}\u2028; ')
    assert (author.family, author.given) == ('Doe"', "x: y, {Jane}")


def test_runs_of_two_specimens_make_no_report(lab, tmp_path):
    """The values of one would stand on the certificate of the other."""
    write_run(tmp_path / "runs", 2)
    (other,) = (tmp_path / "runs").iterdir()
    for command in (("report", "-o", tmp_path / "r.html"), ("publish", "-o", tmp_path / "p", *AUTHORS, *FACTS)):
        said = call(command[0], the_run(lab), other, *command[1:], code=2).output
        assert "of one specimen, and these runs are of 2: MAS-20 A001; MAS-20 A002" in said
        assert "compare" in said
    assert not (tmp_path / "r.html").exists()
    assert not (tmp_path / "p").exists()
