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
from .gain import Gain, held_ratio, judged, much_worse, nothing_gained, rms_interval

HELD_OUT, FITTED = "held-out poses", "fitted poses"
"""The block of the split in use; all poses, where none are held out."""
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
        return judged(self.interval, nothing=nothing_gained(self.ratio, rotation))

    @property
    def advised_against(self) -> bool:
        """Held-out poses are predicted worse with it, or positions or rotations of a block much worse."""
        if self.block == HELD_OUT and self.judged == "harms":
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
    poses of a block alone (absent: as they are)."""
    todo = blocks(data, choose_split(data))
    models: list[NestedModel] = []
    gains: list[EffectGain] = []
    for number, block in enumerate(todo):
        held_out = _HeldOut.of(arm, data, block, dh, outliers)
        used = held_out.effects(hypotheses, anew)
        groups = _by_effect(used, names)
        steps, fitted = [*_steps(groups, dh)], []
        for step in steps:
            progress(f"{block.name}: {step.label}", number, len(todo))
            fitted.append(held_out.residuals(step.hypotheses, step.dh))
        models += held_out.models([step.label for step in steps], fitted)
        gains += [held_out.gain(name, group, used, fitted[-1]) for name, group in groups.items()]
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
    found: list[EffectGain] = []
    todo = blocks(data, choose_split(data))
    for number, block in enumerate(todo):
        progress(f"{block.name}: does it harm?", number, len(todo))
        held_out = _HeldOut.of(arm, data, block, dh)
        used = held_out.effects(hypotheses, anew)
        groups, whole = _by_effect(used, names), held_out.residuals(used, dh)
        found += [held_out.gain(name, groups[name], used, whole) for name in names]
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
    held-out poses, to the last digit; on the fitted ones where none are held out. outliers, anew: as of
    it."""
    split, every = choose_split(data), np.arange(data.n)
    block = Block(HELD_OUT, split.fit, split.held) if len(split.held) else Block(FITTED, every, every)
    held_out = _HeldOut.of(arm, data, block, dh, outliers)
    steps = [*_steps(_by_effect(held_out.effects(hypotheses, anew), names), dh)]
    fitted = [held_out.residuals(step.hypotheses, step.dh) for step in steps]
    return tuple(held_out.models([step.label for step in steps], fitted))


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
    held_out, names = _HeldOut.of(arm, data, block, dh), [h.name for h in left_out]
    used = held_out.effects(hypotheses, anew)
    without = [h for h in used if h.name in names]
    return held_out.gain(", ".join(names), without, used, held_out.residuals(used, dh))


def _by_effect(hypotheses: Sequence[Hypothesis], names: Sequence[str]) -> dict[str, list[Hypothesis]]:
    """Effects by the name they are shown with."""
    groups: dict[str, list[Hypothesis]] = {}
    for h in hypotheses:
        groups.setdefault(next((name for name in names if covers(name, h.name)), h.name), []).append(h)
    return groups


@dataclass(frozen=True)
class _Step:
    label: str
    dh: bool
    hypotheses: tuple[Hypothesis, ...]


def _steps(groups: dict[str, list[Hypothesis]], dh: bool) -> Iterator[_Step]:
    yield _Step(NOMINAL, False, ())
    if dh:
        yield _Step(DH, True, ())
    used: tuple[Hypothesis, ...] = ()
    for name, group in groups.items():
        used = (*used, *group)
        yield _Step(f"+ {name}", dh, used)


@dataclass(frozen=True)
class _HeldOut:
    """One block with its frames found: fits models to its fit poses, measures them on the held ones.

    usual: (M,) held-out poses that are no outliers; all, where there is no other; fitted: residuals of the
    models so far, since the model before an effect may be the whole one without it."""

    arm: ArmTable
    block: Block
    part: Measurements
    held: Measurements
    usual: Mask
    frames: Frames
    dh: bool
    fitted: dict[tuple[bool, Sequence[Hypothesis]], Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls, arm: ArmTable, data: Measurements, block: Block, dh: bool, outliers: Collection[str] = ()
    ) -> _HeldOut:
        """Frames found from the fit poses of a block."""
        part, held = data.take(block.fit), data.take(block.held)
        return cls(arm, block, part, held, held.are_not(outliers), find_frames(arm, part), dh)

    def effects(self, hypotheses: Sequence[Hypothesis], anew: Anew | None) -> Sequence[Hypothesis]:
        """Those of a model, with constants that no held-out pose chose."""
        return hypotheses if anew is None else anew(self.part)

    def residuals(self, hypotheses: Sequence[Hypothesis], dh: bool) -> Array:
        """(M, c) residuals of the held-out poses."""
        key = dh, tuple(hypotheses)
        if key not in self.fitted:
            fit = fit_model(self.arm, self.part, hypotheses, dh=dh, frames=self.frames)
            self.fitted[key] = fit.predict(self.held)
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
            label, self.block.name, position, rotation, systematic, worst, ratio, interval, spread,
            rms(r[self.usual]),
        )  # fmt: skip

    def _systematic(self, square: Array) -> float | None:
        if self.held.cov is None:
            return None
        noise = np.einsum("nii->n", self.held.cov[:, :3, :3]).mean()
        return float(np.sqrt(max(0.0, square.mean() - noise)))

    def gain(
        self, name: str, group: Sequence[Hypothesis], hypotheses: Sequence[Hypothesis], whole: Array
    ) -> EffectGain:
        """What a group of the hypotheses brings beside the others. whole: (M, c) residuals with all."""
        without = self.residuals([h for h in hypotheses if h not in group], self.dh)
        before, after = _square(without), _square(whole)
        groups = self.held.repeats
        ratio, interval = held_ratio(after, before, groups)
        rms_m = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
        turned = held_ratio(_turned(whole), _turned(without), groups) if whole.shape[1] == 6 else None
        return EffectGain(name, self.block.name, *rms_m, ratio, interval, turned)


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
