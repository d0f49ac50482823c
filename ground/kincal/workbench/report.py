"""The diagnosis as one self-contained page, and its figures as PNG: data first, rendering second."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from .answers import diagnosis_text
from .columns import Columns
from .diagnose import Diagnosis
from .effects import Hypothesis
from .ladder import Ladder
from .nextposes import NextPose
from .novel import drivers
from .power import Confounding, Harm

INK, GREY, BLUE, ORANGE, GREEN, RED = "#22303c", "#8a97a3", "#1f6fb4", "#e07b1a", "#2c8a4b", "#c0392b"
_STYLE = {
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "#e3e8ec",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def figure_ladder(ladder: Ladder) -> plt.Figure:
    """Held-out error of each model, one line per way of holding back, and the noise floor."""
    fig, ax = plt.subplots(figsize=(7.5, 3.6))
    labels = list(dict.fromkeys(r.model for r in ladder.rungs))
    for (block, colour), mark in zip(
        zip(dict.fromkeys(r.block for r in ladder.rungs), (BLUE, ORANGE, GREEN, RED), strict=False),
        "os^D",
        strict=False,
    ):
        rungs = ladder.of(block)
        ax.plot(
            [labels.index(r.model) for r in rungs],
            [r.pos_m * 1e3 for r in rungs],
            mark + "-",
            color=colour,
            label=block,
        )
    if ladder.floor.pos_m is not None:
        ax.axhline(
            ladder.floor.pos_m * 1e3, color=GREY, ls="--", label=f"noise floor ({ladder.floor.source})"
        )
    ax.set_yscale("log")
    ax.set_xticks(range(len(labels)), labels, rotation=15 if len(labels) > 4 else 0)
    ax.set_ylabel("held-out position RMS [mm]")
    ax.set_title("Add it, watch the error fall")
    ax.yaxis.set_major_formatter(plt.FuncFormatter(lambda v, _: f"{v:g}"))
    ax.legend(fontsize=8)
    return fig


def figure_posterior(d: Diagnosis) -> plt.Figure:
    """Probabilities, twins bracketed in the label."""
    rows = [("nothing missing", d.probability_none, GREY)]
    if d.novel:
        rows.append(
            (
                f"not in the library: {d.novel.locus} | {' x '.join(d.novel.depends_on)}",
                d.novel.probability,
                RED,
            )
        )
    for e in d.effects:
        twins = f"  [= {', '.join(e.confounded_with[:3])}]" if e.confounded_with else ""
        rows.append((e.name + twins, e.probability, BLUE if e.accepted else ORANGE))
    fig, ax = plt.subplots(figsize=(7.5, 0.8 + 0.38 * len(rows)))
    y = np.arange(len(rows))[::-1]
    ax.barh(y, [r[1] for r in rows], color=[r[2] for r in rows], height=0.6)
    for k, row in zip(y, rows, strict=True):
        ax.text(min(row[1] + 0.01, 0.9), k, f"{row[1]:.2f}", va="center", fontsize=8, color=INK)
    ax.set_yticks(y, [r[0] if len(r[0]) < 64 else r[0][:61] + "..." for r in rows])
    ax.set_xlim(0, 1.08)
    ax.axvline(0.9, color=GREY, lw=0.8, ls=":")
    ax.set_xlabel("probability, given this library and its priors")
    ax.set_title("What is missing")
    return fig


def figure_map(d: Diagnosis) -> plt.Figure:
    """Where x depends on what: ln Bayes factor against 'nothing missing', single drivers."""
    cells = {key: v for key, v in d.map_ln_bf.items() if " x " not in key[1]}
    rows = list(dict.fromkeys(k[0] for k in cells))
    cols = list(dict.fromkeys(k[1] for k in cells))
    grid = np.full((len(rows), len(cols)), np.nan)
    for (row, col), value in cells.items():
        grid[rows.index(row), cols.index(col)] = value
    fig, ax = plt.subplots(figsize=(9, 0.9 + 0.24 * len(rows)))
    top = max(3.0, float(np.nanmax(grid)))
    image = ax.imshow(grid, aspect="auto", cmap="magma_r", vmin=0.0, vmax=top)
    ax.set_xticks(range(len(cols)), cols, rotation=60, fontsize=7)
    ax.set_yticks(range(len(rows)), rows, fontsize=7)
    ax.grid(False)
    ax.set_title("Where the error enters x what it depends on (before anything was added)")
    fig.colorbar(image, ax=ax, label="ln evidence over 'none'", shrink=0.8)
    return fig


def figure_vectors(d: Diagnosis) -> plt.Figure:
    """Residual position vectors over the workspace, before and after the accepted effects."""
    fig, axes = plt.subplots(1, 2, figsize=(9.5, 4.0))
    pairs = ((d.comparison.fit_all, "before (DH only)"), (d.final, "after the accepted effects"))
    size = np.sqrt((d.comparison.fit_all.evaluation.r[:, :3] ** 2).sum(axis=1).mean())
    for ax, (fit, title) in zip(axes, pairs, strict=True):
        p, r = fit.chain.data.p_m, fit.evaluation.r
        span = float(np.ptp(p[:, :2], axis=0).max()) or 1.0
        ax.quiver(
            p[:, 0], p[:, 1], r[:, 0], r[:, 1], r[:, 2] * 1e3, cmap="coolwarm", angles="xy", scale_units="xy",
            scale=max(size, 1e-12) / (0.08 * span), width=0.004, clim=(-2e3 * size, 2e3 * size),
        )  # fmt: skip
        rms = np.sqrt((r[:, :3] ** 2).sum(axis=1).mean())
        ax.set_title(f"{title}: {rms * 1e3:.2f} mm RMS")
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
        ax.set_aspect("equal", adjustable="datalim")
    fig.suptitle(
        f"Residuals from above (arrows magnified {0.08 * span / max(size, 1e-12):.0f}x, colour: z)",
        fontsize=9,
    )
    return fig


def figure_variables(d: Diagnosis, count: int = 8) -> plt.Figure:
    """Standardised residual size against the variables that explain most of it."""
    fit = d.comparison.fit_all
    names = [w.variable for w in d.comparison.where[:count]]
    values = {}
    data = fit.chain.data
    for name in names:
        values[name] = _variable(name, fit, data)
    names = [n for n in names if values[n] is not None]
    rows = (len(names) + 3) // 4
    fig, axes = plt.subplots(rows, 4, figsize=(9.5, 2.1 * rows), squeeze=False, sharey=True)
    r = fit.evaluation.r
    for ax, name in zip(axes.ravel(), names, strict=False):
        for k, (axis, colour) in enumerate(zip("xyz", (RED, GREEN, BLUE), strict=True)):
            ax.plot(values[name], r[:, k] * 1e3, ".", ms=3, color=colour, label=axis)
        ax.set_xlabel(name)
    for ax in axes.ravel()[len(names) :]:
        ax.axis("off")
    axes[0, 0].legend(fontsize=7)
    for ax in axes[:, 0]:
        ax.set_ylabel("residual [mm]")
    fig.suptitle("What DH leaves, against the variables that explain most of it", fontsize=9)
    return fig


def _variable(name: str, fit, data):
    if name[0] == "q" and name[1:].isdigit():
        return data.q[:, int(name[1:]) - 1]
    if name.startswith("dir"):
        return data.direction[:, int(name[3:]) - 1]
    if name.startswith("qdot"):
        return data.qdot[:, int(name[4:]) - 1]
    plain = {"t": data.t_s, "order": data.t_s, "temp": data.temp_c, "payload": data.payload_kg, "incid": data.incid_rad,
             "pan": data.pan_rad, "tilt": data.tilt_rad, "tag": data.tag}  # fmt: skip
    if name in plain:
        return plain[name]
    for driver in drivers(Columns(fit)):
        if driver.name == name:
            return driver.features[:, 0]
    return None


def figure_joints(d: Diagnosis) -> plt.Figure:
    """The joint motion that would explain each pose's residual (a view, not a test), before and after."""
    fig, ax = plt.subplots(figsize=(7.5, 2.8))
    for offset, (fit, colour, label) in enumerate(
        ((d.comparison.fit_all, ORANGE, "before"), (d.final, BLUE, "after"))
    ):
        jq = np.einsum("nij,njk->nik", fit.whiten, fit.evaluation.Jq)
        z = fit.z.reshape(len(jq), -1)
        prior = np.eye(jq.shape[2]) / 3e-3**2
        dq = np.array([np.linalg.solve(a.T @ a + prior, a.T @ b) for a, b in zip(jq, z, strict=True)])
        x = np.arange(dq.shape[1]) + 1 + 0.3 * (offset - 0.5)
        ax.bar(x, np.sqrt((dq**2).mean(axis=0)) * 1e3, width=0.28, color=colour, label=label)
    ax.set_xlabel("joint")
    ax.set_ylabel("RMS [mrad]")
    ax.set_title("Joint motion that would explain the residuals")
    ax.legend()
    return fig


