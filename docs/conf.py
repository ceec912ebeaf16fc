"""The documentation as a site: ``scripts/docs.sh`` builds it with Sphinx.

The pages are plain Markdown that also reads well in the repository.
"""

import re

from sphinx.application import Sphinx

project = "kinect-vo"
extensions = ["myst_parser", "sphinx.ext.mathjax"]
html_theme = "furo"
html_title = "kinect-vo"
exclude_patterns = ["results/*.json"]
myst_heading_anchors = 3
# GitHub's fences of equations.
myst_fence_as_directive = ["math"]

SECTION = re.compile(r"^## (.*)$", re.MULTILINE)
LINK = re.compile(r"\]\(([\w/-]+)\.md\)")


def add_navigation(app: Sphinx, name: str, source: list[str]) -> None:
    """Give the site's navigation the sections and links of the first page."""
    if name != "index":
        return
    _, *sections = SECTION.split(source[0])
    for title, text in zip(sections[::2], sections[1::2], strict=True):
        pages = "\n".join(LINK.findall(text))
        source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{pages}\n```\n"


def setup(app: Sphinx) -> None:
    """Connect the navigation."""
    app.connect("source-read", add_navigation)
