"""The page of a proposed correction, and its picture."""

from __future__ import annotations

from pathlib import Path

from kincal.pages import image, review_figures
from kincal.pages.page import Grid, Page, Provenance, Section, Tile, write
from kincal.pages.run_figures import MILLI
from kincal.results import angle_text, length_text
from kincal.review import NUMBERS, CoefLine, Review

COEF_COLUMNS = "<coefficient|value|1 sigma|value/sigma|<unit|<status|<confounded with"


def page(review: Review, warnings: list[str], provenance: Provenance) -> Page:
    """The proposal as a page; warnings: what a reviewer should look at."""
    return Page(
        kind="Review",
        title=f"Correction {review.crc_text}",
        subtitle=f"session {review.session}, {review.n_poses} poses, replaces {review.crc_before:08x}",
        provenance=provenance,
        verdict=f"{review.verdict[:1].upper()}{review.verdict[1:]}",
        summary=[f"Look at: {warning}" for warning in warnings] or ["Nothing stands out."],
        tiles=_tiles(review),
        sections=_sections(review),
    )


def _tiles(r: Review) -> list[Tile]:
    n = r.numbers
    position = f"{length_text(n['before_pos_m'])} → {length_text(n['fit_pos_m'])}"
    rotation = f"{angle_text(n['before_rot_rad'])} → {angle_text(n['fit_rot_rad'])}"
    return [
        Tile("position residual RMS", position),
        Tile("rotation residual RMS", rotation),
        Tile("rank of free coefficients", f"{n['rank']:.0f} of {n['n_free']:.0f}"),
        Tile("p of the fit", f"{n['p_fit']:.3f}"),
        Tile("p of no change", f"{n['p_no_change']:.2g}"),
        Tile("outliers", f"{r.n_outliers} of {r.n_poses}"),
    ]


def _sections(r: Review) -> list[Section]:
    shown = [c for c in r.coefs if not c.idle]
    rest = len(r.coefs) - len(shown)
    note = f"{rest} masked coefficients at zero are not listed." if rest else ""
    coefs = Grid.of(COEF_COLUMNS, [_coef_row(c) for c in shown], note)
    numbers = [[key, _number(r.numbers[key], unit), text] for key, unit, text in NUMBERS]
    out = [Section("coefficients", "Coefficients", grid=coefs)]
    if r.estimated:
        drawn = Section("corrections", "Corrections", figure=review_figures.corrections(r), grid=coefs)
        out = [
            drawn,
            Section("correlation", "Correlation of the estimates", figure=review_figures.correlation(r)),
        ]
    return [*out, Section("numbers", "Numbers", grid=Grid.of("<number|value|<meaning", numbers))]


def _number(value: float, unit: str) -> str:
    if unit == "rad":
        return angle_text(value)
    return length_text(value) if unit == "m" else f"{value:.4g}"


def _coef_row(c: CoefLine) -> list[str]:
    scale, unit = (1e3, MILLI[c.unit]) if c.unit in MILLI else (1.0, c.unit)
    fitted = c.sigma > 0.0
    return [
        c.name,
        f"{c.value * scale:.3f}",
        f"{c.sigma * scale:.3f}" if fitted else "-",
        f"{c.z:+.1f}" if fitted else "-",
        unit,
        c.status,
        ", ".join(c.confounded),
    ]


def write_all(
    review: Review, warnings: list[str], picture: Path, provenance: Provenance
) -> tuple[list[Path], str]:
    """The page beside the picture (.html), and the picture (.png or .svg) where one can be made.

    Returns the files, and why there is no picture ("" if there is one)."""
    files = [write(page(review, warnings, provenance), picture.with_suffix(".html"))]
    return image.beside(files, {picture: review_figures.sheet(review)})
