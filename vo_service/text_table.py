"""Tables of two columns for people."""


def format_columns(rows: list[tuple[str, str]]) -> str:
    """Two columns of text, the second in one line below another."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label:<{width}}  {value}".rstrip() for label, value in rows)


def format_mm(value_m: float | None) -> str:
    """Metres as people read them, in a column."""
    return f"{'-':>9}   " if value_m is None else f"{1e3 * value_m:9.2f} mm"
