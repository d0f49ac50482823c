"""Errors that follow two variables at once: a dictionary of single products f(x) g(y) at every place.

The kernel cells of the map average over all smooth functions of two variables; where the truth is one
simple product they need far more data than the product itself. Each product is one column, location times
f g, so its evidence is that of any other column (METHOD.md 13), and a whole dictionary costs a few matrix
products: with F (P, N) the products over the poses and L_m (N, c) the rows of a place, u = F (L_m . Wz) and
g'Wg = F^2 |L_m|^2 - sum_k s_k (F (L_m . b_k))^2, b_k the directions that the nuisance parameters take.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kincal_shared.schema.names import COMPONENTS
from kincal_shared.schema.terms import ONE, Basis

from ..data.measurements import Measurements
from ..fit.columns import Columns
from ..model.grids import PERIODS
from ..model.places import TYPICAL_SIZE, ErrorPlace, all_places
from ..model.shapes import FAST_WAVES, WAVES, Product, evaluate
from ..numerics.types import Array
from .bayes_factors import NoiseScale, Projector, ln_bayes_factor

_SCORED = 512  # products whose evidence is computed: those that explain most. The others are far below
_ABSORBED = 0.995  # share of a product that the nuisance parameters imitate: the data say nothing about it
_LEAST_SPREAD = 0.02  # [rad or m] a joint that moves less stands still
_ANGLE_FORMS = (("lin", 1.0), ("sin", 1.0), ("cos", 1.0), ("sin", 2.0), ("cos", 2.0), ("tanh", 1.0))
_SLIDE_FORMS = (("lin", 1.0), ("sq", 1.0))
_WAVE_FORMS = tuple((fn, float(k)) for k in WAVES for fn in ("sin", "cos"))
_RIPPLE_FORMS = tuple((fn, float(k)) for k in PERIODS for fn in ("sin", "cos"))


@dataclass(frozen=True)
class Factor:
    """One function of one driver over the poses; values: (N,)."""

    driver: str
    basis: Basis
    values: Array


@dataclass(frozen=True)
class Dictionary:
    """Products of two factors. bases, drivers: P of them; values: (P, N), unit RMS about their means."""

    bases: tuple[Product, ...]
    drivers: tuple[tuple[str, ...], ...]
    values: Array


@dataclass(frozen=True)
class Spot:
    """One component of a place; rows: (N, c) whitened, of one typical size."""

    place: ErrorPlace
    component: int
    rows: Array


@dataclass(frozen=True)
class ScoredProduct:
    """A product with its evidence; column: (rows,) whitened, of one typical size."""

    place: ErrorPlace
    component: int
    bases: Product
    drivers: tuple[str, ...]
    ln_bf: float
    column: Array

    @property
    def text(self) -> str:
        """Component and product, for instance "rz: tanh(q4) * cos(q6)"."""
        return f"{COMPONENTS[self.component]}: " + " * ".join(str(b) for b in self.bases if b != ONE)


def product_dictionary(columns: Columns) -> Dictionary:
    """Joint angles with each other, with the torque and the direction of any joint, with all that is slow."""
    fit = columns.fit
    recorded = _recorded_factors(fit.data, tuple(joint.prismatic for joint in fit.arm.joints))
    torques = tuple(_centred("tau", j, tau) for j, tau in columns.torques().items())
    if not torques:
        return _recorded_dictionary(fit.data, tuple(joint.prismatic for joint in fit.arm.joints))
    return _joined(
        _recorded_dictionary(fit.data, tuple(joint.prismatic for joint in fit.arm.joints)),
        _dictionary(itertools.product([f for f in recorded if f.driver[0] == "q"], torques)),
    )


@lru_cache(maxsize=4)
def _recorded_dictionary(data: Measurements, prismatic: tuple[bool, ...]) -> Dictionary:
    """The products of recorded variables: the same at every fit."""
    factors = _recorded_factors(data, prismatic)
    angles = [f for f in factors if f.basis.var == "q"]
    others = [f for f in factors if f.basis.var != "q"]
    two = ((a, b) for a, b in itertools.combinations(angles, 2) if a.driver != b.driver)
    return _dictionary(itertools.chain(two, itertools.product(angles, others)))


@lru_cache(maxsize=4)
def _recorded_factors(data: Measurements, prismatic: tuple[bool, ...]) -> tuple[Factor, ...]:
    return tuple(_factors_of(data, prismatic))


@lru_cache(maxsize=4)
def _recorded_waves(data: Measurements, prismatic: tuple[bool, ...]) -> Dictionary:
    """Waves of a joint angle, and products of those of two, of which one at least is faster than the forms of
    angles. Without the former, a product with something that hardly changes would stand for one."""
    turning = [j for j, slides in enumerate(prismatic, 1) if not slides]
    waves = [f for j in turning for f in _joint_factors(data, j, _WAVE_FORMS)]
    one = Factor("", ONE, np.ones(data.n))
    alone = ((f, one) for j in turning for f in _joint_factors(data, j, _RIPPLE_FORMS))
    two = (
        (a, b)
        for a, b in itertools.combinations(waves, 2)
        if a.driver != b.driver and max(a.basis.c1, b.basis.c1) >= FAST_WAVES
    )
    return _dictionary(itertools.chain(alone, two))


def _joint_factors(data: Measurements, j: int, forms: Iterable[tuple[str, float]]) -> Iterator[Factor]:
    """Functions of the angle of joint j (from 1); none where it stands still."""
    q = data.q[:, j - 1]
    if np.ptp(q) > _LEAST_SPREAD:
        for fn, c1 in forms:
            basis = Basis(fn, "q", j, 0.0, c1)
            yield Factor(f"q{j}", basis, evaluate(basis, q))


def _factors_of(data: Measurements, prismatic: tuple[bool, ...]) -> Iterator[Factor]:
    for j, slides in enumerate(prismatic, 1):
        yield from _joint_factors(data, j, _SLIDE_FORMS if slides else _ANGLE_FORMS)
    if data.direction is not None:
        for j in range(1, len(prismatic) + 1):
            yield Factor(f"dir{j}", Basis("lin", "dir", j), data.direction[:, j - 1])
    yield from _slow_factors(data)


def _slow_factors(data: Measurements) -> Iterator[Factor]:
    values = {"temp": data.temp_c, "payload": data.payload_kg, "pan": data.pan_rad, "tilt": data.tilt_rad}
    if not data.order_is_time:
        values["t"] = data.t_s
    for name, x in values.items():
        if x is not None and np.ptp(x) > 1e-9:
            yield _centred(name, 0, x)


def _centred(name: str, index: int, x: Array) -> Factor:
    """A driver about a round value near its mean: products with it are then about its changes."""
    middle = float(f"{x.mean():.3g}")
    driver = f"{name}{index or ''}"
    return Factor(driver, Basis("lin", name, index, middle), x - middle)


def _dictionary(pairs: Iterable[tuple[Factor, Factor]]) -> Dictionary:
    two = list(pairs)
    values = np.array([a.values for a, _ in two]) * np.array([b.values for _, b in two])
    spread = values.std(axis=-1) if two else np.zeros(0)
    kept = np.flatnonzero(spread > 1e-9)
    return Dictionary(
        tuple((two[k][0].basis, two[k][1].basis) for k in kept),
        tuple(tuple(f.driver for f in two[k] if f.driver) for k in kept),
        values[kept] / spread[kept, None],
    )


def _joined(a: Dictionary, b: Dictionary) -> Dictionary:
    values = np.concatenate([a.values, b.values]) if len(a.bases) else b.values
    return Dictionary(a.bases + b.bases, a.drivers + b.drivers, values)


def spots(columns: Columns) -> list[Spot]:
    """Every component of every place that the data see."""
    fit = columns.fit
    found = [
        Spot(place, component, TYPICAL_SIZE * columns.location(place.frame, (component,))[:, 0, :])
        for place in all_places(fit.arm, fit.data)
        for component in place.components
    ]
    return [spot for spot in found if np.abs(spot.rows).max() > 0]


@dataclass(frozen=True)
class ProductGroup:
    """Products at spots, of which each is as likely as any other. begin: number of products before; fast:
    waves, faster than the other products."""

    book: Dictionary
    where: tuple[Spot, ...]
    begin: int
    fast: bool

    @property
    def tries(self) -> int:
        """Number of columns."""
        return len(self.book.bases) * len(self.where)

    @property
    def end(self) -> int:
        """Number of products before the next group."""
        return self.begin + self.tries


def product_groups(columns: Columns, fast: Collection[bool] = (False, True)) -> list[ProductGroup]:
    """Products at joint axes, at other places, and fast waves at joint axes: as likely together, each. Those
    without products are left out. fast: of these kinds."""
    fit, where = columns.fit, spots(columns)
    joints = tuple(spot for spot in where if spot.place.name.startswith("joint"))
    others = tuple(spot for spot in where if not spot.place.name.startswith("joint"))
    book = product_dictionary(columns)
    waves = _recorded_waves(fit.data, tuple(joint.prismatic for joint in fit.arm.joints))
    found: list[ProductGroup] = []
    for products, places, kind in ((book, joints, False), (book, others, False), (waves, joints, True)):
        group = ProductGroup(products, places, found[-1].end if found else 0, kind)
        if group.tries and kind in fast:
            found.append(group)
    return found


@dataclass(frozen=True)
class ProductScores:
    """Evidence of a whole dictionary.

    best: those with the most evidence, best first; ln_bf, ln_share: (S,) of those and of all others that
    matter, in the same order: ln Bayes factor, and ln of their part of the prior; tries: number of columns.
    """

    best: tuple[ScoredProduct, ...]
    ln_bf: Array
    ln_share: Array
    tries: int

    def ln_mean(self, dropped: Collection[int] = ()) -> float:
        """ln of the mean Bayes factor over all products: it pays for the number of tries. dropped: positions
        that do not count, because an effect of the library is that very product."""
        kept = np.ones(len(self.ln_bf), dtype=bool)
        kept[list(dropped)] = False
        return float(np.logaddexp.reduce((self.ln_bf + self.ln_share)[kept], initial=-np.inf))


def score_products(
    columns: Columns,
    projector: Projector,
    wz: Array,
    noise: NoiseScale,
    *,
    count: int = 16,
    fast: Collection[bool] = (False, True),
) -> ProductScores | None:
    """Score all products at all places; the `count` best with their columns. None where there are none. fast:
    as of `product_groups`."""
    groups = product_groups(columns, fast)
    if not groups:
        return None
    rows = wz.reshape(columns.n, columns.c)
    moments = [_moments(group.book.values, group.where, projector, rows) for group in groups]
    u, v = (np.concatenate([x.ravel() for x in of_groups]) for of_groups in zip(*moments, strict=True))
    chi2 = np.where(v > 0.0, u**2 / np.where(v > 0.0, v, 1.0), 0.0)
    top = np.sort(np.argsort(-chi2)[:_SCORED])
    ln_bf = ln_bayes_factor(u[top, None], v[top, None], noise)
    order = np.argsort(-ln_bf.round(6), kind="stable")  # of the same column at two places the joint axis
    best = tuple(_scored(groups, int(top[k]), float(ln_bf[k])) for k in order[:count])
    share = np.concatenate([np.full(g.tries, -np.log(len(groups) * g.tries)) for g in groups])
    return ProductScores(best, ln_bf[order], share[top[order]], len(share))


def _moments(values: Array, where: Sequence[Spot], projector: Projector, wz: Array) -> tuple[Array, Array]:
    """(P, M) u = G'Wz and v = G'WG of every product at every spot; v is 0 where nothing is left of it."""
    n, c = wz.shape
    basis = projector.basis.reshape(n, c, -1)
    u = values @ np.stack([(s.rows * wz).sum(axis=1) for s in where], axis=1)
    raw = values**2 @ np.stack([(s.rows**2).sum(axis=1) for s in where], axis=1)
    taken = np.stack(
        [(values @ np.einsum("nc,nck->nk", s.rows, basis)) ** 2 @ projector.shrink for s in where], axis=1
    )
    left = raw - taken
    return u, np.where(left > (1.0 - _ABSORBED) * raw, left, 0.0)


def _scored(groups: Sequence[ProductGroup], k: int, ln_bf: float) -> ScoredProduct:
    """The product of number k of all groups."""
    group = next(g for g in groups if k < g.end)
    which, at = divmod(k - group.begin, len(group.where))
    product, spot, drivers = group.book.bases[which], group.where[at], group.book.drivers[which]
    column = (group.book.values[which][:, None] * spot.rows).ravel()
    return ScoredProduct(spot.place, spot.component, product, drivers, ln_bf, column)
