"""What all pages share: template, style, header, footer with provenance, and figures that open from disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from kincal import __version__
from kincal.pages import theme
from kincal.pages.glossary import Linker, Term, terms_in
from kincal_shared.printable import printable
from kincal_shared.writing import write_file

TEMPLATES = Path(__file__).resolve().parent / "templates"


@dataclass(frozen=True)
class Provenance:
    """Where the numbers of a page come from.

    date: ISO day, passed in, so that the same input gives the same page. tables: kind -> CRC as text.
    data: file that was read, with the SHA-256 of its bytes; empty where there is none. seed: of a
    simulation.
    """

    date: str
    tables: Mapping[str, str] = field(default_factory=dict)
    data: str = ""
    data_sha256: str = ""
    seed: int | None = None
    version: str = __version__

    @staticmethod
    def of_file(
        date: str, data: Path | Sequence[Path], tables: Mapping[str, str] | None = None
    ) -> Provenance:
        """Provenance of a page made from one or more data files."""
        paths = [data] if isinstance(data, Path) else data
        digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()]
        return Provenance(date, tables or {}, ", ".join(map(str, paths)), ", ".join(digests))


@dataclass(frozen=True)
class Column:
    """A column of a page's table; number: right-aligned, with figures of one width."""

    title: str
    number: bool = True


@dataclass(frozen=True)
class Cell:
    """One cell; mood: "good", "bad" or "" colours it."""

    text: str
    mood: str = ""


@dataclass(frozen=True)
class Grid:
    """A table as plain values; rows hold as many cells as there are columns."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    @staticmethod
    def of(columns: str, rows: Sequence[Sequence[str | Cell]], note: str = "") -> Grid:
        """columns: titles separated by `|`; a leading `<` makes one a column of text."""
        heads = tuple(
            Column(c.strip().removeprefix("<"), not c.strip().startswith("<")) for c in columns.split("|")
        )
        cells = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in rows)
        return Grid(heads, cells, note)


@dataclass(frozen=True)
class Tile:
    """A number that a reader looks for first; about: what it is, in small print."""

    label: str
    text: str
    mood: str = ""
    about: str = ""


@dataclass(frozen=True)
class Command:
    """A command to copy, and what it is for."""

    why: str
    text: str


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it: text, figure, table, in this order; each may be missing."""

    key: str
    title: str
    text: str = ""
    figure: go.Figure | None = None
    grid: Grid | None = None


@dataclass(frozen=True)
class Page:
    """A page as plain values, before it is HTML."""

    kind: str  # what sort of page: "Run", "Diagnosis" ...
    title: str
    subtitle: str
    provenance: Provenance
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    summary: Sequence[str] = ()  # sentences
    verdict: str = ""
    commands: Sequence[Command] = ()  # what to do next
    poses: Mapping[str, object] = field(default_factory=dict)  # of the linked plots, as page.js reads it
    details: str = ""  # preformatted text, folded away


@cache
def _environment() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        finalize=_shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["figure_json"] = _figure_json
    made.filters["data_json"] = _data_json
    return made


def _shown(value: object) -> object:
    """A text without what a browser would obey."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def _figure_json(figure: go.Figure) -> Markup:
    """A figure as JSON inside a script element: nothing in it can end that element."""
    return Markup(figure.to_json().replace("<", "\\u003c"))  # noqa: S704 escaped here


def _data_json(data: Mapping[str, object]) -> Markup:
    """Plain values as JSON inside a script element."""
    return Markup(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"))  # noqa: S704 escaped here


def render(page: Page) -> str:
    """The page as one HTML text: style, script, figures and data inside, nothing from a network."""
    drawn = any(section.figure is not None for section in page.sections)
    terms = glossary_of(page)
    linker = Linker(terms)
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            page=page,
            style=Markup(theme.css_colours() + (TEMPLATES / "style.css").read_text("utf-8")),  # noqa: S704
            script=Markup((TEMPLATES / "page.js").read_text("utf-8")),  # noqa: S704
            plotly=Markup(get_plotlyjs()) if drawn else "",  # noqa: S704
            dark=Markup(json.dumps(theme.DARK)),  # noqa: S704
            glossary=terms,
            linked=linker.linked,
        )
    )


def glossary_of(page: Page) -> list[Term]:
    """The terms of docs/GLOSSARY.md that the page uses, in its order."""
    words = [page.title, page.subtitle, *page.summary, page.verdict]
    words += [f"{tile.label} {tile.text} {tile.about}" for tile in page.tiles]
    for section in page.sections:
        words += [section.title, section.text]
        if section.grid is not None:
            words += [column.title for column in section.grid.columns]
    return terms_in(" \n ".join(words))


def write(page: Page, path: Path) -> Path:
    """Write the page; returns its path."""
    return write_file(path, render(page))
