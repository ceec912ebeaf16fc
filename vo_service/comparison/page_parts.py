"""Pieces of the page: text in, HTML out, everything escaped here."""

from collections.abc import Iterator, Sequence
from html import escape

from vo_service.comparison import explanations
from vo_service.comparison.paper import describe_method
from vo_service.runs.results import SequenceResults
from vo_service.runs.table import Table, TableCell, text_cell


def html_paragraph(text: str, css_class: str = "") -> str:
    """A paragraph of plain text, of a class of the style sheet."""
    return f"<p{_class_attribute(css_class)}>{escape(text)}</p>"


def html_definitions(entries: Sequence[tuple[str, str]]) -> str:
    """Words and what they mean."""
    items = "".join(f"<dt>{escape(word)}</dt><dd>{escape(text)}</dd>" for word, text in entries)
    return f"<dl>{items}</dl>"


def html_table(table: Table, hidden: Sequence[str] = ()) -> str:
    """A table that scrolls by itself where it is too wide, without the columns in `hidden`."""
    shown = [k for k, key in enumerate(table.keys) if key not in hidden]
    kinds = [_class_attribute(_cell_class([row[k] for row in table.rows])) for k in shown]
    titles = [escape(table.headings[k]) for k in shown]
    head = "".join(
        f'<th scope="col"{kind}>{title}</th>' for kind, title in zip(kinds, titles, strict=True)
    )
    rows = "".join(f"<tr>{''.join(_html_cell(row[k]) for k in shown)}</tr>" for row in table.rows)
    return (
        f'<div class="wide"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def html_run_errors(result: SequenceResults) -> Iterator[str]:
    """What went wrong with the runs of a recording, in full."""
    for method, judged in result.evaluations.items():
        name = describe_method(method).name
        if not judged.is_done:
            yield html_paragraph(f"{name}: {judged.outcome}", "bad")
        elif judged.no_evaluation_reason and result.recording.truth is not None:
            yield html_paragraph(f"{name} is not judged: {judged.no_evaluation_reason}", "bad")
        if judged.outcome.details:
            details = escape(judged.outcome.details)
            yield f"<details><summary>Traceback</summary><pre>{details}</pre></details>"


def html_lost_reasons(result: SequenceResults) -> Iterator[str]:
    """The reasons that the methods gave, most frequent first."""
    rows = [
        [
            text_cell(method, describe_method(method).name),
            text_cell(reason),
            TableCell(count, str(count)),
        ]
        for method, judged in result.evaluations.items()
        for reason, count in judged.lost_reasons
    ]
    if rows:
        head = ["method", "why", "frames"]
        yield html_table(Table("", "Lost frames", head, head, rows))
        yield html_paragraph(explanations.LOST_FRAMES_TEXT, "note")


def _html_cell(cell: TableCell) -> str:
    kind = " ".join(filter(None, [_cell_class([cell]), "best" if cell.is_best else ""]))
    return f"<td{_class_attribute(kind)}>{escape(cell.text)}</td>"


def _cell_class(cells: Sequence[TableCell]) -> str:
    """Words stand at the left."""
    return "text" if any(isinstance(cell.value, str) for cell in cells) else ""


def _class_attribute(css_class: str) -> str:
    return f' class="{css_class}"' if css_class else ""
