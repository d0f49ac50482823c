"""Held-out error of nested models: nominal arm, DH, DH + first effect, ... beside the noise floor."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from ..data.split import Split, choose_split
from ..evidence.adequacy import NoiseFloor
from ..evidence.constants import Anew
from ..fit.least_squares import Frames, find_frames, fit_model, rms
from ..model.effects import Hypothesis
from ..model.hypotheses import covers
from ..numerics.types import Array, Indices, Mask, Progress, no_progress
from .crossval import folds
from .gain import Gain, held_ratio, judged, much_worse, nothing_gained, rms_interval

HELD_OUT, FITTED, CROSSED = "held-out poses", "fitted poses", "poses in turns"
"""The block of the split in use; all poses, where none are held out; all that may be fitted, held out in
turns (cross-validation)."""
FEW_HELD = 20  # held-out poses; an interval from fewer says nothing, so that all poses take turns
TURNS = 5
LEAST_IN_TURNS = 8  # poses
NOMINAL, DH = "nominal", "DH"
"""The models before the first effect."""
_FIFTH = 0.8  # quantile beyond which a fifth of the poses lies
_LEAST_HELD, _MOST_HELD = 4, 0.6  # poses of a block, share of all poses


@dataclass(frozen=True)
class Block:
    """A way of holding poses back: at random (file or every 4th), an unseen region, a time block, one
    direction of approach. fit, held: indices of the poses."""

    name: str
    fit: Indices
    held: Indices


@dataclass(frozen=True)
class NestedModel:
    """Held-out error of one model on one block.

    pos_m, rot_rad: RMS [m], [rad] (None without rotations); pos_interval: 95 % bootstrap interval of pos_m
    over the held-out poses; sys_pos_m: without the stated noise [m], None where none is stated; max_pos_m: of
    the worst pose; ratio: pos_m over that of the model before, with a 95 % bootstrap interval; None for the
    first model; usual: pos_m and rot_rad without the outliers among the held-out poses.
    """

    model: str
    block: str
    pos_m: float
    rot_rad: float | None
    sys_pos_m: float | None
    max_pos_m: float
    ratio: float | None
    ratio_interval: tuple[float, float] | None
    pos_interval: tuple[float, float]
    usual: tuple[float, float | None]


@dataclass(frozen=True)
class EffectGain:
    """What one effect brings on one block: the whole model against the model without this effect alone.

    before_m, after_m: held-out position RMS [m] without and with it; ratio: after / before, with its 95 %
    bootstrap interval; judged: by that interval; rotation: that ratio of rotation errors with its interval,
    None without rotations.
    """

    effect: str
    block: str
    before_m: float
    after_m: float
    ratio: float
    interval: tuple[float, float]
    rotation: tuple[float, tuple[float, float]] | None = None

    @property
    def judged(self) -> Gain:
        """Whether it helps, by the interval."""
        rotation = None if self.rotation is None else self.rotation[0]
        return judged(self.ratio, self.interval, nothing=nothing_gained(self.ratio, rotation))

    @property
    def advised_against(self) -> bool:
        """Held-out poses are predicted worse with it, or positions or rotations of a block much worse."""
        if self.block in (HELD_OUT, CROSSED) and self.judged == "harms":
            return True
        return much_worse(self.interval) or (self.rotation is not None and much_worse(self.rotation[1]))


@dataclass(frozen=True)
class NestedModels:
    """All models on all blocks, in the order of fitting; gains: of each effect on each block."""

    models: tuple[NestedModel, ...]
    floor: NoiseFloor
    gains: tuple[EffectGain, ...]

    @property
    def no_gain(self) -> tuple[EffectGain, ...]:
        """Effects that the held-out poses of a block do not show to help."""
        return tuple(g for g in self.gains if g.judged != "helps")

    @property
    def against(self) -> tuple[EffectGain, ...]:
        """What speaks against effects of the model: the blocks where they do harm."""
        return tuple(g for g in self.gains if g.advised_against)

    @property
    def not_recommended(self) -> tuple[str, ...]:
        """Effects that the model is better without, each once."""
        return tuple(dict.fromkeys(g.effect for g in self.against))

    @property
    def blocks(self) -> tuple[str, ...]:
        """The ways of holding poses back, each once."""
        return tuple(dict.fromkeys(m.block for m in self.models))

    def of(self, block: str) -> tuple[NestedModel, ...]:
        """The models on one block."""
        return tuple(m for m in self.models if m.block == block)


def fit_nested(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis],
    floor: NoiseFloor,
    names: Sequence[str] = (),
    *,
    dh: bool = True,
    outliers: Collection[str] = (),
    anew: Anew | None = None,
    progress: Progress = no_progress,
) -> NestedModels:
    """Fit nominal, DH, DH + first effect, ... on every block and measure what was held back. The gain of
    an effect compares the whole model with the one that lacks it: the order of adding does not matter.

    names: what the hypotheses were asked for as; those of one name (all joints of an effect, or some) count
    as one effect; outliers: ids of poses without which errors are given too; anew: the effects for the fit
    poses of a block alone (absent: as they are). Where few poses are held out, all take turns too, and these
    judge the effects."""
    groups, todo = _by_effect(hypotheses, names), _all_blocks(data)
    model = _Model(arm, hypotheses, dh, anew)
    models: list[NestedModel] = []
    gains: list[EffectGain] = []
    for number, block in enumerate(todo):
        held_out = _HeldOut.of(model, data, block, outliers)
        steps, fitted = [*_steps(groups, dh)], []
        for step in steps:
            progress(f"{block.name}: {step.label}", number, len(todo))
            fitted.append(held_out.residuals(step.effects, step.dh))
        models += held_out.models([step.label for step in steps], fitted)
        if block.counts:
            gains += [held_out.gain(name, group, fitted[-1]) for name, group in groups.items()]
    return NestedModels(tuple(models), floor, tuple(gains))


def harmful(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis],
    names: Sequence[str],
    *,
    dh: bool = True,
    anew: Anew | None = None,
    progress: Progress = no_progress,
) -> tuple[EffectGain, ...]:
    """What speaks against the named effects of a model: the blocks where they do harm, as `fit_nested` finds
    them. anew: as of it."""
    groups, found = _by_effect(hypotheses, names), list[EffectGain]()
    model, todo = _Model(arm, hypotheses, dh, anew), [b for b in _all_blocks(data) if b.counts]
    for number, block in enumerate(todo):
        progress(f"{block.name}: does it harm?", number, len(todo))
        held_out = _HeldOut.of(model, data, block)
        whole = held_out.residuals(model.names, dh)
        found += [held_out.gain(name, groups[name], whole) for name in names]
    return tuple(g for g in found if g.advised_against)


def errors_by_step(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis],
    names: Sequence[str] = (),
    *,
    dh: bool = True,
    outliers: Collection[str] = (),
    anew: Anew | None = None,
) -> tuple[NestedModel, ...]:
    """Errors of the nominal arm, after DH calibration and with each effect: those of `fit_nested` on the
    held-out poses, to the last digit, before them those of poses in turns where it has these; on the fitted
    ones where none are held out. outliers, anew: as of
    it."""
    split, every = choose_split(data), np.arange(data.n)
    block = Block(HELD_OUT, split.fit, split.held) if len(split.held) else Block(FITTED, every, every)
    todo = [b for b in (_in_turns(data), _Blocks((block,))) if b is not None]
    model, steps = _Model(arm, hypotheses, dh, anew), [*_steps(_by_effect(hypotheses, names), dh)]
    models: list[NestedModel] = []
    for one in todo:
        held_out = _HeldOut.of(model, data, one, outliers)
        fitted = [held_out.residuals(step.effects, step.dh) for step in steps]
        models += held_out.models([step.label for step in steps], fitted)
    return tuple(models)


def cost_without(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis],
    left_out: Sequence[Hypothesis],
    *,
    dh: bool = True,
    anew: Anew | None = None,
) -> EffectGain:
    """What the effects that are left out bring together on the held-out poses. CannotAnswer if none are held
    out. anew: as of `fit_nested`."""
    block = next((b for b in blocks(data, choose_split(data)) if b.name == HELD_OUT), None)
    if block is None:
        raise CannotAnswer(
            "no poses are held out", todo="measure more, or leave some out by the column split"
        )
    model, names = _Model(arm, hypotheses, dh, anew), tuple(h.name for h in left_out)
    held_out = _HeldOut.of(model, data, _Blocks((block,)))
    return held_out.gain(", ".join(names), names, held_out.residuals(model.names, dh))


def _by_effect(hypotheses: Sequence[Hypothesis], names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Names of hypotheses by the name that they are shown with."""
    groups: dict[str, tuple[str, ...]] = {}
    for h in hypotheses:
        label = next((name for name in names if covers(name, h.name)), h.name)
        groups[label] = (*groups.get(label, ()), h.name)
    return groups


