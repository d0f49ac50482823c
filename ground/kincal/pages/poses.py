"""Poses as dots: the same pose is the same dot in every plot of a page, so that the page can link them
(page.js). Outliers are labelled and stay at the border of the axes instead of squashing them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from kincal.pages import theme
from kincal.workbench.comparison.compare import Comparison
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.fit.least_squares import Fit

_ALL = 500  # poses up to which each one is drawn
_SOME = 400  # drawn of more
_FEW = 60  # poses up to which dots are large
_LABELS = 4  # of a panel
_BULK = (0.01, 0.99)  # quantiles that set the range of an axis ...
_MARGIN = 0.35  # ... and how far it may reach beyond, of the distance between them

Range = tuple[float, float]


@dataclass(frozen=True)
class Poses:
    """The poses of a fit as a page draws them. ids: of all N; drawn: indices; flagged: (N,) outliers."""

    ids: tuple[str, ...]
    drawn: np.ndarray
    flagged: np.ndarray

    @classmethod
    def of(cls, comparison: Comparison, fit: Fit) -> Poses:
        """All poses, or all outliers and every k-th of the others."""
        ids = fit.data.ids
        outliers = set(comparison.outliers.ids)
        flagged = np.array([name in outliers for name in ids], dtype=bool)
        if len(ids) <= _ALL:
            return cls(ids, np.arange(len(ids)), flagged)
        some = np.linspace(0, len(ids) - 1, _SOME).round().astype(int)
        return cls(ids, np.union1d(some, np.flatnonzero(flagged)[:_SOME]), flagged)

    @property
    def note(self) -> str:
        """What is not drawn; empty if all are."""
        if len(self.drawn) == len(self.ids):
            return ""
        return f"{len(self.drawn)} of {len(self.ids)} poses are drawn, outliers among them; means are of all."

    def chosen(self, mask: np.ndarray | None) -> np.ndarray:
        """Indices of the drawn poses of a mask (N,)."""
        return self.drawn if mask is None else self.drawn[mask[self.drawn]]


def bulk_range(*values: np.ndarray) -> Range:
    """A range for an axis that holds the bulk of each array: far values do not squash it."""
    pairs = [_bulk(v[np.isfinite(v)]) for v in values if np.isfinite(v).any()]
    low, high = min(p[0] for p in pairs), max(p[1] for p in pairs)
    edge = 0.04 * (high - low) or 1e-9
    return low - edge, high + edge


def _bulk(values: np.ndarray) -> Range:
    low, high = (float(x) for x in np.quantile(values, _BULK))
    reach = _MARGIN * (high - low)
    return max(float(values.min()), low - reach), min(float(values.max()), high + reach)


def dots(
    poses: Poses, x: np.ndarray, y: np.ndarray, limits: Range, *, mask: np.ndarray | None = None,
    colour: str = theme.GREY, border: bool = True,
) -> list[go.Scatter]:  # fmt: skip
    """One dot for each drawn pose of a mask at x, y (N,), outliers with their ids. Poses beyond the limits of
    y stand at the border as triangles; without `border` only outliers do. Few dots are large, many faint."""
    k = poses.chosen(mask)
    size, opacity = (7.0, 0.75) if len(poses.drawn) <= _FEW else (4.5, 0.4)
    beyond = (y > limits[1]).astype(int) - (y < limits[0])
    inside, outside = k[beyond[k] == 0], k[(beyond[k] != 0) & (border | poses.flagged[k])]
    out = [linked(poses, inside, x, y, {"color": colour, "opacity": opacity, "size": size})]
    if len(outside):
        symbols = ["triangle-up" if b > 0 else "triangle-down" for b in beyond[outside]]
        edge = {"color": colour, "opacity": 0.7, "size": 8, "symbol": symbols}
        out.append(linked(poses, outside, x, np.clip(y, *limits), edge))
    flagged = inside[poses.flagged[inside]]
    return [*out, *_labels(poses, np.concatenate([flagged, outside]), x, y, limits)]


def linked(
    poses: Poses, k: np.ndarray, x: np.ndarray, y: np.ndarray, marker: Mapping[str, object]
) -> go.Scatter:
    """Markers of poses k that the page links; x, y: (N,)."""
    return go.Scatter(
        x=x[k].astype(np.float32), y=y[k].astype(np.float32), mode="markers", marker=dict(marker),
        customdata=[poses.ids[i] for i in k], meta={"poses": True}, showlegend=False, cliponaxis=False,
        hovertemplate="pose %{customdata}: %{x:.3f}, %{y:.3f}<extra></extra>",
    )  # fmt: skip


def _labels(poses: Poses, k: np.ndarray, x: np.ndarray, y: np.ndarray, limits: Range) -> Iterator[go.Scatter]:
    """Ids of some of the poses k, those farthest out."""
    far = k[np.argsort(-np.abs(y[k] - np.median(y)))][:_LABELS] if len(k) else k
    if len(far):
        places = ["bottom center" if y[i] > limits[1] else "top center" for i in far]
        yield go.Scatter(
            x=x[far].tolist(), y=np.clip(y[far], *limits).tolist(), mode="text", textposition=places,
            text=[poses.ids[i] for i in far], textfont={"size": 11, "color": theme.RED}, hoverinfo="skip",
            showlegend=False, cliponaxis=False,
        )  # fmt: skip


def table(d: Diagnosis) -> dict[str, list[object]]:
    """What the page says of a pose under the pointer: id, residual now and with the findings [mm], and
    whether it is held out or an outlier; one entry a pose, in the order of the fit."""
    before, after = d.comparison.fit_all, d.final
    held = np.zeros(before.data.n, dtype=bool)
    if not d.comparison.split.given:
        held[d.comparison.split.held] = True
    outliers = set(d.comparison.outliers.ids)
    return {
        "ids": list(before.data.ids),
        "now": _millimetres(before),
        "after": _millimetres(after) if after is not before else [],
        "about": [
            " and ".join(
                word for word, yes in (("held out", held[i]), ("outlier", name in outliers)) if yes
            )
            for i, name in enumerate(before.data.ids)
        ],
    }  # fmt: skip


def _millimetres(fit: Fit) -> list[object]:
    lengths = np.linalg.norm(fit.evaluation.r[:, :3], axis=1) * 1e3
    return [round(float(x), 3) for x in lengths]
