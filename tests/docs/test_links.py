"""Every link in the documentation, and every `docs/` path named in the code, exists."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"(?<!`)\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
PATH_IN_CODE = re.compile(r"(?<![\w/.])docs/[\w/.-]+\.(?:md|png|jpg|csv)")
FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
SOURCES = ("drivers", "vo_service", "tests", "benchmarks", "scripts", "examples", "config", "docs")
SUFFIXES = {".py", ".sh", ".toml", ".json5", ".conf", ".service", ".md"}
# rmw_zenoh's own page.
FOREIGN_PATHS = {"docs/design.md"}


FILES = [
    *ROOT.glob("*.md"),
    *(file for name in SOURCES for file in (ROOT / name).rglob("*") if file.suffix in SUFFIXES),
]
PAGES = [file for file in FILES if file.suffix == ".md"]


def heading_anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_to_files_and_headings(page: Path) -> None:
    broken = []
    for target, anchor in LINK.findall(FENCE.sub("", page.read_text())):
        if "://" in target or target.startswith("mailto:"):
            continue
        file = (page.parent / target).resolve() if target else page
        is_page = file.suffix == ".md" and file.exists()
        if not file.exists() or (anchor and is_page and anchor not in heading_anchors(file)):
            broken.append(f"{target}#{anchor}" if anchor else target)
    assert not broken


def test_pages_named_in_code_and_messages_exist() -> None:
    missing = [
        (str(file.relative_to(ROOT)), name)
        for file in FILES
        for name in PATH_IN_CODE.findall(file.read_text())
        if name not in FOREIGN_PATHS and not (ROOT / name).exists()
    ]
    assert not missing


def test_source_files_named_in_the_design_exist() -> None:
    design = ROOT / "docs" / "design"
    names = {
        (page.name, name.split("/")[-1])
        for page in design.glob("*.md")
        for name in re.findall(r"`([\w/.]+\.py)`", page.read_text())
    }
    existing = {file.name for file in FILES}
    assert sorted((page, name) for page, name in names if name not in existing) == []


def test_benchmarks_named_in_the_documentation_exist() -> None:
    named = {
        command
        for page in PAGES
        for command in re.findall(r"python -m\s+benchmarks (\w+)(?:\s(\w+))?", page.read_text())
    }
    assert [command for command in sorted(named) if not _is_benchmark(*command)] == []


def _is_benchmark(name: str, variant: str) -> bool:
    """Whether there is such a file, and the variant is one of its if it has any."""
    file = ROOT / "benchmarks" / f"{name}.py"
    if not file.exists():
        return False
    _, _, variants = file.read_text().partition("\nVARIANTS: Variants = {")
    return not variants or variant in re.findall(r'^    "(\w+)": ', variants, re.MULTILINE)
