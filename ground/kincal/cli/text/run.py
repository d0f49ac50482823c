"""A run as text: one line a pose, then what came out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from kincal.cli.text.layout import grid
from kincal.link.names import VERDICTS
from kincal.results import CoefResult, PoseLine, RunResult, angle_text, length_text

EVENTS_SHOWN = 12
_MILLI = {"rad": "mrad", "m": "mm"}
POSE_HEAD = "pose   cand  servo   residual            f      predicted sigma     held-out"


def pose_line(p: PoseLine, n_goal: int) -> str:
    """One line a pose."""
    held = (
        ""
        if p.held_pos_m != p.held_pos_m
        else f"  {p.held_pos_m * 1e3:8.2f} mm {p.held_rot_rad * 1e3:7.2f} mrad"
    )
    return (
        f"{p.number:2d}/{n_goal:<2d} {p.place:>5s}  {p.servo_steps:3d}  {p.res_pos_m * 1e3:8.2f} mm "
        f"{p.res_rot_rad * 1e3:8.2f} mrad  {p.f:7.3f}  {p.pred_pos_m * 1e3:7.2f} mm "
        f"{p.pred_rot_rad * 1e3:7.2f} mrad{held}"
    )


def coefs(out: Console, rows: Sequence[CoefResult]) -> None:
    """True and estimated values of all corrections."""
    columns = ("coefficient", "true", "estimated", "sigma", "error", "in sigma", "unit", "status")
    shown = grid("\nCorrections", *columns, right=(1, 2, 3, 4, 5))
    for c in rows:
        if not c.idle:
            shown.add_row(*_coef_cells(c))
    out.print(shown)


def _coef_cells(c: CoefResult) -> tuple[str, ...]:
    k, unit = (1e3, _MILLI[c.unit]) if c.unit in _MILLI else (1.0, c.unit)
    known, fitted = c.true == c.true, c.sigma > 0.0
    z = f"{abs(c.error) / c.sigma:.1f}" if known and fitted else "-"
    return (
        escape(c.name),
        f"{c.true * k:.3f}" if known else "-",
        f"{c.estimate * k:.3f}",
        f"± {c.sigma * k:.3f}" if fitted else "-",
        f"{c.error * k:+.3f}" if known else "-",
        f"[red]{z}[/]" if known and fitted and not c.inside_3_sigma else z,
        unit,
        c.status,
    )


def run_end(out: Console, r: RunResult, files: Sequence[Path], log: Path) -> None:
    """Everything after the last pose; log: of the run."""
    if r.coefs:
        coefs(out, r.coefs)
    _held_out(out, r)
    fit = (
        f"; rank {r.rank} of {r.n_free}; p of the fit {r.p_fit:.3f}; p if nothing changed {r.p_no_change:.2g}"
        if r.n_free
        else ""
    )
    out.print(f"\nverdict: {r.verdict}{fit}; decision: {r.decision}; table in force {r.active_crc:08x}")
    if r.ended:
        out.print(f"measuring ended: {r.ended}")
    _criteria(out, r)
    _events(out, r)
    for path in (*files, log):
        out.print(f"{path}")
    ended = "[green]passed[/]" if r.ok else "[red]FAILED[/]"
    out.print(f"{ended} in {r.wall_s:.0f} s ({r.mission_s:.0f} s of mission time)")
    if not r.ok:
        out.print(f"to do: {escape(_next_step(r, log))}", soft_wrap=True)


def _next_step(r: RunResult, log: Path) -> str:
    """What to look at after a run that failed."""
    if not r.n_free:
        return (
            f"`kincal log {log}` lists what flight said: its last warnings say why no correction was "
            "proposed; docs/OPERATIONS.md has the causes of an aborted calibration"
        )
    if r.verdict == VERDICTS["POOR"]:
        return (
            f"`kincal review show {log}` says what is poor; `kincal model diagnose --arm ARM --data {log}` "
            "what the model lacks"
        )
    return (
        f"the criteria marked MISSED say what; `kincal review show {log}` shows the correction with its "
        f"numbers and residuals, `kincal log {log}` what flight said"
    )


def _held_out(out: Console, r: RunResult) -> None:
    if not (r.before and r.after):
        return
    title = f"\nPose error over {r.after.n} held-out poses"
    shown = grid(title, "", "position RMS", "rotation RMS", right=(1, 2))
    for name, h in (("before", r.before), (r.after_is, r.after)):
        shown.add_row(name, length_text(h.pos_m), angle_text(h.rot_rad))
    out.print(shown)


def _criteria(out: Console, r: RunResult) -> None:
    shown = grid("", "", "criterion", "got", "wanted")
    for c in r.criteria:
        mark = "[green]ok[/]" if c.ok else "[red]MISSED[/]"
        shown.add_row(mark, escape(c.name), escape(c.got), escape(c.want))
    out.print(shown)


def _events(out: Console, r: RunResult) -> None:
    """The first and the last ones: how it ended comes last."""
    half = EVENTS_SHOWN // 2
    more = len(r.events) - EVENTS_SHOWN
    for i, line in enumerate(r.events):
        if i < half or i >= len(r.events) - half:
            out.print(f"[yellow]{escape(line)}[/]")
        elif i == half:
            out.print(f"... {more} more warnings, see the log")
