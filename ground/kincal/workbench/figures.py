"""Figures of a diagnosis: each function draws plain results, none computes an answer."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .basis import Basis
from .columns import Columns
from .diagnose import Diagnosis
from .fit import Fit
from .ladder import Ladder
from .novel import drivers
from .power import TWIN_CHI2, Confounding, Harm

INK, GREY, BLUE, ORANGE, GREEN, RED = "#22303c", "#8a97a3", "#1f6fb4", "#e07b1a", "#2c8a4b", "#c0392b"
STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e8ec",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}
# Dark in the middle: an arrow with no vertical part must be seen too.
_UP_DOWN = LinearSegmentedColormap.from_list("updown", ["#0b5fd0", "#4a545c", "#d8281c"])
_CONFOUNDING_MAX = 14
_PLAUSIBLE = 10.0  # typical sizes; nothing is larger than that without being known


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 3] + "..."


def ladder(rungs: Ladder) -> plt.Figure:
    """Held-out error of each model, one line per way of holding back, and the noise floor."""
    fig, ax = plt.subplots(figsize=(8.0, 3.8))
    labels = list(dict.fromkeys(r.model for r in rungs.rungs))
    blocks = list(dict.fromkeys(r.block for r in rungs.rungs))
    for block, colour, mark in zip(blocks, (BLUE, ORANGE, GREEN, RED), "os^D", strict=False):
        mine = rungs.of(block)
        x = [labels.index(r.model) for r in mine]
        ax.plot(x, [r.pos_m * 1e3 for r in mine], mark + "-", color=colour, label=block, ms=5)
    if rungs.floor.pos_m is not None:
        text = f"noise floor ({rungs.floor.source})"
        ax.axhline(rungs.floor.pos_m * 1e3, color=GREY, ls="--", label=text)
    ax.set_yscale("log")
    ax.set_xticks(range(len(labels)), [label.replace("_", "_\u200b") for label in labels])
    if len(labels) > 4:
        plt.setp(ax.get_xticklabels(), rotation=12, ha="right")
    ax.margins(x=0.1)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_ylabel("held-out position RMS [mm]")
    ax.set_title("Add it, watch the error fall")
    ax.legend(fontsize=8)
    return fig


def posterior(d: Diagnosis) -> plt.Figure:
    """Probabilities; a bracket on the right joins effects that these data cannot tell apart."""
    rows = [("nothing missing", d.probability_none, GREY, ())]
    if d.novel:
        what = f"not in the library: {d.novel.locus}\nby {' and '.join(d.novel.depends_on)}"
        rows.append((what, d.novel.probability, RED, ()))
    for e in d.effects:
        rows.append((e.name, e.probability, BLUE if e.accepted else ORANGE, e.confounded_with))
    fig, ax = plt.subplots(figsize=(8.0, 1.0 + 0.42 * len(rows)))
    y = np.arange(len(rows))[::-1]
    ax.barh(y, [r[1] for r in rows], color=[r[2] for r in rows], height=0.6)
    for k, (_, p, _, twins) in zip(y, rows, strict=True):
        inside = p > 0.9
        ax.text(p - 0.01 if inside else p + 0.01, k, f"{p:.2f}", va="center", fontsize=8,
                ha="right" if inside else "left", color="white" if inside else INK)  # fmt: skip
        if twins:
            ax.text(1.03, k, _short("[= " + ", ".join(twins) + "]", 52), va="center", fontsize=7.5, color=INK,
                    clip_on=False)  # fmt: skip
    ax.set_yticks(y, [r[0] for r in rows])
    ax.set_xlim(0, 1.0)
    ax.axvline(0.9, color=GREY, lw=0.8, ls=":")
    ax.set_xlabel("probability, given this library and its priors")
    ax.set_title("What is missing (blue: added, orange: rival; in brackets: cannot be told apart)")
    return fig


def heat_map(d: Diagnosis) -> plt.Figure:
    """Where x depends on what: ln Bayes factor against 'nothing missing', single drivers."""
    cells = {key: v for key, v in d.map_ln_bf.items() if " x " not in key[1]}
    rows = list(dict.fromkeys(k[0] for k in cells))
    cols = list(dict.fromkeys(k[1] for k in cells))
    grid = np.full((len(rows), len(cols)), np.nan)
    for (row, col), value in cells.items():
        grid[rows.index(row), cols.index(col)] = value
    fig, ax = plt.subplots(figsize=(9, 1.2 + 0.22 * len(rows)))
    top = max(3.0, float(np.nanmax(grid)))
    image = ax.imshow(np.maximum(grid, 0.0), aspect="auto", cmap="YlOrRd", norm=PowerNorm(0.5, 0.0, top))
    best = np.sort(grid[np.isfinite(grid)])[-6:][0]
    for i, j in zip(*np.nonzero(grid >= max(best, 3.0)), strict=True):
        ax.text(j, i, f"{grid[i, j]:.0f}", ha="center", va="center", fontsize=7,
                color="white" if grid[i, j] > 0.4 * top else INK)  # fmt: skip
    ax.set_xticks(range(len(cols)), cols, rotation=60, fontsize=7)
    ax.set_yticks(range(len(rows)), rows, fontsize=7)
    ax.grid(False)
    ax.set_title("Where the error enters (row) and what it depends on (column), before anything was added")
    fig.colorbar(image, ax=ax, label="ln evidence over 'nothing missing'", shrink=0.8)
    return fig


def vectors(d: Diagnosis) -> plt.Figure:
    """Residual position vectors over the workspace, from above and from the side, before and after."""
    pairs = ((d.comparison.fit_all, "before"), (d.final, "after the accepted effects"))
    first = d.comparison.fit_all
    size = max(float(np.sqrt((first.evaluation.r[:, :3] ** 2).sum(axis=1).mean())), 1e-12)
    span = float(np.ptp(first.chain.data.p_m, axis=0).max()) or 1.0
    grow = 0.12 * span / size
    fig, axes = plt.subplots(2, 2, figsize=(9.5, 8.0))
    image = None
    for column, (fit, title) in enumerate(pairs):
        p, r = fit.chain.data.p_m, fit.evaluation.r[:, :3]
        for row, (a, b, c) in enumerate(((0, 1, 2), (0, 2, 1))):
            ax = axes[row, column]
            image = ax.quiver(
                *(p[:, a], p[:, b], r[:, a], r[:, b], r[:, c] * 1e3),
                cmap=_UP_DOWN,
                clim=(-1.2e3 * size, 1.2e3 * size),
                angles="xy",
                scale_units="xy",
                scale=1.0 / grow,
                width=0.0045,
                headwidth=3.5,
            )
            ax.plot(p[:, a], p[:, b], ".", ms=2, color=GREY, zorder=0)
            ax.set_xlabel("xyz"[a] + " [m]")
            ax.set_ylabel("xyz"[b] + " [m]")
            ends = np.concatenate([p, p + grow * r])
            ax.update_datalim(ends[:, [a, b]])
            ax.autoscale_view()
            ax.set_aspect("equal", adjustable="datalim")
        rms = np.sqrt((r**2).sum(axis=1).mean())
        axes[0, column].set_title(f"{title}: {rms * 1e3:.2f} mm RMS")
    fig.colorbar(image, ax=axes, label="part across the picture [mm]", shrink=0.5)
    fig.suptitle(f"Residuals from above and from the side, arrows {grow:.0f} times as long as they are")
    return fig


def _values(name: str, fit: Fit) -> np.ndarray:
    """A driver's own values in its unit where the data hold them, else its leading feature."""
    data = fit.chain.data
    if name[0] == "q" and name[1:].isdigit():
        return data.q[:, int(name[1:]) - 1]
    if name.startswith("dir"):
        return data.direction[:, int(name[3:]) - 1]
    if name.startswith("qdot"):
        return data.qdot[:, int(name[4:]) - 1]
    if name.startswith("tau"):
        return fit.chain.basis_values(Basis("lin", "tau", int(name[3:])))
    if name in ("zcam", "u", "v", "r2", "sx", "sy", "sz"):
        return fit.chain.basis_values(Basis("lin", name, 0))
    plain = {"t": data.t_s, "order": data.t_s, "temp": data.temp_c, "payload": data.payload_kg}
    plain |= {"incid": data.incid_rad, "pan": data.pan_rad, "tilt": data.tilt_rad, "tag": data.tag}
    if plain.get(name) is not None:
        return plain[name]
    return next(driver.features[:, 0] for driver in drivers(Columns(fit)) if driver.name == name)


