"""The diagnosis as one self-contained page, and its figures as PNG beside it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import figures
from .answers import VERDICTS, diagnosis_text, in_words
from .diagnose import Diagnosis
from .effects import Library
from .ladder import Ladder
from .power import Confounding, Harm

_CSS = """
body{font:15px/1.5 system-ui,sans-serif;color:#22303c;max-width:1000px;margin:2em auto;padding:0 1em}
img{max-width:100%}
pre{background:#f4f6f8;padding:1em;overflow-x:auto;font-size:12.5px}
table{border-collapse:collapse;font-size:13px}
td,th{border:1px solid #d5dce2;padding:.25em .6em;text-align:left;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}
.verdict{border-left:6px solid #1f6fb4;background:#f4f6f8;padding:.6em 1.2em;margin:1em 0}
.verdict>b{font-size:1.25em}
.ladder b{font-variant-numeric:tabular-nums}
"""


@dataclass(frozen=True)
class Content:
    """Everything a report shows."""

    diagnosis: Diagnosis
    library: Library
    ladder: Ladder
    confounding: Confounding
    harm: list[Harm]
    next_poses: list[dict]  # as in the JSON answer


def _plots(c: Content) -> list[tuple[str, str, Callable[[], figures.plt.Figure]]]:
    """(file key, heading, maker) of every figure."""
    d = c.diagnosis
    out = [
        ("ladder", "Error ladder", lambda: figures.ladder(c.ladder)),
        ("posterior", "Probabilities", lambda: figures.posterior(d)),
        ("suspects", "The strongest suspects among the joints", lambda: figures.suspects(d)),
        ("map", "Where the error enters and what it depends on", lambda: figures.heat_map(d)),
        ("vectors", "Residual vectors", lambda: figures.vectors(d)),
        ("variables", "Residuals by variable", lambda: figures.variables(d)),
        ("joints", "Residuals by joint", lambda: figures.joints(d)),
        ("confounding", "Confounding", lambda: figures.confounding(c.confounding)),
        ("harm", "What could still be wrong", lambda: figures.harm(c.harm)),
    ]
    if c.next_poses:
        limits = np.array([[j.q_min, j.q_max] for j in d.final.chain.arm.joints]).T
        q = np.array([p["q"] for p in c.next_poses])
        power = [p["power"] for p in c.next_poses]
        out.append(("next", "Next poses", lambda: figures.next_poses(q, *limits, power)))
    return out


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def cell(text: str) -> str:
        number = text.replace(".", "").replace("-", "").replace("e", "").isdigit()
        return f"<td{' class=n' if number else ''}>{html.escape(text)}</td>"

    body = "".join("<tr>" + "".join(map(cell, row)) + "</tr>" for row in rows)
    return "<table><tr>" + "".join(f"<th>{html.escape(h)}</th>" for h in head) + f"</tr>{body}</table>"


def _effects_table(d: Diagnosis) -> str:
    rows = [
        (
            e.name,
            "added" if e.accepted else "rival",
            f"{e.probability:.3f}",
            f"{e.p_value:.2g}",
            f"{e.held_rms_before_m * 1e3:.3f}",
            f"{e.held_rms_after_m * 1e3:.3f}",
            "; ".join(f"{p.name} = {p.value:.4g} +- {p.std_err:.2g} {p.unit}" for p in e.parameters),
            ", ".join(e.confounded_with),
        )
        for e in d.effects
    ]
    head = ("effect", "", "probability", "family-wise p", "held out before [mm]", "after [mm]", "parameters",
            "cannot be told from")  # fmt: skip
    return _table(head, rows)


def _ladder_table(ladder: Ladder) -> str:
    rows = []
    for r in ladder.rungs:
        ratio = ("", "") if r.ratio is None or r.ratio_interval is None else (
            f"{r.ratio:.3f}", "{:.3f} to {:.3f}".format(*r.ratio_interval)
        )  # fmt: skip
        rot = "" if r.rot_rad is None else f"{r.rot_rad * 1e3:.3f}"
        system = "" if r.sys_pos_m is None else f"{r.sys_pos_m * 1e3:.3f}"
        rows.append(
            (r.model, r.block, f"{r.pos_m * 1e3:.3f}", rot, system, f"{r.max_pos_m * 1e3:.3f}", *ratio)
        )
    head = ("model", "held out", "RMS [mm]", "RMS [mrad]", "without noise [mm]", "worst [mm]",
            "ratio to the rung before", "95 % interval")  # fmt: skip
    return _table(head, rows) + "".join(f"<p>{html.escape(v)}</p>" for v in ladder.verdicts)


def _poses_table(poses: list[dict]) -> str:
    rows = [
        (
            str(k),
            ", ".join(f"{x:.3f}" for x in p["q"]),
            "" if p["direction"] is None else " ".join(f"{s:+d}" for s in p["direction"]),
            f"{p['power']:.2f}",
        )
        for k, p in enumerate(poses, 1)
    ]
    names = html.escape(", ".join(poses[0]["separates"]))
    text = f"<p>They separate {names}; power counts the poses above too.</p>"
    return text + _table(("#", "q", "approach", "power"), rows)


def _error_line(ladder: Ladder) -> str:
    """The first way of holding back, rung by rung: what a reader looks for first."""
    rungs = ladder.of(ladder.rungs[0].block)
    steps = " &rarr; ".join(f"{html.escape(r.model)} <b>{r.pos_m * 1e3:.2f} mm</b>" for r in rungs)
    floor = "unknown" if ladder.floor.pos_m is None else f"<b>{ladder.floor.pos_m * 1e3:.2f} mm</b>"
    return f"<p class=ladder>RMS error on {html.escape(rungs[0].block)}: {steps}; noise floor {floor}.</p>"


def _findings(c: Content) -> list[str]:
    """What was found, each with what to look at on the arm."""
    d, lines = c.diagnosis, []
    for e in d.effects:
        if not (e.accepted or e.helps):
            continue
        effect = c.library.effects[e.name.partition("[")[0]]
        sure = f"probability {e.probability:.2f}" if e.accepted else "not certain, but held-out poses gain"
        twins = f" Cannot be told from {', '.join(e.confounded_with)}." if e.confounded_with else ""
        lines.append(f"<b>{html.escape(e.name)}</b> ({sure}): {html.escape(effect.title)}."
                     f"{html.escape(twins)} Look at: {html.escape(effect.inspect)}")  # fmt: skip
    if d.novel:
        drivers = " and ".join(in_words(name) for name in d.novel.depends_on)
        lines.append(f"<b>Something unnamed</b> enters at {html.escape(d.novel.locus)} and depends on "
                     f"{html.escape(drivers)} (probability {d.novel.probability:.2f}).")  # fmt: skip
    if c.next_poses:
        names = html.escape(", ".join(c.next_poses[0]["separates"]))
        lines.append(f"The {len(c.next_poses)} poses under <a href='#next'>Next poses</a> separate {names}.")
    lacking = [n for n in d.not_testable if n.needs]
    if lacking:
        lines.append(f"{len(lacking)} effects of the library could not be tested: columns or arm data are "
                     "missing (list under <i>The answer as text</i>).")  # fmt: skip
    return lines


def _head(c: Content) -> str:
    found = "".join(f"<li>{line}</li>" for line in _findings(c))
    return (
        f"<div class=verdict><b>{html.escape(VERDICTS[c.diagnosis.verdict])}</b>{_error_line(c.ladder)}"
        f"{'<ul>' + found + '</ul>' if found else ''}</div>"
        "<details><summary>The answer as text</summary>"
        f"<pre>{html.escape(diagnosis_text(c.diagnosis, c.next_poses))}</pre></details>"
    )


def write_report(path: str | Path, content: Content) -> list[Path]:
    """One HTML with everything inside, and the figures beside it as PNG. Returns all files."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    d = content.diagnosis
    beside = {"ladder": _ladder_table(content.ladder), "posterior": _effects_table(d) if d.effects else ""}
    if content.next_poses:
        beside["next"] = _poses_table(content.next_poses)
    files, parts = [], []
    with figures.plt.rc_context(figures.STYLE):
        for key, title, make in _plots(content):
            figure, buffer = make(), io.BytesIO()
            figure.savefig(buffer, format="png", dpi=130)
            figures.plt.close(figure)
            file = path.with_name(f"{path.stem}-{key}.png")
            file.write_bytes(buffer.getvalue())
            files.append(file)
            image = base64.b64encode(buffer.getvalue()).decode()
            title = html.escape(title)
            parts.append(
                f'<h2 id="{key}">{title}</h2><img alt="{title}" src="data:image/png;base64,{image}">'
            )
            parts.append(beside.get(key, ""))
    about = html.escape(f"{d.comparison.arm}, {d.comparison.source}")
    path.write_text(
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>KinCal diagnosis</title>"
        f"<style>{_CSS}</style><h1>Model diagnosis</h1><p>{about}</p>"
        f"{_head(content)}{''.join(parts)}</html>",
        encoding="utf-8",
    )
    return [path, *files]
