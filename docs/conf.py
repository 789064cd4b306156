"""The site of these pages: `make docs` builds it without a network; tests execute the commands, the build does not."""

import re
from pathlib import Path

from pmabench import __version__

HERE = Path(__file__).parent
FOLDER = re.compile(r"\[([^\]]+)\]\((\.\.?/[^)#]*)\)")

project = "pmabench"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["_build", "driver-example/pmabench_driver_example"]
suppress_warnings: list[str] = []
default_role = "literal"
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
html_theme = "furo"
html_title = f"pmabench {release}"
highlight_language = "text"  # of blocks without a language: commands
html_show_sphinx = False
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_permalinks_icon = "#"


def without_links_to_folders(_app: object, name: str, source: list[str]) -> None:
    """A folder of the repository is no page: its name stays, as text."""
    place = (HERE / name).parent

    def shown(found: re.Match[str]) -> str:
        return found[1] if (place / found[2]).is_dir() else found[0]

    source[0] = FOLDER.sub(shown, source[0])


def setup(app: object) -> None:
    """Called by Sphinx."""
    app.connect("source-read", without_links_to_folders)  # type: ignore[attr-defined]