@dataclass(frozen=True)
class _Model:
    """What is fitted on each block; anew: as of `fit_nested`."""

    arm: ArmTable
    hypotheses: Sequence[Hypothesis]
    dh: bool
    anew: Anew | None

    @property
    def names(self) -> tuple[str, ...]:
        """Of all its effects."""
        return tuple(h.name for h in self.hypotheses)


@dataclass(frozen=True)
class _Step:
    label: str
    dh: bool
    effects: tuple[str, ...]


def _steps(groups: dict[str, tuple[str, ...]], dh: bool) -> Iterator[_Step]:
    yield _Step(NOMINAL, False, ())
    if dh:
        yield _Step(DH, True, ())
    used: tuple[str, ...] = ()
    for name, group in groups.items():
        used = (*used, *group)
        yield _Step(f"+ {name}", dh, used)


@dataclass(frozen=True)
class _Turn:
    """Poses to fit with the frames found from them and the effects of the model, and those held out."""

    part: Measurements
    held: Measurements
    frames: Frames
    hypotheses: Sequence[Hypothesis]

    @classmethod
    def of(cls, model: _Model, data: Measurements, block: Block) -> _Turn:
        """Of one block."""
        part = data.take(block.fit)
        used = model.hypotheses if model.anew is None else model.anew(part)
        return cls(part, data.take(block.held), find_frames(model.arm, part), used)

    def residuals(self, arm: ArmTable, effects: Collection[str], dh: bool) -> Array:
        """(M, c) of the held-out poses; effects: by name."""
        used = [h for h in self.hypotheses if h.name in effects]
        return fit_model(arm, self.part, used, dh=dh, frames=self.frames).predict(self.held)