def figure_confounding(c: Confounding) -> plt.Figure:
    """d^2(i|j), logarithmic; below 9 a pair cannot be told apart."""
    fig, ax = plt.subplots(figsize=(1.8 + 0.42 * len(c.names), 1.4 + 0.36 * len(c.names)))
    shown = np.log10(np.maximum(c.d2, 0.1))
    image = ax.imshow(shown, cmap="viridis", vmin=-1, vmax=3)
    for i in range(len(c.names)):
        for j in range(len(c.names)):
            ax.text(j, i, f"{c.d2[i, j]:.0f}", ha="center", va="center", fontsize=6.5,
                    color="white" if shown[i, j] < 1.4 else "black")  # fmt: skip
    ax.set_xticks(range(len(c.names)), c.names, rotation=60, ha="right", fontsize=7)
    ax.set_yticks(range(len(c.names)), c.names, fontsize=7)
    ax.grid(False)
    ax.set_title("Left of effect (row) once DH and another (column) explained it; < 9: twins", fontsize=9)
    fig.colorbar(image, ax=ax, label="log10 chi2", shrink=0.7)
    return fig


def figure_harm(rows: list[Harm], count: int = 14) -> plt.Figure:
    """What could still be wrong without being seen."""
    rows = rows[:count]
    fig, ax = plt.subplots(figsize=(7.5, 0.8 + 0.28 * len(rows)))
    y = np.arange(len(rows))[::-1]
    ax.barh(y, [h.error_m * 1e3 for h in rows], color=ORANGE, height=0.6)
    ax.set_yticks(y, [f"{h.name} ({h.smallest:.2g} sigma)" for h in rows], fontsize=8)
    ax.set_xlabel("tool error it would cause just below detection [mm]")
    ax.set_title("What could still be wrong unseen (90 % power)")
    return fig


