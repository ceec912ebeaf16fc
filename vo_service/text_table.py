"""Text tables: align columns, and format lengths."""


def format_columns(rows: list[tuple[str, str]]) -> str:
    """Format rows of label and value as two aligned columns."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label:<{width}}  {value}".rstrip() for label, value in rows)


def format_mm(value_m: float | None) -> str:
    """Format a length as millimeters, for a column; "-" for None."""
    return f"{'-':>9}   " if value_m is None else f"{1e3 * value_m:9.2f} mm"
