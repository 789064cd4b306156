"""`make docs`: the site builds without a warning, and every link in it leads to a page and a place that are there."""

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

ROOT = Path(__file__).resolve().parents[1]


class Page(HTMLParser):
    """What a page links to, what it loads, and where links may lead."""

    def __init__(self, path):
        super().__init__()
        self.links, self.loaded, self.places = [], [], {""}
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.places.add(found.get("id") or "")
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        for key in ("src", "data") if tag != "link" else ("href",):
            if found.get(key) and found.get("rel") not in {"next", "prev", "index", "search", "author"}:
                self.loaded.append(found[key])


def broken(folder):
    """Links of a built site that lead nowhere, and whatever it would load from elsewhere."""
    pages = {path: Page(path) for path in folder.rglob("*.html")}
    for path, page in pages.items():
        for link in [*page.links, *page.loaded]:
            if link.startswith(("http:", "https:", "//")):
                if link in page.loaded:
                    yield f"{path.name} loads {link}"
                continue
            file, place = urldefrag(link)
            target = (path.parent / unquote(file.partition("?")[0])).resolve() if file else path
            if not target.is_file():
                yield f"{path.name}: {link}: no such file"
            elif target in pages and unquote(place) not in pages[target].places:
                yield f"{path.name}: {link}: no such place"


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_no_link_is_broken(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(ROOT / "docs"), str(tmp_path / "site")]
    built = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert len(list((tmp_path / "site").rglob("*.html"))) > 40
    assert list(broken(tmp_path / "site")) == []


def test_a_broken_link_and_a_foreign_font_are_found(tmp_path):
    (tmp_path / "a.html").write_text('<a href="b.html#here">x</a> <a href="#gone">x</a> <a href="c.html">x</a>')
    (tmp_path / "b.html").write_text('<p id="here"></p><link rel="stylesheet" href="https://elsewhere.example/x.css">')
    assert sorted(broken(tmp_path)) == [
        "a.html: #gone: no such place",
        "a.html: c.html: no such file",
        "b.html loads https://elsewhere.example/x.css",
    ]