_UNITS = {"t": "s", "temp": "deg C", "payload": "kg", "zcam": "m", "sx": "m", "sy": "m", "sz": "m"}
_UNITS |= {"incid": "rad", "pan": "rad", "tilt": "rad"}


def _axis_label(name: str) -> str:
    if name.startswith("tau"):
        return f"{name} [N m]"
    if name[0] == "q" and name[1:].isdigit():
        return f"{name} [rad]"
    return f"{name} [{_UNITS[name]}]" if name in _UNITS else name


def _trend(ax, x: np.ndarray, y: np.ndarray, colour: str, label: str) -> None:
    """Dots, and the mean of each bin with its standard error."""
    levels = np.unique(x)
    if len(levels) <= 4:
        edges = None
        bins = [x == level for level in levels]
        spread = 0.12 * (float(np.ptp(levels)) or 1.0)
        shown = x + np.random.default_rng(1).uniform(-spread, spread, len(x))
    else:
        edges = np.unique(np.quantile(x, np.linspace(0, 1, 9)))
        bins = [(x >= a) & (x <= b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        shown = x
    ax.plot(shown, y, ".", ms=3, color=colour, alpha=0.35)
    bins = [b for b in bins if b.sum() > 1]
    centre = [x[b].mean() for b in bins]
    error = [y[b].std(ddof=1) / np.sqrt(b.sum()) for b in bins]
    ax.errorbar(centre, [y[b].mean() for b in bins], error, fmt="o-", ms=4, lw=1.2, color=colour, label=label)


def variables(d: Diagnosis, count: int = 8) -> plt.Figure:
    """Residual components against the variables that explain most of them, with binned means."""
    fit = d.comparison.fit_all
    names = [w.variable for w in d.comparison.where[:count]]
    rows = (len(names) + 3) // 4
    fig, axes = plt.subplots(rows, 4, figsize=(9.5, 2.3 * rows), squeeze=False, sharey=True)
    r = fit.evaluation.r
    for ax, name in zip(axes.ravel(), names, strict=False):
        for k, (axis, colour) in enumerate(zip("xyz", (RED, GREEN, BLUE), strict=True)):
            _trend(ax, _values(name, fit), r[:, k] * 1e3, colour, axis)
        ax.set_xlabel(_axis_label(name))
    for ax in axes.ravel()[len(names) :]:
        ax.axis("off")
    axes[0, 0].legend(fontsize=7, ncol=3)
    for ax in axes[:, 0]:
        ax.set_ylabel("residual [mm]")
    fig.suptitle("What the model leaves, against the variables that explain most of it")
    return fig


def _apparent_motion(fit: Fit, joint: int) -> np.ndarray:
    """(N,) motion of one joint alone that would explain each pose's residual best [rad or m]."""
    jq = np.einsum("nij,nj->ni", fit.whiten, fit.evaluation.Jq[:, :, joint - 1])
    z = fit.z.reshape(len(jq), -1)
    return (jq * z).sum(axis=1) / ((jq**2).sum(axis=1) + 1.0 / 3e-3**2)


def suspects(d: Diagnosis, count: int = 4) -> plt.Figure:
    """The joint cells with the most evidence: the joint's apparent motion against its driver, before and
    after the accepted effects."""
    cells = [k for k in d.map_ln_bf if k[0].startswith("joint") and " x " not in k[1]]
    cells = sorted(cells, key=lambda k: -d.map_ln_bf[k])[:count]
    fig, axes = plt.subplots(1, len(cells), figsize=(9.5, 2.6), squeeze=False)
    for ax, (place, driver) in zip(axes[0], cells, strict=True):
        joint = int(place.split()[1])
        for fit, colour, label in ((d.comparison.fit_all, ORANGE, "before"), (d.final, BLUE, "after")):
            _trend(ax, _values(driver, fit), _apparent_motion(fit, joint) * 1e3, colour, label)
        ax.set_title(f"{place} by {driver}: ln evidence {d.map_ln_bf[place, driver]:.1f}", fontsize=8.5)
        ax.set_xlabel(_axis_label(driver))
    axes[0, 0].set_ylabel("apparent joint motion [mrad]")
    axes[0, 0].legend(fontsize=7)
    return fig


def joints(d: Diagnosis) -> plt.Figure:
    """The joint motion that would explain each pose's residual (a view, not a test), before and after."""
    fig, ax = plt.subplots(figsize=(8.0, 2.8))
    for offset, (fit, colour, label) in enumerate(
        ((d.comparison.fit_all, ORANGE, "before"), (d.final, BLUE, "after"))
    ):
        n = fit.evaluation.Jq.shape[2]
        size = [np.sqrt((_apparent_motion(fit, j) ** 2).mean()) * 1e3 for j in range(1, n + 1)]
        ax.bar(np.arange(1, n + 1) + 0.3 * (offset - 0.5), size, width=0.28, color=colour, label=label)
    ax.set_xlabel("joint")
    ax.set_ylabel("RMS [mrad]")
    ax.set_title("Motion of each joint alone that would explain the residuals")
    ax.margins(y=0.15)
    ax.legend(ncol=2)
    return fig


def _entangled(c: Confounding) -> np.ndarray:
    """Effects worth showing: visible by themselves, and hidden at least half by some other one."""
    own = np.diag(c.d2)
    others = c.d2 + np.diag(np.full(len(own), np.inf))
    share = others.min(axis=1) / np.maximum(own, 1e-12)
    visible = own >= TWIN_CHI2
    keep = np.flatnonzero(visible & (share < 0.5))
    partners = {int(others[i].argmin()) for i in keep}
    order = sorted({*keep.tolist(), *(p for p in partners if visible[p])}, key=lambda i: share[i])
    return np.array(sorted(order[:_CONFOUNDING_MAX]), dtype=int)


def confounding(c: Confounding) -> plt.Figure:
    """d^2(i|j) of the effects that hide behind one another; below 9 a pair cannot be told apart."""
    keep = _entangled(c)
    if len(keep) < 2:
        fig, ax = plt.subplots(figsize=(8.0, 1.2))
        ax.axis("off")
        ax.text(0.5, 0.5, "No effect hides behind another with these poses.", ha="center", va="center")
        return fig
    names, d2 = [c.names[i] for i in keep], c.d2[np.ix_(keep, keep)]
    fig, ax = plt.subplots(figsize=(3.4 + 0.46 * len(names), 2.4 + 0.34 * len(names)))
    share = d2 / np.maximum(np.diag(d2)[:, None], 1e-12)
    image = ax.imshow(share, cmap="RdYlGn", vmin=0.0, vmax=1.0, aspect="auto", alpha=0.6)
    for i in range(len(names)):
        for j in range(len(names)):
            twin = i != j and d2[i, j] < TWIN_CHI2
            ax.text(j, i, f"{d2[i, j]:.0f}", ha="center", va="center", fontsize=7, color=INK,
                    weight="bold" if twin else "normal")  # fmt: skip
    ax.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=8)
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set_xlabel("... once DH and this effect have explained it")
    ax.set_ylabel("left of this effect [chi2] ...")
    ax.grid(False)
    ax.set_title("Who hides behind whom (bold: below 9, cannot be told apart)")
    fig.colorbar(image, ax=ax, label="share left", shrink=0.7)
    return fig


def harm(rows: list[Harm], count: int = 14) -> plt.Figure:
    """What could still be wrong without being seen."""
    rows = [h for h in rows if h.smallest <= _PLAUSIBLE][:count]
    fig, ax = plt.subplots(figsize=(8.0, 1.0 + 0.28 * len(rows)))
    y = np.arange(len(rows))[::-1]
    ax.barh(y, [h.error_m * 1e3 for h in rows], color=ORANGE, height=0.6)
    ax.set_yticks(y, [f"{h.name} ({h.smallest:.2g} sigma)" for h in rows], fontsize=8)
    ax.set_xlabel("tool error it would cause just below detection [mm]")
    ax.set_title("What could still be wrong unseen (smallest size with 90 % power, in typical sizes)")
    return fig


def next_poses(q: np.ndarray, low: np.ndarray, high: np.ndarray, power: list[float]) -> plt.Figure:
    """Advised poses as lines over the joints, inside the limits, and the power they add up to."""
    fig, (ax, right) = plt.subplots(1, 2, figsize=(8.0, 2.8), width_ratios=(2, 1))
    x = np.arange(1, len(low) + 1)
    ax.fill_between(x, low, high, color=GREY, alpha=0.15, label="limits")
    for k, row in enumerate(q, 1):
        ax.plot(
            x,
            row,
            "o-",
            ms=4,
            lw=1,
            color=plt.get_cmap("viridis")(0.85 * (k - 1) / max(len(q) - 1, 1)),
            label=f"{k}",
        )
    ax.set_xticks(x)
    ax.set_xlabel("joint")
    ax.set_ylabel("q [rad or m]")
    ax.set_title("Next poses")
    ax.legend(fontsize=7, ncol=5, loc="lower center", bbox_to_anchor=(0.5, 1.08))
    right.plot(range(1, len(power) + 1), power, "o-", color=BLUE)
    right.set_ylim(0, 1.03)
    right.set_xlabel("poses measured")
    right.set_title("power to tell the rivals apart")
    return fig