@dataclass(frozen=True)
class _HeldOut:
    """Poses held out, at once or in turns: fits models to the others, measures them on these.

    order: (M,) puts the poses of all turns into that of the file; held: (M,) all of them; usual: (M,) those
    that are no outliers; all, where there is no other; fitted: residuals of the models so far, since the
    model before an effect may be the whole one without it."""

    model_: _Model
    name: str
    turns: tuple[_Turn, ...]
    order: Indices
    held: Measurements
    usual: Mask
    fitted: dict[tuple[bool, frozenset[str]], Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls, model: _Model, data: Measurements, blocks: _Blocks, outliers: Collection[str] = ()
    ) -> _HeldOut:
        """Frames found from the fit poses of each turn."""
        turns = tuple(_Turn.of(model, data, block) for block in blocks.turns)
        places = np.concatenate([block.held for block in blocks.turns])
        order = np.argsort(places, kind="stable")
        held = data.take(places[order])
        return cls(model, blocks.name, turns, order, held, held.are_not(outliers))

    def residuals(self, effects: Collection[str], dh: bool) -> Array:
        """(M, c) residuals of the held-out poses by a model with these of the effects."""
        key = dh, frozenset(effects)
        if key not in self.fitted:
            left = [turn.residuals(self.model_.arm, effects, dh) for turn in self.turns]
            self.fitted[key] = np.vstack(left)[self.order]
        return self.fitted[key]

    def models(self, labels: Sequence[str], fitted: Sequence[Array]) -> list[NestedModel]:
        """Each model beside the one before it."""
        before = [None, *fitted]
        return [self.model(label, r, b) for label, r, b in zip(labels, fitted, before, strict=False)]

    def model(self, label: str, r: Array, before: Array | None) -> NestedModel:
        """Errors of one model from its residuals and those of the model before."""
        square = _square(r)
        ratio = interval = None
        if before is not None:
            ratio, interval = held_ratio(square, _square(before), self.held.repeats)
        position, rotation = rms(r)
        worst, systematic = float(np.sqrt(square.max())), self._systematic(square)
        spread = rms_interval(square, self.held.repeats)
        return NestedModel(
            label, self.name, position, rotation, systematic, worst, ratio, interval, spread,
            rms(r[self.usual]),
        )  # fmt: skip

    def _systematic(self, square: Array) -> float | None:
        if self.held.cov is None:
            return None
        noise = np.einsum("nii->n", self.held.cov[:, :3, :3]).mean()
        return float(np.sqrt(max(0.0, square.mean() - noise)))

    def gain(self, name: str, group: Collection[str], whole: Array) -> EffectGain:
        """What a group of the effects brings beside the others. whole: (M, c) residuals with all."""
        others = [effect for effect in self.model_.names if effect not in group]
        without = self.residuals(others, self.model_.dh)
        before, after = _square(without), _square(whole)
        groups = self.held.repeats
        ratio, interval = held_ratio(after, before, groups)
        rms_m = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
        turned = held_ratio(_turned(whole), _turned(without), groups) if whole.shape[1] == 6 else None
        return EffectGain(name, self.name, *rms_m, ratio, interval, turned)


