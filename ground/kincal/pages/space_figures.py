"""Figures of a search space: which tool poses were kept, why others were dropped, how the tags are seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from kincal.pages import scene as scene3
from kincal.pages import theme
from kincal.results import Scene
from kincal.space.reasons import Reason, kind_of

NOT_IN_VIEW = (
    Reason.OUTSIDE_BOX,
    Reason.RANGE,
    Reason.PANTILT,
    Reason.OBLIQUE,
    Reason.FEW_TAGS,
    Reason.SMALL_TAGS,
)
# (in the legend, reasons that the search gives, colour)
GROUPS = (
    ("joint limits or out of reach", (Reason.UNREACHED, Reason.JOINT_LIMITS), theme.GREY),
    ("not in view", NOT_IN_VIEW, theme.ORANGE),
    ("hidden by the arm", (Reason.HIDDEN_TAGS,), theme.PURPLE),
    ("too close, nominal arm", (Reason.CONTACT_NOMINAL,), theme.RED),
    ("too close, arm with errors", (Reason.CONTACT_ERRORS,), theme.WINE),
    ("servo cannot reach it with named errors", (Reason.SERVO_REACH,), theme.BROWN),
    ("contact inside the servo bound", (Reason.SERVO_BOUND,), theme.BLUE),
    ("no path from a hub", (Reason.NO_SEGMENT,), theme.TEAL),
)
_SHOWN = 250  # dots per reason in a picture; three times as many on a page
KEPT = "Kept candidates and dropped samples"
DIRECTIONS = "Orientation of the tool"


@dataclass(frozen=True)
class Candidates:
    """The candidates of a space. R: (n, 3, 3) of the tool, base frame; hub: (n,) index; tags: (n,) bits of
    the tags in view; incidence_deg: (n,) of the most oblique tag in view; range_m: (n,) camera to tool."""

    scene: Scene
    R: np.ndarray
    hub: Sequence[int]
    tags: Sequence[int]
    incidence_deg: np.ndarray
    range_m: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What became of the samples of a search. dropped_m: group -> (k, 3) tool positions; counts: (label,
    samples) with what was kept first. Empty for a table that was only read."""

    dropped_m: Mapping[str, np.ndarray]
    counts: Sequence[tuple[str, int]]


def group(reason: str) -> str:
    """The group of the legend that a reason belongs to."""
    return next(label for label, kinds, _ in GROUPS if kind_of(reason) in kinds)


def outcome(
    samples: Sequence[tuple[np.ndarray, str]], rejected: Mapping[str, int], n_samples: int, n_kept: int
) -> Outcome:
    """samples: (position (3,), reason or "") of what was examined; rejected: reason -> number of samples;
    empty for a table that was only read."""
    if not rejected:
        return Outcome({}, [])
    dropped: dict[str, list[np.ndarray]] = {}
    for p_m, reason in samples:
        if reason:
            dropped.setdefault(group(reason), []).append(p_m)
    counts = {label: 0 for label, _, _ in GROUPS}
    for reason, n in rejected.items():
        counts[group(reason)] += n
    rest = n_samples - sum(counts.values()) - n_kept
    rows = [("kept", n_kept), ("good, not needed", rest), *counts.items()]
    return Outcome({k: np.array(v) for k, v in dropped.items()}, [row for row in rows if row[1] > 0])


def _colour(label: str) -> str:
    known = {name: colour for name, _, colour in GROUPS}
    return known.get(label, theme.GREEN if label == "kept" else theme.GRID)


