"""Lay-out that all texts share."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table


def grid(title: str, *columns: str, right: Sequence[int] = ()) -> Table:
    """A table without lines; right: columns of numbers, from 0."""
    out = Table(
        title=title or None,
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        header_style="dim",
    )
    for i, name in enumerate(columns):
        out.add_column(escape(name), justify="right" if i in right else "left", overflow="fold")
    return out
