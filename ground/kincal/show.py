"""Results as text for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from kincal.results import CoefResult, PoseLine, RunResult, angle_text, length_text, spans, summed

if TYPE_CHECKING:
    from kincal import lcmlog as lcmlog_mod
    from kincal import review as review_mod
    from kincal import space as space_mod
    from kincal import tables as tables_mod
    from kincal.space import apart as apart_mod
    from kincal.space import explain as explain_mod
    from kincal.space import worth as worth_mod


def grid(title: str, *columns: str, right: Sequence[int] = ()) -> Table:
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


def value_text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes, {sum(b.bit_count() for b in value)} bits set"
    if isinstance(value, list):
        return "[" + ", ".join(value_text(v) for v in value) + "]"
    if isinstance(value, dict):
        return " ".join(f"{k}={value_text(v)}" for k, v in value.items())
    return str(value)


# --------------------------------------------------------------------------- tables


def table(out: Console, image: tables_mod.Image, doc: dict[str, Any], rows_max: int = 400) -> None:
    """Scalars first, then every list of records as its own table."""
    out.print(
        f"[bold]{image.kind}[/] table, layout {image.version}, {len(image.data)} bytes, CRC {image.crc_text}"
    )
    scalars = grid("", "field", "value")
    records = {
        key: value
        for key, value in doc.items()
        if isinstance(value, list) and value and isinstance(value[0], dict)
    }
    for key, value in doc.items():
        if key in records:
            continue
        if isinstance(value, dict):
            for k, v in value.items():
                scalars.add_row(f"{key}.{k}", escape(value_text(v)))
        elif isinstance(value, list) and len(value) > 16 and not any(value):
            scalars.add_row(key, f"{len(value)} zeros")
        else:
            scalars.add_row(key, escape(value_text(value)))
    out.print(scalars)
    for key, rows in records.items():
        _records(out, key, rows[:rows_max])


def _records(out: Console, key: str, rows: list[dict[str, Any]]) -> None:
    shown = grid(f"\n{key}", "#", *rows[0], right=(0,))
    for i, row in enumerate(rows):
        shown.add_row(str(i), *(escape(_brief(v)) for v in row.values()))
    out.print(shown)


def _brief(value: Any) -> str:
    """A cell: long lists by their ends, bases without what is default."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        parts = []
        for b in value:
            if b.get("var") == "one":
                continue
            parts.append(
                f"{b['fn']}({b['var']}{b['index'] or ''}"
                + ("" if (b["c0"], b["c1"]) == (0.0, 1.0) else f"; {b['c0']:g}, {b['c1']:g}")
                + ")"
            )
        return " x ".join(parts) or "1"
    if isinstance(value, list) and len(value) > 8:
        return f"[{value_text(value[0])} … {value_text(value[-1])}] ({len(value)})"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return " ".join(f"{v:.4g}" if isinstance(v, float) else value_text(v) for v in value)
    return value_text(value)


def diff(out: Console, a: tables_mod.Image, b: tables_mod.Image, changes: list[tables_mod.Change]) -> None:
    out.print(f"{a.kind}: {a.crc_text} -> {b.crc_text}, {len(changes)} fields differ")
    if changes:
        rows = grid("", "field", "first", "second")
        for c in changes:
            rows.add_row(escape(c.path), escape(value_text(c.a)), escape(value_text(c.b)))
        out.print(rows)


# --------------------------------------------------------------------------- space


def space_built(out: Console, built: space_mod.Built, path: Path) -> None:
    out.print(
        f"{path}: {built.kept} candidates from {built.n_samples} samples, {built.first_looks} first looks, "
        f"{len(built.image.data)} bytes, CRC {built.image.crc_text}"
    )
    rows = grid("", "samples dropped", "because", right=(0,))
    for n, reason in summed(built.rejected):
        rows.add_row(str(n), reason)
    out.print(rows)


