"""What was found, as curves: partial residuals of an effect, or of a place with its driver variables.

A partial residual is what the fitted effect does plus what the final model leaves there (Larsen, McCleary,
Technometrics 14(3), 1972). Here both are motions of one place of the chain (about or along one axis): the
residual of a pose, up to six numbers, gives the motion that would explain it best (weighted least squares).
Poses that hardly move the tool at that place say little about it, which the weights of the means hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal_shared.schema.names import COMPONENTS, VARIABLES
from kincal_shared.schema.terms import Basis

from ..evidence.unnamed import MEASURED_POSE, Location, lagging, locations, oriented
from ..evidence.variables import variable_values
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Term
from ..model.places import TYPICAL_SIZE
from ..model.shapes import EVALUATED, evaluate
from ..numerics.types import Array, Mask, array

_BINS, _LEAST_BINS, _POSES_PER_BIN = 12, 4, 12
_FAST = 3.0  # [1/rad] a sine or cosine of more than this times its variable is drawn against its phase
_LEVELS = 4  # a variable with no more different values is drawn value by value
_POINTS = 121  # of a curve
_GROUPS = 3  # curves of a panel, by the second driver
_FRAMES = {FRAME_TOOL: "tool", FRAME_CAMERA: "camera", FRAME_MEAS: "measured frame"}
_LEAST_INFORMATION = 1e-12
_BLIND = 5.0  # typical sizes
_STILL = 1e-3  # in the unit of a variable; one that varies less explains nothing


@dataclass(frozen=True)
class Bin:
    """Mean motion of poses that are alike in the drivers. x: of the driver; y: motion, sigma: its standard
    error; fitted: what the effect says there (0 where there is none); count: of poses."""

    x: float
    y: float
    sigma: float
    fitted: float
    count: int


@dataclass(frozen=True)
class Group:
    """Poses with a like second driver: label "" where there is only one group."""

    label: str
    poses: Mask
    bins: tuple[Bin, ...]


@dataclass(frozen=True, eq=False)
class Line:
    """What an effect of one driver does over the measured range.

    x: (M,) from low to high; value: (M,) [rad or m]; std: (M,) its standard error about the mean over the
    poses (a constant cannot be told from the DH errors)."""

    x: Array
    value: Array
    std: Array


@dataclass(frozen=True, eq=False)
class Panel:
    """Motion of one place against one driver, pose by pose.

    place: for people, with the axis; driver, unit: of x; angular: the motion is an angle [rad], else [m];
    x, y, sigma: (N,) driver, partial residual and its standard error; fitted: (N,) what the effect does;
    groups: means of alike poses; line: the effect as a curve, None unless it is a function of this driver
    alone.
    """

    place: str
    driver: str
    unit: str
    angular: bool
    x: Array
    y: Array
    sigma: Array
    fitted: Array
    groups: tuple[Group, ...]
    line: Line | None = None

    @property
    def size(self) -> float:
        """RMS of what the effect does, or of the means where there is no effect."""
        if self.fitted.any():
            return float(np.sqrt((self.fitted**2).mean()))
        means = np.array([b.y for g in self.groups for b in g.bins])
        return float(np.sqrt((means**2).mean())) if len(means) else 0.0


# ------------------------------------------------------------------------------------------ effects


def effect_panels(fit: Fit, effect: Hypothesis) -> tuple[Panel, ...]:
    """Panels of an effect of the fitted model, those with the largest motion first."""
    made = (_effect_panel(fit, place, terms) for place, terms in _by_place(effect).items())
    shown = [panel for panel in made if np.ptp(panel.x) > _STILL and _visible(panel)]
    return tuple(sorted(shown, key=lambda panel: -panel.size))


def _visible(panel: Panel) -> bool:
    """The poses show motions of this place to better than a few typical sizes."""
    return any(b.sigma < _BLIND * TYPICAL_SIZE for g in panel.groups for b in g.bins)


_Key = tuple[int, int, str, int]  # frame, component, variable, its index


def _by_place(effect: Hypothesis) -> dict[_Key, list[tuple[str, Term]]]:
    """Terms with the name of their coefficient, by place, axis and first driver."""
    found: dict[_Key, list[tuple[str, Term]]] = {}
    for p in effect.parameters:
        for term in p.terms:
            key = (term.frame, term.comp, term.basis[0].var, term.basis[0].index)
            found.setdefault(key, []).append((f"{effect.name}.{p.name}", term))
    return found


def _effect_panel(fit: Fit, key: _Key, terms: Sequence[tuple[str, Term]]) -> Panel:
    frame, comp, var, index = key
    fitted = array(_design(fit, terms) @ fit.estimate[[fit.names.index(name) for name, _ in terms]])
    direction = np.einsum("nij,nj->ni", fit.whiten, fit.evaluation.twist[:, frame, comp])
    seconds = {(b.var, b.index) for _, term in terms for b in term.basis[1:]} - {("1", 0), (var, index)}
    driver, x = _folded(_driver(var, index), _values(fit, var, index), terms)
    return _panel(
        fit,
        place=_place(fit, frame, comp),
        angular=comp >= 3,
        driver=driver,
        unit=_unit(fit, _driver(var, index)),
        x=x,
        second=next(((_driver(*s), _values(fit, *s)) for s in sorted(seconds)), None),
        motion=_motion(fit, direction),
        fitted=fitted,
        line=None if seconds else _line(fit, x, terms),
    )


def _line(fit: Fit, x: Array, terms: Sequence[tuple[str, Term]]) -> Line:
    """The curve of terms of one driver, x: (N,) its values in the plot. Few levels are points of their own; a
    basis that only the core evaluates is known at the poses alone."""
    at, first = np.unique(x, return_index=True)
    evaluated = all(b.fn in EVALUATED for _, term in terms for b in term.basis)
    if evaluated and len(at) > _LEVELS:
        at = np.linspace(at[0], at[-1], _POINTS)
        design = np.column_stack([term.gain * _product(term, at) for _, term in terms])
    else:
        design = _design(fit, terms)[first]
    names = [fit.names.index(name) for name, _ in terms]
    centred = design - _design(fit, terms).mean(axis=0)
    variance = ((centred @ fit.cov[np.ix_(names, names)]) * centred).sum(axis=1)
    return Line(at, array(design @ fit.estimate[names]), np.sqrt(np.maximum(variance, 0.0)))


def _product(term: Term, x: Array) -> Array:
    return array(evaluate(term.basis[0], x) * evaluate(term.basis[1], x))


def _design(fit: Fit, terms: Sequence[tuple[str, Term]]) -> Array:
    """(N, k) motion that one unit of each coefficient makes at the poses."""
    columns = [term.gain * _basis(fit, term.basis[0]) * _basis(fit, term.basis[1]) for _, term in terms]
    return np.column_stack(columns)


def _folded(driver: str, x: Array, terms: Sequence[tuple[str, Term]]) -> tuple[str, Array]:
    """A variable modulo the period of the bases, where that is a short one: else means would hide it."""
    first = [term.basis[0] for _, term in terms]
    rates = {abs(b.c1) for b in first if b.fn in ("sin", "cos")}
    if len(rates) != 1 or len(first) > sum(b.fn in ("sin", "cos") for b in first) or min(rates) < _FAST:
        return driver, x
    period = 2.0 * np.pi / rates.pop()
    return f"{driver} modulo {period:.4g}", array(np.mod(x, period))


def _basis(fit: Fit, basis: Basis) -> Array:
    return array(fit.model.basis_values(basis, fit.estimate))


def _values(fit: Fit, var: str, index: int) -> Array:
    return _basis(fit, Basis("lin", var, index))


def _driver(var: str, index: int) -> str:
    return f"{var}{index}" if VARIABLES[var].indexed else var


def _unit(fit: Fit, driver: str) -> str:
    """Of a variable; empty where it has none."""
    kind = driver.rstrip("0123456789")
    if kind == "q" and kind != driver:
        return "m" if fit.arm.joints[int(driver[1:]) - 1].prismatic else "rad"
    unit = VARIABLES[kind].unit if kind in VARIABLES else ""
    return "" if unit == "1" else unit


def _place(fit: Fit, frame: int, comp: int) -> str:
    axis = f"{'about' if comp >= 3 else 'along'} {COMPONENTS[comp][1]}"
    if frame in _FRAMES:
        return f"{_FRAMES[frame]} {axis}"
    joint = frame + 1
    own = joint <= fit.arm.n and comp == (2 if fit.arm.joints[joint - 1].prismatic else 5)
    if own:
        return f"joint {joint}"
    return f"{'base' if frame == 0 else f'link {frame}'} {axis}"


# ------------------------------------------------------------------------------------------ unnamed


def place_panels(fit: Fit, place: str, drivers: Sequence[str]) -> tuple[Panel, ...]:
    """What a fit leaves at a place of the location x driver map against one or two drivers: one panel for
    each axis of the place, those with the largest motion first."""
    columns = Columns(fit)
    others = (*oriented(columns), *lagging(columns))
    places = (*locations(columns), *(location for location, _ in others))
    where = next(location for location in places if location.name == place)
    x = variable_values(drivers[0], fit)
    second = (drivers[1], variable_values(drivers[1], fit)) if len(drivers) > 1 else None
    panels = (
        _panel(
            fit, place=name, angular=_angular(fit, name), driver=drivers[0], unit=_unit(fit, drivers[0]),
            x=x, second=second, motion=_motion(fit, direction), fitted=np.zeros(fit.data.n),
        )
        for name, direction in _directions(where, columns.weight)
    )  # fmt: skip
    return tuple(sorted(panels, key=lambda panel: -panel.size))


def _angular(fit: Fit, place: str) -> bool:
    if place.startswith("joint"):
        return not fit.arm.joints[int(place.split()[1]) - 1].prismatic
    return not ("translation" in place or place in ("range", "measured position"))


def _directions(where: Location, weight: Array) -> Iterator[tuple[str, Array]]:
    """Each axis of a place with its (N, c) whitened derivative by a motion of 1 rad or m."""
    rows = where.rows / (TYPICAL_SIZE * np.sqrt(weight)[:, None, None])
    if where.name == MEASURED_POSE:
        yield from zip(("measured position", "measured orientation"), rows.transpose(1, 0, 2), strict=False)
        return
    for k, axis in enumerate("xyz"[: rows.shape[1]]):
        yield where.name if rows.shape[1] == 1 else f"{where.name}, {axis}", rows[:, k]


# -------------------------------------------------------------------------------------------- panels


def _motion(fit: Fit, direction: Array) -> tuple[Array, Array]:
    """(N,) motion along a direction (N, c) that explains each residual best, and its standard error."""
    z = fit.z.reshape(direction.shape)
    information = np.maximum((direction**2).sum(axis=1), _LEAST_INFORMATION)
    sigma = fit.scale / np.sqrt(information * np.maximum(fit.weight, _LEAST_INFORMATION))
    return array((direction * z).sum(axis=1) / information), array(sigma)


def _panel(
    fit: Fit,
    *,
    place: str,
    angular: bool,
    driver: str,
    unit: str,
    x: Array,
    second: tuple[str, Array] | None,
    motion: tuple[Array, Array],
    fitted: Array,
    line: Line | None = None,
) -> Panel:
    left, sigma = motion
    y = fitted + left
    groups = tuple(
        Group(label, poses, tuple(_bins(x, y, sigma, fitted, poses))) for label, poses in _groups(second, fit)
    )
    return Panel(place, driver, unit, angular, x, y, sigma, fitted, groups, line)


def _groups(second: tuple[str, Array] | None, fit: Fit) -> list[tuple[str, Mask]]:
    """All poses, or a few groups by the second driver."""
    if second is None or not np.ptp(second[1]):
        return [("", np.ones(fit.data.n, dtype=bool))]
    name, values = second
    return [(f"{name} {_range(values[m])}", m) for m in _parts(values, _GROUPS)]


def _range(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"= {low:.3g}" if low == high else f"{low:.2f} to {high:.2f}"


def _parts(values: Array, count: int) -> list[Mask]:
    """Parts of like size from low to high; few levels are parts themselves."""
    levels = np.unique(values)
    if len(levels) <= _LEVELS:
        return [values == level for level in levels]
    edges = np.quantile(values, np.linspace(0.0, 1.0, count + 1))[1:-1]
    part = np.searchsorted(edges, values, side="right")
    return [part == k for k in range(count) if (part == k).any()]


def _bins(x: Array, y: Array, sigma: Array, fitted: Array, poses: Mask) -> Iterator[Bin]:
    """Means with weights 1 / sigma^2."""
    mine = np.flatnonzero(poses)
    count = max(_LEAST_BINS, min(_BINS, len(mine) // _POSES_PER_BIN))
    for part in _parts(x[mine], count):
        k = mine[part]
        weight = 1.0 / sigma[k] ** 2
        total = float(weight.sum())
        mean = (float((weight * v[k]).sum() / total) for v in (x, y, fitted))
        at, value, fit_value = mean
        yield Bin(at, value, total**-0.5, fit_value, len(k))
