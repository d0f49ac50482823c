"""One HTML page of a run that opens from disk, without any server or network."""

from __future__ import annotations

import html
import json
from pathlib import Path

from kincal import pictures
from kincal.results import RunResult, angle_text, length_text

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #22303c; max-width: 1180px;
       margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; margin-bottom: 0.1em; } h2 { font-size: 1.15em; margin-top: 2em; }
p.sub { color: #66737f; margin-top: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.92em; }
th, td { padding: 0.22em 0.8em; text-align: right; border-bottom: 1px solid #e3e8ec; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } th { color: #66737f; font-weight: 600; }
td.text, th.text { text-align: left; white-space: normal; }
.tiles { display: flex; flex-wrap: wrap; gap: 0.8em; margin: 1.2em 0; }
.tile { border: 1px solid #d5dce2; border-radius: 6px; padding: 0.6em 1em; min-width: 9em; }
.tile b { display: block; font-size: 1.35em; } .tile span { color: #66737f; font-size: 0.85em; }
.ok { color: #2c8a4b; } .bad { color: #c0392b; }
.wide { overflow-x: auto; }
"""


def _table(head: list[str], rows: list[list[str]], text_columns: tuple[int, ...] = ()) -> str:
    def cell(tag: str, i: int, content: str) -> str:
        cls = " class='text'" if i in text_columns else ""
        return f"<{tag}{cls}>{content}</{tag}>"

    out = [
        "<div class='wide'><table><tr>",
        *(cell("th", i, html.escape(h)) for i, h in enumerate(head)),
        "</tr>",
    ]
    for row in rows:
        out += ["<tr>", *(cell("td", i, c) for i, c in enumerate(row)), "</tr>"]
    return "".join(out) + "</table></div>"


def _tile(label: str, value: str, cls: str = "") -> str:
    return f"<div class='tile'><b class='{cls}'>{value}</b><span>{html.escape(label)}</span></div>"


def _mark(ok: bool, yes: str = "yes", no: str = "no") -> str:
    return f"<span class='{'ok' if ok else 'bad'}'>{yes if ok else no}</span>"


def render(result: RunResult) -> str:
    """The page as text."""
    r = result
    parts = [
        f"<h1>{html.escape(r.title)}</h1>",
        f"<p class='sub'>scenario {html.escape(r.scenario)}, {html.escape(r.mode)}, acquisition "
        f"{html.escape(r.acquisition)}, seed {r.seed}; {r.mission_s:.0f} s of mission time in "
        f"{r.wall_s:.0f} s</p>",
        "<div class='tiles'>",
        _tile("result", "passed" if r.ok else "failed", "ok" if r.ok else "bad"),
    ]
    if r.before and r.after:
        parts += [
            _tile(
                f"held-out position RMS, {r.after.n} poses",
                f"{length_text(r.before.pos_m)} → {length_text(r.after.pos_m)}",
            ),
            _tile("held-out rotation RMS", f"{angle_text(r.before.rot_rad)} → {angle_text(r.after.rot_rad)}"),
        ]
    parts += [
        _tile("poses", f"{len(r.poses)} of {r.n_goal}"),
        _tile("verdict of flight", html.escape(r.verdict)),
        _tile("decision", html.escape(r.decision)),
        _tile("rank of free", f"{r.rank} of {r.n_free}"),
        _tile("p of the fit", f"{r.p_fit:.3f}"),
        _tile("table in force", f"{r.active_crc:08x}"),
        "</div>",
    ]
    parts.append(
        "<h2>Gates</h2>"
        + _table(
            ["criterion", "got", "wanted", "met"],
            [[html.escape(g.name), html.escape(g.got), html.escape(g.want), _mark(g.ok)] for g in r.gates],
            (0,),
        )
    )
    first = True

    def plot(figure: object) -> str:
        nonlocal first
        text = figure.to_html(
            full_html=False, include_plotlyjs=first, config={"displaylogo": False, "displayModeBar": False}
        )  # type: ignore[attr-defined]
        first = False
        return str(text)

    if r.scene is not None:
        parts += ["<h2>Arm and chosen poses</h2>", plot(pictures.page_scene(r.scene, r))]
    if r.curves:
        parts += ["<h2>Progress by number of poses</h2>", plot(pictures.page_progress(r))]
    if r.coefs:
        parts += ["<h2>Corrections</h2>", plot(pictures.page_coefs(r)), _coef_table(r)]
    parts += ["<h2>Poses</h2>", _pose_table(r)]
    if r.events:
        parts += [
            "<h2>Warnings and errors from flight</h2>",
            _table(["event"], [[html.escape(e)] for e in r.events], (0,)),
        ]
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{html.escape(r.title)}</title>"
        f"<style>{STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )


def _coef_table(r: RunResult) -> str:
    shown = [c for c in r.coefs if not c.idle]
    rest = len(r.coefs) - len(shown)
    rows = []
    for c in shown:
        k, unit = (1e3, {"rad": "mrad", "m": "mm"}[c.unit]) if c.unit in ("rad", "m") else (1.0, c.unit)
        known = c.true == c.true
        rows.append(
            [
                html.escape(c.name),
                unit,
                f"{c.true * k:.3f}" if known else "-",
                f"{c.estimate * k:.3f}",
                f"{c.sigma * k:.3f}" if c.sigma > 0 else "-",
                f"{c.error * k:+.3f}" if known else "-",
                _mark(c.inside_3_sigma) if known and c.sigma > 0 else "-",
                html.escape(c.status),
            ]
        )
    table = _table(
        ["coefficient", "unit", "true", "estimate", "1 sigma", "error", "within 3 sigma", "status"],
        rows,
        (0, 1, 7),
    )
    return table + (f"<p>{rest} masked coefficients at zero are not listed.</p>" if rest else "")


def _pose_table(r: RunResult) -> str:
    return _table(
        [
            "pose",
            "candidate",
            "tool x y z [m]",
            "servo steps",
            "residual [mm]",
            "[mrad]",
            "f",
            "GP mean ± sigma",
            "predicted sigma [mm]",
            "[mrad]",
            "held-out [mm]",
            "[mrad]",
        ],
        [
            [
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
            for p in r.poses
        ],
    )


def write(result: RunResult, directory: Path) -> list[Path]:
    """summary.html, summary.png and summary.json in a directory."""
    directory.mkdir(parents=True, exist_ok=True)
    page, sheet, data = (directory / f"summary.{kind}" for kind in ("html", "png", "json"))
    page.write_text(render(result), "utf-8")
    pictures.save_png(result, sheet)
    data.write_text(json.dumps(result.as_dict(), indent=1, default=float) + "\n", "utf-8")
    return [page, sheet, data]
