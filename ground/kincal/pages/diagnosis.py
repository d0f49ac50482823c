"""The page of a diagnosis, and its figures as pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from kincal.pages import diagnosis_figures as figures
from kincal.pages import diagnosis_grids as grids
from kincal.pages import finding_figures, image, residual_figures
from kincal.pages import poses as pose_plots
from kincal.pages.page import Command, Grid, Page, Provenance, Section, Tile, write
from kincal.pages.poses import Poses
from kincal.workbench.diagnosis import EffectFinding, UnnamedFinding
from kincal.workbench.model.hypotheses import effect_of
from kincal.workbench.prediction.nextposes import NextPose, would_decide
from kincal.workbench.report import explain
from kincal.workbench.report.advice import Step
from kincal.workbench.report.content import ReportContent
from kincal.workbench.report.diagnosis_text import diagnosis_text
from kincal.workbench.report.headline import big_numbers, reachable_number
from kincal.workbench.report.partial import Panel, effect_panels, place_panels

# key -> heading, and how to read the figure
HEADINGS = {
    "models": (
        "Held-out error of the nested models",
        "Each model contains the one above it. One column for each way of holding poses back; bars: 95 % "
        "interval over the held-out poses. Dashed: noise floor, and the error that a black box reaches.",
    ),
    "gains": (
        "Contribution of each effect",
        "The whole model compared with the same model without this one effect, on poses that were not "
        "fitted.",
    ),
    "posterior": (
        "Probabilities",
        "Of what may be missing, given this library and its priors. Blue: added; orange: alternative; grey: "
        "nothing missing; red: something unnamed. Dotted: 0.9, the threshold for confidence. Effects that "
        "were added only because they improve predictions are not shown: they have no probability.",
    ),
    "suspects": (
        "Most suspicious joints",
        "Motion of the joint alone that would explain each residual, plotted against what it may depend on.",
    ),
    "map": (
        "Where the error enters and what it depends on",
        "Before any effect was added. Rows: location; columns: driver variable.",
    ),
    "vectors": (
        "Residual vectors",
        "Scaled {grow:.0f}×; the longest are truncated. Colour: out-of-plane component.",
    ),
    "variables": (
        "Residuals by variable",
        "Residuals before any effect was added, plotted against the variables that explain most of them.",
    ),
    "joints": ("Residuals by joint", "Motion of each joint alone that would explain the residuals."),
    "confounding": (
        "Confounding",
        "Bold: below 9, so with these poses "
        "the two effects are confounded. In brackets: the typical size that each is given.",
    ),
    "harm": (
        "What could still be wrong",
        "Effects that these poses may fail to show: the tool error caused by an effect just too small to be "
        "detected with 90 % power. In brackets: the size of that effect, in typical sizes.",
    ),
    "next": ("Next poses", "They separate {names}. Power: with this pose and those above it.{little}"),
}
NEVER_HIDDEN = "With these poses no effect of typical size can be mistaken for another."
HOW_FINDING = (
    "Dots: motion at this location that would best explain each pose if the effect were not in the model. "
    "Means of similar poses are shown with their standard error. Poses and means that barely constrain this "
    "location are omitted. Each band is for that curve alone; interchangeable curves have wide bands."
)


def page(data: ReportContent, provenance: Provenance, steps: Sequence[Step] = ()) -> Page:
    """The diagnosis as a page; steps: what to do next."""
    d = data.diagnosis
    return Page(
        kind="Diagnosis",
        title=d.comparison.arm,
        subtitle=f"{d.comparison.poses} poses of {d.comparison.source}",
        provenance=provenance,
        verdict=explain.verdict(d),
        summary=list(_findings(data)),
        tiles=[
            Tile(n.label, n.text.replace(", ", "\n"), about=n.about) for n in big_numbers(d.comparison, d)
        ],
        commands=[Command(step.why, step.command) for step in steps],
        poses=pose_plots.table(d),
        details=diagnosis_text(d, data.next_poses),
        sections=_sections(data),
    )


def _sections(data: ReportContent) -> list[Section]:
    d, nested = data.diagnosis, data.nested
    poses = Poses.of(d.comparison, d.final)
    grow = residual_figures.magnification(d)
    reachable_m = reachable_number(d.comparison).pos_m
    out = [
        *_found(data, poses),
        _section("models", figures.nested(nested, reachable_m), grids.models(nested)),
        *([_section("gains", None, grids.gains(nested))] if nested.gains else []),
        _section("posterior", figures.posterior(d), grids.effects(d)),
        _section("suspects", residual_figures.suspects(d, poses), text=_noted("suspects", poses)),
        _section("map", figures.location_map(d)),
        _section(
            "vectors", residual_figures.vectors(d, poses), text=_noted("vectors", poses).format(grow=grow)
        ),
        _section("variables", residual_figures.variables(d, poses), text=_noted("variables", poses)),
        _section("joints", residual_figures.joints(d)),
        _confounding(data),
        _section("harm", figures.harm(data.harm)),
    ]
    useful = data.next_poses and not explain.cannot_decide(data.next_poses)
    return [*out, _next(data)] if useful else out


def _section(key: str, figure: go.Figure | None, grid: Grid | None = None, text: str = "") -> Section:
    title, usual = HEADINGS[key]
    return Section(key, title, text or usual, figure, grid)


def _noted(key: str, poses: Poses) -> str:
    return f"{HEADINGS[key][1]} {poses.note}".rstrip()


# --------------------------------------------------------------------------- what was found


def _found(data: ReportContent, poses: Poses) -> Iterator[Section]:
    """A section for each effect of the final model, and one for the unnamed."""
    d = data.diagnosis
    for number, e in enumerate(e for e in d.effects if e.in_model):
        panels = [p for h in d.final.hypotheses if h.name == e.name for p in effect_panels(d.final, h)]
        if panels:
            yield Section(
                f"found-{number + 1}", f"Found: {e.label}", _about(e, panels, poses),
                finding_figures.findings(panels, poses), grids.parameters(e),
            )  # fmt: skip
    if d.novel is not None:
        yield _unnamed(data, poses, d.novel)


def _unnamed(data: ReportContent, poses: Poses, novel: UnnamedFinding) -> Section:
    panels = place_panels(data.diagnosis.final, novel.location, novel.depends_on)
    sentence, gain = explain.unnamed(novel), explain.smooth_gain(novel)
    advice = explain.cause_without_terms(novel.name)
    text = (
        f"{sentence[:1].upper()}{sentence[1:]}. As a smooth function ({novel.name}): {gain}. "
        f"{advice[:1].upper()}{advice[1:]}{'. ' if advice else ''}{HOW_FINDING} {poses.note}"
    )
    figure = finding_figures.findings(panels, poses, novel.curves)
    title = "Found: something unnamed" if novel.found else "Not confirmed: something unnamed"
    return Section("found-unnamed", title, text.rstrip(), figure)


def _about(e: EffectFinding, panels: Sequence[Panel], poses: Poses) -> str:
    hidden = len(panels) - finding_figures.PANELS
    more = f" {hidden} panels with smaller motions are omitted." if hidden > 0 else ""
    said = explain.held_gain(e.held)
    return f"{said[:1].upper()}{said[1:]}. {HOW_FINDING}{more} {poses.note}".rstrip()


def _findings(data: ReportContent) -> Iterator[str]:
    """What was found, each with what to look at on the arm."""
    d = data.diagnosis
    for e in d.effects:
        if e.in_model:
            yield _finding(e, data)
    if d.novel:
        doubt = "" if d.novel.found else f"; {explain.MAY_BE_NOISE}"
        chance = f"{explain.probability(d.novel.probability)} against every named effect"
        yield f"Unnamed: {explain.unnamed(d.novel)} ({chance}{doubt})."
    if lacking := sum(bool(n.needs) for n in d.not_testable):
        yield (f"{lacking} effects of the library could not be tested: columns or arm data are missing "
               '(see the list in "The answer as text").')  # fmt: skip


def _finding(e: EffectFinding, data: ReportContent) -> str:
    d = data.diagnosis
    sure = explain.odds(e, d) or f"not certain, but {explain.only_predicts(e)}"
    if not explain.is_shown(e):
        sure += "; undecided"
    wrong = explain.negative(e.parameters)
    sure += f"; {wrong}" if wrong else ""
    alike = f" Confounded with {explain.grouped(e.confounded_with)}." if e.confounded_with else ""
    effect = data.library.effects.get(effect_of(e.name))
    about = f": {effect.title}.{alike} Inspect: {effect.inspect}" if effect else f".{alike}"
    return f"{e.name} ({sure}){about}"


# --------------------------------------------------------------------------- what the poses can show


def _confounding(data: ReportContent) -> Section:
    """Of effects at all joints, of typical size; and of what was found, at its joints and of its size."""
    figure = figures.confounding(data.confounding)
    found = [
        f"{e.name} from {explain.grouped(e.confounded_with)}"
        for e in data.diagnosis.effects
        if e.in_model and e.confounded_with
    ]
    text = HEADINGS["confounding"][1] if figure is not None else NEVER_HIDDEN
    if found:
        text += f" Of what was found, at its size, these poses cannot tell {'; nor '.join(found)}."
    return _section("confounding", figure, text=text)


def _next(data: ReportContent) -> Section:
    poses = data.next_poses
    limits = np.array([[j.q_min, j.q_max] for j in data.diagnosis.final.arm.joints]).T
    q, power = np.array([p.q for p in poses]), [p.power for p in poses]
    rows = [_pose_row(k, p) for k, p in enumerate(poses, 1)]
    little = "" if would_decide(poses) else f" But {explain.would_not_decide(poses)}."
    text = HEADINGS["next"][1].format(names=", ".join(poses[0].separates), little=little)
    grid = Grid.of("pose|<q [rad or m]|<approach|power", rows)
    return _section("next", figures.next_poses(q, limits[0], limits[1], power), grid, text)


def _pose_row(number: int, p: NextPose) -> list[str]:
    approach = "" if p.direction is None else " ".join(f"{sign:+d}" for sign in p.direction)
    return [str(number), ", ".join(f"{x:.3f}" for x in p.q), approach, f"{p.power:.2f}"]


# --------------------------------------------------------------------------- files


def pictures(made: Page, path: Path) -> Mapping[Path, go.Figure]:
    """Where each figure of a report goes as a picture: beside the page, REPORT-KEY.png."""
    return {
        path.with_name(f"{path.stem}-{s.key}.png"): s.figure for s in made.sections if s.figure is not None
    }


def write_all(
    data: ReportContent, path: Path, provenance: Provenance, steps: Sequence[Step] = ()
) -> tuple[list[Path], str]:
    """The page, and its figures as PNG beside it where pictures can be made.

    Returns the files, and why there are no pictures ("" if there are)."""
    made = page(data, provenance, steps)
    return image.beside([write(made, path)], pictures(made, path))