def directions(R: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth and elevation of the tool axis, and spin about it [deg], of rotations (n, 3, 3)."""
    z, x = R[:, :, 2], R[:, :, 0]
    azimuth = np.degrees(np.arctan2(z[:, 1], z[:, 0]))
    elevation = np.degrees(np.arcsin(np.clip(z[:, 2], -1.0, 1.0)))
    level = np.cross([0.0, 0.0, 1.0], z)
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
    spin = np.degrees(np.arctan2(np.sum(x * np.cross(z, level), axis=1), np.sum(x * level, axis=1)))
    return azimuth, elevation, spin


# --------------------------------------------------------------------------- traces


def _scene_traces(c: Candidates, o: Outcome, shown: int, hidden: bool) -> list[go.Scatter3d | go.Mesh3d]:
    n = len(c.scene.candidates)
    kept = scene3.dots(
        c.scene.candidates, theme.GREEN, 3.2, f"kept: {n}", hovertext=_texts(c), hoverinfo="text"
    )
    out = [scene3.ground_trace(c.scene), kept]
    for label, p in o.dropped_m.items():
        name, state = f"{label}: {len(p)}", "legendonly" if hidden else True
        out.append(scene3.dots(p[:shown], _colour(label), 1.8, name, visible=state, hoverinfo="skip"))
    return [
        *out,
        *scene3.arm_traces(c.scene.skeletons, "arm at the initial poses"),
        *scene3.camera_traces(c.scene),
    ]


def _texts(c: Candidates) -> list[str]:
    return [
        f"candidate {i}<br>hub {hub}, tags {tags:02b}"
        for i, (hub, tags) in enumerate(zip(c.hub, c.tags, strict=True))
    ]


def _direction_trace(c: Candidates, bar_x: float) -> go.Scatter:
    azimuth, elevation, spin = directions(c.R)
    text = [f"{t}<br>spin {s:.0f} deg" for t, s in zip(_texts(c), spin, strict=True)]
    return go.Scatter(
        x=azimuth, y=elevation, mode="markers", hovertext=text, hoverinfo="text", showlegend=False,
        marker={"color": spin, "colorscale": theme.CYCLE, "cmin": -180, "cmax": 180, "size": 7,
                "line": {"width": 0.5, "color": theme.GREY},
                "colorbar": theme.colour_bar("spin about the tool axis [deg]", x=bar_x)},
    )  # fmt: skip


def _count_trace(o: Outcome) -> go.Bar:
    return go.Bar(
        x=[n for _, n in o.counts], y=[label for label, _ in o.counts], orientation="h", showlegend=False,
        marker={"color": [_colour(label) for label, _ in o.counts]}, text=[str(n) for _, n in o.counts],
        textposition="outside", cliponaxis=False,
    )  # fmt: skip


# --------------------------------------------------------------------------- figures


def kept_and_dropped(c: Candidates, o: Outcome) -> go.Figure:
    """Candidates in space; a click on the legend shows samples that were dropped for that reason."""
    figure = theme.figure(680, margin={"l": 0, "r": 0, "t": 8, "b": 0}, scene=scene3.layout())
    figure.add_traces(_scene_traces(c, o, 3 * _SHOWN, hidden=True))
    return figure.update_layout(legend={"x": 0.0, "y": 1.0, "itemsizing": "constant"})


def orientations(c: Candidates) -> go.Figure:
    """Which way the tool points and how it is turned about its axis."""
    figure = theme.figure(480)
    figure.add_trace(_direction_trace(c, 1.0))
    figure.update_xaxes(title_text="azimuth of the tool axis [deg]")
    return figure.update_yaxes(title_text="elevation [deg]")


def samples(o: Outcome) -> go.Figure:
    """How many samples were kept, and why the others were not."""
    figure = theme.figure(110 + 34 * len(o.counts))
    figure.add_trace(_count_trace(o))
    _label_counts(figure, o, {})
    return figure


def _label_counts(figure: go.Figure, o: Outcome, at: Mapping[str, int]) -> None:
    most = max((n for _, n in o.counts), default=1)
    figure.update_xaxes(type="log", range=[-0.1, np.log10(most) + 0.6], dtick=1, title_text="samples", **at)
    figure.update_yaxes(autorange="reversed", showgrid=False, **at)


def viewing(c: Candidates) -> go.Figure:
    """Candidates from above, and how far and how obliquely the camera sees the tags."""
    titles = ("Seen from above", "Distance and incidence")
    figure = make_subplots(rows=1, cols=2, subplot_titles=titles, horizontal_spacing=0.17)
    theme.styled(figure, 460, showlegend=False, margin=theme.TITLED)
    _add_viewing(figure, c, 1, 0.42)
    return figure


def _add_viewing(figure: go.Figure, c: Candidates, column: int, bar_x: float) -> None:
    p = c.scene.candidates
    above = {"color": p[:, 2], "colorscale": theme.ORDER, "size": 6,
             "colorbar": theme.colour_bar("tool height z [m]", x=bar_x)}  # fmt: skip
    seen = {"color": theme.BLUE, "size": 6, "opacity": 0.7}
    figure.add_trace(go.Scatter(x=p[:, 0], y=p[:, 1], mode="markers", marker=above), row=1, col=column)
    figure.add_trace(
        go.Scatter(x=c.range_m, y=c.incidence_deg, mode="markers", marker=seen), row=1, col=column + 1
    )
    figure.update_xaxes(title_text="x forward [m]", row=1, col=column)
    axis = figure.get_subplot(1, column).xaxis.plotly_name.replace("axis", "")
    figure.update_yaxes(title_text="y left [m]", scaleanchor=axis, row=1, col=column)
    figure.update_xaxes(title_text="camera to tool [m]", row=1, col=column + 1)
    figure.update_yaxes(title_text="incidence of the most oblique tag [deg]", row=1, col=column + 1)


def sheet(c: Candidates, o: Outcome, title: str) -> go.Figure:
    """One picture: the candidates, and what became of the samples or, for a table that was read, how they
    are seen."""
    searched = bool(o.counts)
    right = (
        (DIRECTIONS, "What became of the samples")
        if searched
        else ("Seen from above", "Distance and incidence")
    )
    figure = make_subplots(
        rows=1, cols=3, column_widths=[0.44, 0.29, 0.27], horizontal_spacing=0.1,
        specs=[[{"type": "scene"}, {}, {}]], subplot_titles=("Candidates, arm at the initial poses", *right),
    )  # fmt: skip
    theme.styled(figure, 640, width=1600, title=title, margin={"t": 96, "l": 10, "b": 110})
    traces = _scene_traces(c, o, _SHOWN, hidden=False)
    figure.add_traces(traces, rows=[1] * len(traces), cols=[1] * len(traces))
    if searched:
        figure.add_trace(_direction_trace(c, 0.68), row=1, col=2)
        figure.add_trace(_count_trace(o), row=1, col=3)
        figure.update_xaxes(title_text="azimuth of the tool axis [deg]", row=1, col=2)
        figure.update_yaxes(title_text="elevation [deg]", row=1, col=2)
        _label_counts(figure, o, {"row": 1, "col": 3})
    else:
        _add_viewing(figure, c, 2, 0.67)
        figure.update_traces(showlegend=False, selector={"type": "scatter"})
    legend = {"orientation": "h", "y": -0.08, "x": 0.0, "itemsizing": "constant"}
    return figure.update_layout(scene=scene3.layout(), legend=legend)