def write_report(
    path: str | Path,
    d: Diagnosis,
    ladder: Ladder,
    confounded: Confounding,
    harms: list[Harm],
    poses: list[NextPose],
    rivals: list[Hypothesis],
) -> list[Path]:
    """One HTML with everything inside, and the figures beside it as PNG. Returns all files."""
    path = Path(path)
    figures: list[tuple[str, str, Callable[[], plt.Figure]]] = [
        ("ladder", "Error ladder", lambda: figure_ladder(ladder)),
        ("posterior", "Probabilities", lambda: figure_posterior(d)),
        ("map", "Where x driver", lambda: figure_map(d)),
        ("vectors", "Residual vectors", lambda: figure_vectors(d)),
        ("variables", "Residuals by variable", lambda: figure_variables(d)),
        ("joints", "Residuals by joint", lambda: figure_joints(d)),
        ("confounding", "Confounding", lambda: figure_confounding(confounded)),
        ("harm", "Harm chart", lambda: figure_harm(harms)),
    ]
    files, parts = [], []
    path.parent.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(_STYLE):
        for key, title, make in figures:
            figure = make()
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=130)
            plt.close(figure)
            file = path.with_name(f"{path.stem}-{key}.png")
            file.write_bytes(buffer.getvalue())
            files.append(file)
            data = base64.b64encode(buffer.getvalue()).decode()
            parts.append(
                f'<h2>{html.escape(title)}</h2><img alt="{html.escape(title)}" src="data:image/png;base64,{data}">'
            )
    if poses:
        names = ", ".join(h.name for h in rivals)
        rows = "".join(
            f"<tr><td>{k}</td><td>{', '.join(f'{x:.3f}' for x in p.q)}</td>"
            f"<td>{'' if p.direction is None else ' '.join(f'{s:+d}' for s in p.direction)}</td><td>{p.power:.2f}</td></tr>"
            for k, p in enumerate(poses, 1)
        )
        parts.append(
            f"<h2>Next poses</h2><p>They separate {html.escape(names)}; power counts the poses above too.</p>"
            f"<table><tr><th>#</th><th>q</th><th>approach</th><th>power</th></tr>{rows}</table>"
        )
    text = html.escape(diagnosis_text(d))
    page = (
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>KinCal diagnosis</title><style>"
        "body{font:15px/1.5 system-ui,sans-serif;color:#22303c;max-width:1000px;margin:2em auto;padding:0 1em}"
        "img{max-width:100%}pre{background:#f4f6f8;padding:1em;overflow-x:auto;font-size:12.5px}"
        "table{border-collapse:collapse;font-size:13px}td,th{border:1px solid #d5dce2;padding:.25em .6em;text-align:left}"
        "</style><h1>Model diagnosis</h1>"
        f"<p>{html.escape(d.comparison.arm)}, {html.escape(d.comparison.source)}</p><pre>{text}</pre>{''.join(parts)}</html>"
    )
    path.write_text(page, encoding="utf-8")
    return [path, *files]
