"""The code blocks of the documentation, and which of them the tests cannot run.

``python -m tests.docs.blocks`` lists the blocks that are not run, with the reason of each.
"""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
REASON = re.compile(r"<!-- not run: (.*) -->\n\Z")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block of code.

    Attributes:
        page: Path of its page below the checkout.
        line: Line of its first line of code, from 1.
        language: What follows the fence: sh, python, toml, json, text or another.
        code: Its lines.
        not_run: Why the tests do not run it, in a comment above it; "" if they do.
    """

    page: str
    line: int
    language: str
    code: str
    not_run: str


def blocks_of(page: Path) -> list[Block]:
    """Return the blocks of a page in order."""
    text = page.read_text()
    blocks = []
    for match in BLOCK.finditer(text):
        reason = REASON.search(text[: match.start()])
        blocks.append(
            Block(
                page=str(page.relative_to(ROOT)),
                line=text.count("\n", 0, match.start()) + 2,
                language=match[1],
                code=match[2],
                not_run=reason[1] if reason else "",
            )
        )
    return blocks


def guide_blocks(language: str) -> list[Block]:
    """Return the blocks of the guide in a language."""
    return [block for page in GUIDE for block in blocks_of(page) if block.language == language]


if __name__ == "__main__":
    for block in guide_blocks("sh") + guide_blocks("python"):
        if block.not_run:
            print(f"{block.page}:{block.line}: {block.not_run}")
