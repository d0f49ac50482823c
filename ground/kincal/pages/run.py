"""The page of a run, its picture and its data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from kincal.pages import image, run_figures
from kincal.pages.page import Cell, Grid, Page, Provenance, Section, Tile, write
from kincal.results import CoefResult, PoseLine, RunResult, angle_text, length_text
from kincal_shared.writing import write_file

COEF_COLUMNS = "<coefficient|<unit|true|estimate|1 sigma|error|within 3 sigma|<status"
POSE_COLUMNS = (
    "pose|candidate|tool x y z [m]|servo steps|residual [mm]|[mrad]|f|GP mean ± sigma"
    "|predicted sigma [mm]|[mrad]|held-out [mm]|[mrad]"
)


def page(result: RunResult, provenance: Provenance) -> Page:
    """The run as a page."""
    return Page(
        kind="Run",
        title=result.title,
        subtitle=(
            f"scenario {result.scenario}, {result.mode}, acquisition {result.acquisition}, "
            f"seed {result.seed}; {result.mission_s:.0f} s of mission time in {result.wall_s:.0f} s"
        ),
        provenance=provenance,
        verdict=_verdict(result),
        tiles=_tiles(result),
        sections=_sections(result),
    )


def _verdict(r: RunResult) -> str:
    """What came out, in one sentence."""
    said = f"{'Passed' if r.ok else 'Failed'}: flight says {r.verdict}"
    if not (r.before and r.after):
        return f"{said}."
    change = f"{length_text(r.before.pos_m)} to {length_text(r.after.pos_m)}"
    goes = "goes" if r.after_is == "after" else "would go"
    return f"{said}; the position error at {r.after.n} poses that were not measured {goes} from {change}."


def _tiles(r: RunResult) -> list[Tile]:
    out = [Tile("result", "passed" if r.ok else "failed", "good" if r.ok else "bad")]
    if r.before and r.after:
        position = f"{length_text(r.before.pos_m)} → {length_text(r.after.pos_m)}"
        rotation = f"{angle_text(r.before.rot_rad)} → {angle_text(r.after.rot_rad)}"
        which = "" if r.after_is == "after" else ", proposed"
        out.append(Tile(f"held-out position RMS, {r.after.n} poses{which}", position))
        out.append(Tile(f"held-out rotation RMS{which}", rotation))
    return [
        *out,
        Tile("poses", f"{len(r.poses)} of {r.n_goal}"),
        Tile("verdict of flight", r.verdict),
        Tile("decision", r.decision),
        Tile("rank of free coefficients", f"{r.rank} of {r.n_free}"),
        Tile("p of the fit", f"{r.p_fit:.3f}"),
        Tile("active KIN table", f"{r.active_crc:08x}"),
    ]


def _sections(r: RunResult) -> list[Section]:
    out = [Section("criteria", "Acceptance criteria", grid=_criteria(r))]
    if r.scene is not None:
        out.append(Section("arm", "Arm and measured poses", figure=run_figures.arm(r.scene, r)))
    if r.curves:
        out.append(Section("progress", "Progress by number of poses", figure=run_figures.progress(r)))
    if r.coefs:
        figure = run_figures.corrections(r.coefs)
        out.append(Section("corrections", "Corrections", figure=figure, grid=coef_grid(r.coefs)))
    out.append(Section("poses", "Poses", grid=Grid.of(POSE_COLUMNS, [_pose_row(p) for p in r.poses])))
    if r.events:
        events = Grid.of("<event", [[e] for e in r.events])
        out.append(Section("events", "Warnings and errors from flight", grid=events))
    return out


def _criteria(r: RunResult) -> Grid:
    rows: list[list[str | Cell]] = [[g.name, g.got, g.want, mark(g.ok)] for g in r.criteria]
    return Grid.of("<criterion|got|wanted|met", rows)


def mark(good: bool) -> Cell:
    """yes or no, coloured."""
    return Cell("yes", "good") if good else Cell("no", "bad")


def coef_grid(coefs: Sequence[CoefResult]) -> Grid:
    """Coefficients; those that are masked at zero are only counted."""
    shown = [c for c in coefs if not c.idle]
    rest = len(coefs) - len(shown)
    note = f"{rest} masked coefficients at zero are not listed." if rest else ""
    return Grid.of(COEF_COLUMNS, [_coef_row(c) for c in shown], note)


def _coef_row(c: CoefResult) -> list[str | Cell]:
    scale, unit = (1e3, run_figures.MILLI[c.unit]) if c.unit in run_figures.MILLI else (1.0, c.unit)
    known, fitted = c.true == c.true, c.sigma > 0.0
    return [
        c.name,
        unit,
        f"{c.true * scale:.3f}" if known else "-",
        f"{c.estimate * scale:.3f}",
        f"{c.sigma * scale:.3f}" if fitted else "-",
        f"{c.error * scale:+.3f}" if known else "-",
        mark(c.inside_3_sigma) if known and fitted else "-",
        c.status,
    ]


def _pose_row(p: PoseLine) -> list[str | Cell]:
    return [
        str(p.number),
        p.place,
        " ".join(f"{x:.3f}" for x in p.tool_m),
        str(p.servo_steps),
        f"{p.res_pos_m * 1e3:.2f}",
        f"{p.res_rot_rad * 1e3:.2f}",
        f"{p.f:.3f}",
        f"{p.gp_mean:.3f} ± {p.gp_sigma:.3f}",
        f"{p.pred_pos_m * 1e3:.2f}",
        f"{p.pred_rot_rad * 1e3:.2f}",
        f"{p.held_pos_m * 1e3:.2f}",
        f"{p.held_rot_rad * 1e3:.2f}",
    ]


def write_all(result: RunResult, directory: Path, provenance: Provenance) -> tuple[list[Path], str]:
    """summary.html, .json and, where pictures can be made, .png in a directory.

    Returns the files, and why there is no picture ("" if there is one)."""
    data = json.dumps(result.as_dict(), indent=1, default=float) + "\n"
    files = [
        write(page(result, provenance), directory / "summary.html"),
        write_file(directory / "summary.json", data),
    ]
    return image.beside(files, {directory / "summary.png": run_figures.sheet(result)})