def space(out: Console, image: tables_mod.Image, n: space_mod.Numbers, picture: Path) -> None:
    out.print(f"[bold]search space[/], CRC {image.crc_text}")
    rows = grid("", "what", "value")
    rows.add_row("candidates, hubs", f"{n.candidates}, {n.hubs}")
    rows.add_row("first looks", f"{n.first_looks}, of which {n.spare} are spare")
    rows.add_row("prior poses", " ".join(map(str, n.priors)))
    rows.add_row("direct segments", str(n.direct_edges))
    rows.add_row(
        "box of the tool",
        " x ".join(f"{a:.3f}..{b:.3f} m" for a, b in zip(n.box_min_m, n.box_max_m, strict=True)),
    )
    rows.add_row("camera distance", f"{n.range_m[0]:.2f}..{n.range_m[1]:.2f} m")
    rows.add_row("incidence", f"{n.incid_deg[0]:.0f}..{n.incid_deg[1]:.0f} deg (most oblique tag in view)")
    rows.add_row("candidates with two tags in view", str(n.two_tags))
    rows.add_row("nearest neighbour", f"{n.nearest_m * 1e3:.0f} mm (median)")
    rows.add_row("servo leash", f"{spans(n.leash_rad)} rad")
    rows.add_row("candidates with a check missing", str(n.unchecked))
    rows.add_row("built for the arm table here", "yes" if n.arm_fits else f"NO: for {n.arm_crc:08x}")
    out.print(rows)
    out.print(f"pictures: {picture} and {picture.with_suffix('.html')}")


def space_candidate(out: Console, number: int, lines: list[explain_mod.Line]) -> None:
    rows = grid(f"candidate {number}", "", "check", "found", "wanted")
    for x in lines:
        rows.add_row("ok" if x.ok else "NO", x.check, escape(x.got), x.want)
    out.print(rows)


def space_corner(out: Console, at: tuple[float, ...], half_m: float, c: explain_mod.Corner) -> None:
    place = " ".join(f"{x:.2f}" for x in at)
    out.print(f"{c.good} of {c.examined} tool poses within {half_m:.2f} m of {place} could be candidates")
    rows = grid("", "dropped", "because", right=(0,))
    for n, reason in summed(c.reasons):
        rows.add_row(str(n), reason)
    out.print(rows)


def space_checked(out: Console, path: Path, n: int, n_first: int, found: explain_mod.Checked) -> None:
    share = found.touched / max(found.tried, 1)
    problems = len(found.problems) + len(found.bad_hubs)
    out.print(f"{path}: {n} candidates, {n_first} first looks, {problems} problems")
    out.print(f"servo boxes: {found.touched} of {found.tried} fresh postures touch ({share:.2%})")
    for what in found.bad_hubs:
        out.print(f"  {what}")
    for i, what in found.problems:
        out.print(f"  candidate {i}: {what}")


def space_diff(out: Console, a: tables_mod.Image, b: tables_mod.Image, d: explain_mod.Difference) -> None:
    rows = grid(f"{a.crc_text} -> {b.crc_text}", "what", "value")
    rows.add_row("candidates in both", str(d.same))
    rows.add_row("only in the first, only in the second", f"{len(d.only_a)}, {len(d.only_b)}")
    rows.add_row("hubs", f"{d.hubs[0]} -> {d.hubs[1]}" + (", moved" if d.hubs_differ else ""))
    rows.add_row("first looks", f"{d.first[0]} -> {d.first[1]}" + (", changed" if d.first_differ else ""))
    rows.add_row("servo leash", f"{spans(d.leash_rad[0])} -> {spans(d.leash_rad[1])} rad")
    rows.add_row("new candidate farthest from any old one", f"{d.farthest_new_m * 1e3:.0f} mm")
    rows.add_row("least kernel covariance of a new one with the old", f"{d.least_covariance:.3f}")
    out.print(rows)


def space_worth(out: Console, w: worth_mod.Worth) -> None:
    out.print(
        f"one look: {w.sigma_pos_m * 1e3:.2f} mm, {w.sigma_rot_rad * 1e3:.2f} mrad; "
        f"{w.rank} of {len(w.asked)} coefficients can be identified"
    )
    for name, like in w.held.items():
        out.print(
            f"  [bold]{name}[/] cannot: "
            + (f"acts like {', '.join(like)}" if like else "hardly shows at these poses")
        )
    rows = grid("", "poses", "chosen by", "rank", "worst angle", "worst length", "tool position", "rotation")
    for s in sorted(w.table, key=lambda s: s.n):
        value = [
            angle_text(s.angle_rad),
            length_text(s.length_m),
            length_text(s.pos_m),
            angle_text(s.rot_rad),
        ]
        rows.add_row(str(s.n), s.acquisition, str(s.rank), *value)
    out.print(rows)