def _turned(r: Array) -> Array:
    """(M,) squared rotation errors [rad^2] of residuals (M, 6)."""
    square: Array = (r[:, 3:] ** 2).sum(axis=1)
    return square


def _square(r: Array) -> Array:
    """(M,) squared position errors [m^2] of residuals (M, c)."""
    square: Array = (r[:, :3] ** 2).sum(axis=1)
    return square


# -------------------------------------------------------------------------------------------- blocks


def blocks(data: Measurements, split: Split) -> list[Block]:
    """The split in use, and a region, a time block and a direction cut from the poses it may fit."""
    out = [Block(HELD_OUT, split.fit, split.held)] if len(split.held) else []
    pool = split.fit if split.given else np.arange(data.n)
    masks = (
        ("unseen region", _region(data.q[pool])),
        ("time block", _time(data, pool)),
        ("direction", _direction(data, pool)),
    )
    out += [
        Block(name, pool[~mask], pool[mask])
        for name, mask in masks
        if mask is not None and _LEAST_HELD <= mask.sum() <= _MOST_HELD * len(pool)
    ]
    return out


@dataclass(frozen=True)
class _Blocks:
    """Blocks that together are one way of holding poses back; counts: effects are judged by them."""

    turns: tuple[Block, ...]
    counts: bool = True

    @property
    def name(self) -> str:
        """Of all of them."""
        return self.turns[0].name


def _all_blocks(data: Measurements) -> list[_Blocks]:
    """All ways of holding poses back; in turns where few poses are held out, which do not count then."""
    turns = _in_turns(data)
    single = [_Blocks((b,), b.name != HELD_OUT or turns is None) for b in blocks(data, choose_split(data))]
    return [*([turns] if turns else []), *single]


def _in_turns(data: Measurements) -> _Blocks | None:
    """The poses that may be fitted, each held out once; None where enough are held out at once, or where too
    few are there."""
    split = choose_split(data)
    pool = split.fit if split.given else np.arange(data.n)
    if not 0 < len(split.held) < FEW_HELD or len(pool) < LEAST_IN_TURNS:
        return None
    number = folds(data.take(pool), TURNS)
    parts = [(pool[number != k], pool[number == k]) for k in np.unique(number)]
    return _Blocks(tuple(Block(CROSSED, fit, held) for fit, held in parts))


def _region(q: Array) -> Mask:
    """The fifth of the poses farthest along the leading direction of the joint angles: one corner."""
    centred = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    _, _, vt = np.linalg.svd(centred, full_matrices=False)
    return _last_fifth(centred @ vt[0])


def _time(data: Measurements, pool: Indices) -> Mask | None:
    """The last fifth in time."""
    if data.t_s is None or np.ptp(data.t_s[pool]) == 0:
        return None
    return _last_fifth(data.t_s[pool])


def _direction(data: Measurements, pool: Indices) -> Mask | None:
    """Poses whose joints were mostly approached upward, a fifth of them."""
    if data.direction is None or np.ptp(data.direction) == 0:
        return None
    return _last_fifth(data.direction[pool].sum(axis=1) + 1e-6 * np.arange(len(pool)))


def _last_fifth(x: Array) -> Mask:
    mask: Mask = x >= np.quantile(x, _FIFTH)
    return mask
