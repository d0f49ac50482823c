"""Small tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(head: Sequence[str], rows: Iterable[Sequence[object]], title: str = "") -> str:
    """An HTML table; every text is escaped."""
    top = f"<caption>{escape(title)}</caption>" if title else ""
    body = "".join(_row("td", row) for row in rows)
    return f"<table>{top}<thead>{_row('th', head)}</thead><tbody>{body}</tbody></table>"


def _row(tag: str, cells: Sequence[object]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"


def text(words: str) -> str:
    """Preformatted text."""
    return f"<pre>{escape(words)}</pre>"


def mm(value: float | None) -> str:
    """Metres as millimetres; a dash where there is no number."""
    return "-" if value is None or value != value else f"{value * 1e3:.3f}"
