"""PNG and SVG from the figures of the pages, through kaleido and a browser that is installed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import plotly.graph_objects as go

from kincal.pages import theme
from kincal_shared.errors import BadInput
from kincal_shared.writing import write_files

SUFFIXES = (".png", ".svg")
_TIMEOUT_S = 120.0


class NoPictures(BadInput):
    """Pictures cannot be made here: kaleido or a browser is missing. Pages need neither."""


def save(figures: Mapping[Path, go.Figure]) -> list[Path]:
    """Write each figure to its path, .png or .svg; one browser serves all. Returns the paths.

    NoPictures when kaleido or a browser is missing, BadInput for another suffix or a place that cannot be
    written; nothing is written then.
    """
    for path in figures:
        if path.suffix not in SUFFIXES:
            raise BadInput(
                f"a picture is .png or .svg, not {path.suffix or 'a name without suffix'}", str(path)
            )
    if not figures:
        return []
    with TemporaryDirectory() as folder:
        drawn = {path: Path(folder) / f"{number}{path.suffix}" for number, path in enumerate(figures)}
        asyncio.run(_save({drawn[path]: figure for path, figure in figures.items()}))
        return write_files({path: file.read_bytes() for path, file in drawn.items()})


def beside(files: list[Path], figures: Mapping[Path, go.Figure]) -> tuple[list[Path], str]:
    """Pictures beside pages that are written already.

    Returns all files, and why there are no pictures ("" if there are).

    A page is worth having without its pictures, so a missing browser is no error here."""
    try:
        return [*files, *save(figures)], ""
    except NoPictures as error:
        return files, f"no pictures: {error.what}; {error.todo}"


async def _save(figures: Mapping[Path, go.Figure]) -> None:
    try:
        from kaleido import Kaleido
        from kaleido.errors import BrowserFailedError, ChromeNotFoundError
    except ImportError:
        raise NoPictures(
            "pictures need the package kaleido", todo="pip install 'kincal[image]'; pages (HTML) need nothing"
        ) from None
    for name in ("kaleido", "choreographer"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    jobs = [{"fig": figure, "path": path, "opts": _options(path, figure)} for path, figure in figures.items()]
    try:
        async with Kaleido(n=1, mathjax=False, timeout=_TIMEOUT_S) as browser:
            await browser.write_fig_from_object(jobs, cancel_on_error=True)
    except (ChromeNotFoundError, BrowserFailedError) as error:
        raise NoPictures(
            "pictures need a browser, and none could be started: Chromium or Chrome",
            str(error).splitlines()[0] if str(error) else "",
            "install one (Debian: apt install chromium); pages (HTML) need none here",
        ) from None


def _options(path: Path, figure: go.Figure) -> dict[str, object]:
    return {
        "format": path.suffix.removeprefix("."),
        "width": figure.layout.width or theme.PNG_WIDTH_PX,
        "height": figure.layout.height,
        "scale": theme.PNG_SCALE if path.suffix == ".png" else 1.0,
    }
