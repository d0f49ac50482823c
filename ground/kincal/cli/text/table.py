"""Tables as text."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape

from kincal.cli.text.layout import grid
from kincal.flight.tables import Image
from kincal.tables import Change


def value_text(value: Any) -> str:
    """A field in full: lists and records on one line."""
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes, {sum(b.bit_count() for b in value)} bits set"
    if isinstance(value, list):
        return "[" + ", ".join(value_text(v) for v in value) + "]"
    if isinstance(value, dict):
        return " ".join(f"{k}={value_text(v)}" for k, v in value.items())
    return str(value)


def show(out: Console, image: Image, doc: dict[str, Any], rows_max: int = 400) -> None:
    """Scalars first, then every list of records as its own table."""
    out.print(
        f"[bold]{image.kind}[/] table, layout {image.version}, {len(image.data)} bytes, CRC {image.crc_text}"
    )
    scalars = grid("", "field", "value")
    records = {
        key: value
        for key, value in doc.items()
        if isinstance(value, list) and value and isinstance(value[0], dict)
    }
    for key, value in doc.items():
        if key in records:
            continue
        if isinstance(value, dict):
            for k, v in value.items():
                scalars.add_row(f"{key}.{k}", escape(value_text(v)))
        elif isinstance(value, list) and len(value) > 16 and not any(value):
            scalars.add_row(key, f"{len(value)} zeros")
        else:
            scalars.add_row(key, escape(value_text(value)))
    out.print(scalars)
    for key, rows in records.items():
        _records(out, key, rows[:rows_max])


def _records(out: Console, key: str, rows: list[dict[str, Any]]) -> None:
    shown = grid(f"\n{key}", "#", *rows[0], right=(0,))
    for i, row in enumerate(rows):
        shown.add_row(str(i), *(escape(_brief(v)) for v in row.values()))
    out.print(shown)


def _brief(value: Any) -> str:
    """A cell: long lists by their ends."""
    if isinstance(value, list) and len(value) > 8:
        return f"[{value_text(value[0])} … {value_text(value[-1])}] ({len(value)})"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return " ".join(f"{v:.4g}" if isinstance(v, float) else value_text(v) for v in value)
    return value_text(value)


def diff(out: Console, a: Image, b: Image, changes: list[Change]) -> None:
    """Fields that differ between two tables."""
    out.print(f"{a.kind}: {a.crc_text} -> {b.crc_text}, {len(changes)} fields differ")
    if changes:
        rows = grid("", "field", "first", "second")
        for c in changes:
            rows.add_row(escape(c.path), escape(value_text(c.a)), escape(value_text(c.b)))
        out.print(rows)
