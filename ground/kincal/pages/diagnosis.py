"""The page of a diagnosis, and its figures as pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from kincal.pages import diagnosis_figures as figures
from kincal.pages import image
from kincal.pages.page import Grid, Page, Provenance, Section, Tile, write
from kincal.workbench import explain
from kincal.workbench.api import ReportContent
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.diagnosis_text import diagnosis_text
from kincal.workbench.hypotheses import effect_of
from kincal.workbench.nested import NestedModels
from kincal.workbench.nextposes import NextPose

EFFECT_COLUMNS = (
    "<effect|<role|probability|family-wise p|held out before [mm]|after [mm]|<parameters|<confounded with"
)
MODEL_COLUMNS = (
    "<model|<held out|RMS [mm]|RMS [mrad]|without noise [mm]|worst [mm]|ratio to the model before"
    "|95 % interval"
)
# key -> heading, and how to read the figure
HEADINGS = {
    "models": ("Error of the nested models", ""),
    "posterior": (
        "Probabilities",
        "Blue: added; orange: alternative; grey: nothing missing. After =: effects it is confounded with.",
    ),
    "suspects": (
        "The strongest suspects among the joints",
        "Motion of the joint alone that would explain each residual, by what it may depend on.",
    ),
    "map": (
        "Where the error enters and what it depends on",
        "Before any effect was added. Rows: location; columns: driver variable.",
    ),
    "vectors": ("Residual vectors", ""),
    "variables": (
        "Residuals by variable",
        "Residuals before any effect was added, against the variables that explain most of them.",
    ),
    "joints": ("Residuals by joint", "Motion of each joint alone that would explain the residuals."),
    "confounding": ("Confounding", "Bold: below 9, cannot be distinguished with these poses."),
    "harm": (
        "What could still be wrong",
        "Beside each effect: its smallest size with 90 % power, in typical sizes.",
    ),
    "next": ("Next poses", "They separate {names}; the power counts the poses above too."),
}
NEVER_HIDDEN = "No effect hides behind another with these poses."


def page(data: ReportContent, provenance: Provenance) -> Page:
    """The diagnosis as a page."""
    d = data.diagnosis
    return Page(
        kind="Diagnosis",
        title=f"Model diagnosis: {d.comparison.arm}",
        subtitle=f"{d.comparison.poses} poses of {d.comparison.source}",
        provenance=provenance,
        verdict=explain.verdict(d),
        summary=_findings(data),
        tiles=_error_tiles(data.nested),
        details=diagnosis_text(d, data.next_poses),
        sections=_sections(data),
    )


def _sections(data: ReportContent) -> list[Section]:
    d = data.diagnosis
    out = [
        _section("models", figures.nested(data.nested), _model_grid(data.nested), _gains(data.nested)),
        _section("posterior", figures.posterior(d), _effect_grid(d)),
        _section("suspects", figures.suspects(d)),
        _section("map", figures.location_map(d)),
        _section("vectors", figures.vectors(d)),
        _section("variables", figures.variables(d)),
        _section("joints", figures.joints(d)),
        _confounding(data),
        _section("harm", figures.harm(data.harm)),
    ]
    return [*out, _next(data)] if data.next_poses else out


def _gains(nested: NestedModels) -> str:
    """Effects whose gain the held-out poses do not show, in sentences."""
    return "".join(f"{line[:1].upper()}{line[1:]}. " for line in map(explain.no_gain, nested.no_gain))


def _section(key: str, figure: go.Figure | None, grid: Grid | None = None, text: str = "") -> Section:
    title, usual = HEADINGS[key]
    return Section(key, title, text or usual, figure, grid)


def _confounding(data: ReportContent) -> Section:
    figure = figures.confounding(data.confounding)
    return _section("confounding", figure, text="" if figure is not None else NEVER_HIDDEN)


def _next(data: ReportContent) -> Section:
    poses = data.next_poses
    limits = np.array([[j.q_min, j.q_max] for j in data.diagnosis.final.arm.joints]).T
    q, power = np.array([p.q for p in poses]), [p.power for p in poses]
    rows = [_pose_row(k, p) for k, p in enumerate(poses, 1)]
    text = HEADINGS["next"][1].format(names=", ".join(poses[0].separates))
    grid = Grid.of("pose|<q [rad or m]|<approach|power", rows)
    return _section("next", figures.next_poses(q, limits[0], limits[1], power), grid, text)


def _pose_row(number: int, p: NextPose) -> list[str]:
    approach = "" if p.direction is None else " ".join(f"{sign:+d}" for sign in p.direction)
    return [str(number), ", ".join(f"{x:.3f}" for x in p.q), approach, f"{p.power:.2f}"]


def _error_tiles(nested: NestedModels) -> list[Tile]:
    """The first way of holding back, model by model: what a reader looks for first."""
    models = nested.of(nested.models[0].block)
    out = [Tile(f"{m.model}, {m.block}, RMS", f"{m.pos_m * 1e3:.2f} mm") for m in models]
    floor = nested.floor.pos_m
    return [*out, Tile("noise floor", "unknown" if floor is None else f"{floor * 1e3:.2f} mm")]


def _findings(data: ReportContent) -> list[str]:
    """What was found, each with what to look at on the arm."""
    d, out = data.diagnosis, []
    for e in d.effects:
        if e.accepted or e.helps:
            effect = data.library.effects[effect_of(e.name)]
            sure = (
                f"probability {e.probability:.2f}" if e.accepted else "not certain, but held-out poses gain"
            )
            alike = f" Confounded with {', '.join(e.confounded_with)}." if e.confounded_with else ""
            out.append(f"{e.name} ({sure}): {effect.title}.{alike} Inspect: {effect.inspect}")
    if d.novel:
        drivers = " and ".join(explain.in_words(name) for name in d.novel.depends_on)
        out.append(f"An unnamed effect enters at {d.novel.location} and depends on {drivers} "
                   f"(probability {d.novel.probability:.2f}).")  # fmt: skip
    if data.next_poses:
        names = ", ".join(data.next_poses[0].separates)
        out.append(f"The {len(data.next_poses)} poses under Next poses separate {names}.")
    if lacking := sum(bool(n.needs) for n in d.not_testable):
        out.append(f"{lacking} effects of the library could not be tested: columns or arm data are missing "
                   "(list under The answer as text).")  # fmt: skip
    return out


def _effect_grid(d: Diagnosis) -> Grid:
    rows = [
        (
            e.name,
            "added" if e.accepted else "alternative",
            f"{e.probability:.3f}",
            f"{e.p_value:.2g}",
            f"{e.held.before_m * 1e3:.3f}",
            f"{e.held.after_m * 1e3:.3f}",
            "; ".join(f"{p.name} = {p.value:.4g} ± {p.std_err:.2g} {p.unit}" for p in e.parameters),
            ", ".join(e.confounded_with),
        )
        for e in d.effects
    ]
    return Grid.of(EFFECT_COLUMNS, rows)


def _model_grid(nested: NestedModels) -> Grid:
    def milli(value: float | None) -> str:
        return "" if value is None else f"{value * 1e3:.3f}"

    rows = [
        (
            m.model,
            m.block,
            milli(m.pos_m),
            milli(m.rot_rad),
            milli(m.sys_pos_m),
            milli(m.max_pos_m),
            "" if m.ratio is None else f"{m.ratio:.3f}",
            "" if m.ratio_interval is None else "{:.3f} to {:.3f}".format(*m.ratio_interval),
        )
        for m in nested.models
    ]
    return Grid.of(MODEL_COLUMNS, rows)


def pictures(made: Page, path: Path) -> Mapping[Path, go.Figure]:
    """Where each figure of a report goes as a picture: beside the page, REPORT-KEY.png."""
    return {
        path.with_name(f"{path.stem}-{s.key}.png"): s.figure for s in made.sections if s.figure is not None
    }


def write_all(data: ReportContent, path: Path, provenance: Provenance) -> tuple[list[Path], str]:
    """The page, and its figures as PNG beside it where pictures can be made.

    Returns the files, and why there are no pictures ("" if there are)."""
    made = page(data, provenance)
    return image.beside([write(made, path)], pictures(made, path))
