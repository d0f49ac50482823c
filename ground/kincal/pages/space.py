"""The page of a search space, and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kincal import space
from kincal.pages import image, space_figures
from kincal.pages.page import Grid, Page, Provenance, Section, write
from kincal.pages.space_figures import Candidates, Outcome
from kincal.space import words

if TYPE_CHECKING:
    from kincal.space import BuiltSpace


def page(
    title: str,
    facts: Sequence[tuple[str, str]],
    candidates: Candidates,
    outcome: Outcome,
    provenance: Provenance,
) -> Page:
    """facts: (what, value) as `kincal space show` prints them."""
    sections = [
        Section("candidates", space_figures.KEPT, "A click on the legend shows or hides a group of samples.",
                space_figures.kept_and_dropped(candidates, outcome)),
        Section("orientation", space_figures.DIRECTIONS, figure=space_figures.orientations(candidates)),
        Section("viewing", "How the camera sees the tags", figure=space_figures.viewing(candidates)),
    ]  # fmt: skip
    if outcome.counts:
        sections.append(
            Section("samples", "What became of the samples", figure=space_figures.samples(outcome))
        )
    if facts:
        sections.insert(0, Section("numbers", "Numbers", grid=Grid.of("<what|<value", facts)))
    return Page("Search space", title, "candidate poses that flight may choose among", provenance, sections)


def of_built(built: BuiltSpace, tables_dir: Path, provenance: Provenance) -> tuple[Page, Candidates, Outcome]:
    """The page of a space that was built, or read (without samples), seen by the camera of a folder; and what
    its figures are made of."""
    tables, cands = space.TablesFolder(tables_dir), built.table.candidates()
    numbers = space.summarise(built.table, tables.camera, tables.arm_crc)
    shown = Candidates(
        space.scene(built.table, tables.arm, tables.camera),
        cands.poses.R,
        cands.hub.tolist(),
        cands.tags.tolist(),
        numbers.candidate_incid_deg,
        numbers.candidate_range_m,
    )
    samples = [(s.p_m, s.rejection) for s in built.samples]
    found = space_figures.outcome(samples, built.rejected, built.n_samples, numbers.candidates)
    initial = f"{len(numbers.initial)} initial poses"
    title = f"{numbers.candidates} candidates, {initial}, table {built.image.crc_text}"
    return page(title, words.facts(numbers), shown, found, provenance), shown, found


def write_all(made: Page, candidates: Candidates, outcome: Outcome, picture: Path) -> tuple[list[Path], str]:
    """The page beside the picture (.html), and the picture (.png or .svg) where one can be made.

    Returns the files, and why there is no picture ("" if there is one)."""
    files = [write(made, picture.with_suffix(".html"))]
    return image.beside(files, {picture: space_figures.sheet(candidates, outcome, made.title)})