def space_apart(out: Console, a: apart_mod.Apart) -> None:
    out.print(f"{a.tested} effects of the library, each at its typical size:")
    out.print("  would not show beside the parameters: " + (", ".join(a.unseen) or "none"))
    out.print(
        "  show but could not be told apart: " + ("; ".join(f"{x} / {y}" for x, y in a.twins) or "none")
    )
    worst = ", ".join(f"{name} {m * 1e3:.2f} mm" for name, m in a.harm_m)
    out.print(f"  could hide this much tool error: {worst}")


# --------------------------------------------------------------------------- run

EVENTS_SHOWN = 12
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
    shown = grid(
        "\nCorrections",
        "coefficient",
        "true",
        "estimated",
        "sigma",
        "error",
        "in sigma",
        "unit",
        "status",
        right=(1, 2, 3, 4, 5),
    )
    for c in rows:
        if c.idle:
            continue
        k, unit = (1e3, {"rad": "mrad", "m": "mm"}[c.unit]) if c.unit in ("rad", "m") else (1.0, c.unit)
        known, has = c.true == c.true, c.sigma > 0.0
        z = f"{abs(c.error) / c.sigma:.1f}" if known and has else "-"
        if known and has and not c.inside_3_sigma:
            z = f"[red]{z}[/]"
        shown.add_row(
            escape(c.name),
            f"{c.true * k:.3f}" if known else "-",
            f"{c.estimate * k:.3f}",
            f"± {c.sigma * k:.3f}" if has else "-",
            f"{c.error * k:+.3f}" if known else "-",
            z,
            unit,
            c.status,
        )
    out.print(shown)


def run_end(out: Console, r: RunResult, files: list[Path]) -> None:
    """Everything after the last pose."""
    if r.coefs:
        coefs(out, r.coefs)
    if r.before and r.after:
        shown = grid(
            f"\nPose error over {r.after.n} held-out poses", "", "position RMS", "rotation RMS", right=(1, 2)
        )
        for name, h in (("before", r.before), ("after", r.after)):
            shown.add_row(name, length_text(h.pos_m), angle_text(h.rot_rad))
        out.print(shown)
    fit = (
        f"; rank {r.rank} of {r.n_free}; p of the fit {r.p_fit:.3f}; p of no change {r.p_no_change:.2g}"
        if r.n_free
        else ""
    )
    out.print(f"\nverdict: {r.verdict}{fit}; decision: {r.decision}; table in force {r.active_crc:08x}")
    gates = grid("", "", "gate", "got", "wanted")
    for g in r.gates:
        gates.add_row(
            "[green]ok[/]" if g.ok else "[red]MISSED[/]", escape(g.name), escape(g.got), escape(g.want)
        )
    out.print(gates)
    more = len(r.events) - EVENTS_SHOWN
    for i, line in enumerate(r.events):
        if i < EVENTS_SHOWN // 2 or i >= len(r.events) - EVENTS_SHOWN // 2:  # how it ended comes last
            out.print(f"[yellow]{escape(line)}[/]")
        elif i == EVENTS_SHOWN // 2:
            out.print(f"... {more} more warnings, see the log")
    for path in files:
        out.print(f"{path}")
    out.print(
        f"{'[green]passed[/]' if r.ok else '[red]FAILED[/]'} in {r.wall_s:.0f} s "
        f"({r.mission_s:.0f} s of mission time)"
    )


# --------------------------------------------------------------------------- log, review


def log(out: Console, s: lcmlog_mod.LogSummary, debug: bool) -> None:
    from kincal import channels

    out.print(f"[bold]{s.path}[/]: {s.n_messages} messages, {s.mission_s:.1f} s of mission time")
    rows = grid("", "channel", "messages", right=(1,))
    for name, n in sorted(s.counts.items()):
        note = f" ({s.undecodable[name]} damaged)" if s.undecodable[name] else ""
        rows.add_row(name, f"{n}{note}")
    out.print(rows)
    for session in s.sessions.values():
        _session(out, session)
    rows = grid("\nEvents", "time [s]", "severity", "text", right=(0,))
    for e in s.events:
        if e.severity != "debug" or debug:
            rows.add_row(f"{e.t_us * 1e-6:.1f}", e.severity, escape(e.text))
    out.print(rows)
    refused = [a for a in s.acks if a.status != 0]
    out.print(f"\n{len(s.commands)} commands, {len(s.acks)} answers, {len(refused)} refused")
    if s.hk is not None:
        out.print(
            f"last state {channels.named(channels.STATES, s.hk.state)}, kinematics table "
            f"{channels.crc32_text(s.hk.table_crc[4])}, boots {s.hk.boot_count}"
        )


