"""A page of kincal.pages as plain data, for the browser's part to draw: the same words, tables and figures as
the page in a file."""

from __future__ import annotations

import json
from typing import Any

from kincal.pages.page import Grid, Page, Section

Plain = dict[str, Any]


def document(page: Page) -> Plain:
    """All of a page but what belongs to a file of its own (links to words, the answer as text)."""
    return {
        "kind": page.kind,
        "title": page.title,
        "subtitle": page.subtitle,
        "verdict": page.verdict,
        "summary": list(page.summary),
        "tiles": [{"label": t.label, "text": t.text, "mood": t.mood, "about": t.about} for t in page.tiles],
        "commands": [{"why": c.why, "text": c.text} for c in page.commands],
        "sections": [section(s) for s in page.sections],
    }


def section(s: Section) -> Plain:
    """A section of a page."""
    return {
        "key": s.key,
        "title": s.title,
        "text": s.text,
        "figure": None if s.figure is None else json.loads(s.figure.to_json()),
        "grid": None if s.grid is None else plain_grid(s.grid),
    }


def plain_grid(g: Grid) -> Plain:
    """A table of a page."""
    return {
        "columns": [{"title": c.title, "number": c.number} for c in g.columns],
        "rows": [[{"text": cell.text, "mood": cell.mood} for cell in row] for row in g.rows],
        "note": g.note,
    }
