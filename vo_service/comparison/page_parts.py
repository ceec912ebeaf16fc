"""Pieces of the page: text in, HTML out, everything escaped here."""

from collections.abc import Iterator, Sequence
from html import escape

from vo_service.comparison import explanations
from vo_service.comparison.paper import about
from vo_service.runs.results import SequenceResults
from vo_service.runs.table import Cell, Table, words


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text, of a class of the style sheet."""
    return f"<p{_class(kind)}>{escape(text)}</p>"


def definitions(entries: Sequence[tuple[str, str]]) -> str:
    """Words and what they mean."""
    items = "".join(f"<dt>{escape(word)}</dt><dd>{escape(text)}</dd>" for word, text in entries)
    return f"<dl>{items}</dl>"


def html_table(table: Table, hidden: Sequence[str] = ()) -> str:
    """A table that scrolls by itself where it is too wide, without the columns in `hidden`."""
    shown = [k for k, key in enumerate(table.keys) if key not in hidden]
    kinds = [_class(_kind([row[k] for row in table.rows])) for k in shown]
    titles = [escape(table.head[k]) for k in shown]
    head = "".join(
        f'<th scope="col"{kind}>{title}</th>' for kind, title in zip(kinds, titles, strict=True)
    )
    rows = "".join(f"<tr>{''.join(_cell(row[k]) for k in shown)}</tr>" for row in table.rows)
    return (
        f'<div class="wide"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def troubles(result: SequenceResults) -> Iterator[str]:
    """What went wrong with the runs of a recording, in full."""
    for method, judged in result.judged.items():
        name = about(method).name
        if not judged.is_done:
            yield paragraph(f"{name}: {judged.outcome}", "bad")
        elif judged.no_evaluation and result.recording.truth is not None:
            yield paragraph(f"{name} is not judged: {judged.no_evaluation}", "bad")
        if judged.outcome.details:
            details = escape(judged.outcome.details)
            yield f"<details><summary>Traceback</summary><pre>{details}</pre></details>"


def why_lost(result: SequenceResults) -> Iterator[str]:
    """The reasons that the methods gave, most frequent first."""
    rows = [
        [words(method, about(method).name), words(reason), Cell(count, str(count))]
        for method, judged in result.judged.items()
        for reason, count in judged.why_lost
    ]
    if rows:
        head = ["method", "why", "frames"]
        yield html_table(Table("", "Lost frames", head, head, rows))
        yield paragraph(explanations.LOST, "note")


def _cell(cell: Cell) -> str:
    kind = " ".join(filter(None, [_kind([cell]), "best" if cell.is_best else ""]))
    return f"<td{_class(kind)}>{escape(cell.text)}</td>"


def _kind(cells: Sequence[Cell]) -> str:
    """Words stand at the left."""
    return "text" if any(isinstance(cell.value, str) for cell in cells) else ""


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