def _session(out: Console, session: lcmlog_mod.Session) -> None:
    from kincal import channels

    out.print(f"\n[bold]calibration {session.number}[/]: {len(session.progress)} poses")
    if session.progress:
        out.print(POSE_HEAD.removesuffix("     held-out"))
    for p in session.progress:
        out.print(
            pose_line(
                PoseLine(
                    p.pose + 1,
                    p.candidate,
                    p.servo_steps,
                    (0.0, 0.0, 0.0),
                    p.res_pos_m,
                    p.res_rot_rad,
                    p.f,
                    p.gp_mean,
                    p.gp_sigma,
                    p.pred_pos_m,
                    p.pred_rot_rad,
                ),
                p.n_goal,
            )
        )
    p = session.proposal
    if p is not None:
        out.print(
            f"proposal {channels.crc32_text(p.crc)}: {channels.named(channels.VERDICTS, p.verdict)}, rank "
            f"{p.rank} of {p.n_free}, p of the fit {p.p_fit:.3f}, residual "
            f"{length_text(p.before_pos_m)} -> {length_text(p.fit_pos_m)}"
        )


def proposals(out: Console, listed: list[list[review_mod.Listed]]) -> None:
    rows = grid(
        "", "CRC", "verdict", "poses", "residual before", "after", "p of the fit", "log", right=(2, 3, 4, 5)
    )
    n = 0
    for one_log in listed:
        for p in one_log:
            n += 1
            rows.add_row(
                f"{p.crc:08x}",
                p.verdict,
                str(p.n_poses),
                length_text(p.before_pos_m),
                length_text(p.fit_pos_m),
                f"{p.p_fit:.3f}",
                escape(str(p.log)),
            )
    if n:
        out.print(rows)
    elif listed:
        out.print("no proposals in these logs")


def decisions(out: Console, entries: list[review_mod.Entry], journal: Path) -> None:
    if not entries:
        out.print(f"no decisions in {journal}")
        return
    rows = grid(f"\nDecisions in {journal}", "time", "decision", "CRC", "by", "why")
    for e in entries:
        rows.add_row(e.time, e.decision, e.crc, escape(e.by), escape(e.why))
    out.print(rows)


def review(out: Console, r: review_mod.Review, worries: list[str], picture: Path) -> None:
    from kincal.review import NUMBERS

    out.print(
        f"[bold]correction {r.crc_text}[/]: {r.verdict}; session {r.session}, {r.n_poses} poses, replaces "
        f"{r.crc_before:08x}"
    )
    rows = grid(
        "\nCoefficients",
        "coefficient",
        "value",
        "sigma",
        "value/sigma",
        "unit",
        "status",
        "cannot be told from",
        right=(1, 2, 3),
    )
    for c in r.coefs:
        if c.status == "masked" and c.value == 0.0:
            continue
        k, unit = (1e3, {"rad": "mrad", "m": "mm"}[c.unit]) if c.unit in ("rad", "m") else (1.0, c.unit)
        rows.add_row(
            escape(c.name),
            f"{c.value * k:.3f}",
            f"± {c.sigma * k:.3f}" if c.sigma > 0 else "-",
            f"{c.z:+.1f}" if c.sigma > 0 else "-",
            unit,
            c.status,
            escape(", ".join(c.entangled)),
        )
    out.print(rows)
    masked = sum(c.status == "masked" and c.value == 0.0 for c in r.coefs)
    if masked:
        out.print(f"{masked} masked coefficients at zero not listed")
    rows = grid("\nNumbers", "", "", "what", right=(1,))
    for key, unit, text in NUMBERS:
        x = r.numbers[key]
        rows.add_row(
            key, angle_text(x) if unit == "rad" else length_text(x) if unit == "m" else f"{x:.4g}", text
        )
    out.print(rows)
    for line in worries:
        out.print(f"[yellow]look at: {escape(line)}[/]")
    if not worries:
        out.print("nothing stands out")
    out.print(f"picture: {picture}")
    if r.changes_something:
        out.print(f"to decide: kincal review approve {r.crc_text} --by NAME --why TEXT   (or reject)")
