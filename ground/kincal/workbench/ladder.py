"""Add it, watch the error fall: held-out error from the nominal arm to the noise floor, rung by rung."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arms import ArmTable
from .compare import NoiseFloor, Split, choose_split
from .data import Measurements
from .effects import Hypothesis
from .fit import find_frames, fit_model

_BOOTSTRAP = 1000
_NO_GAIN = 0.97  # a ratio above, with 1 in its interval, is called no help


@dataclass(frozen=True)
class Block:
    """A way of holding poses back: random-like (file or every 4th), an unseen region, a time block,
    one direction of approach."""

    name: str
    fit: np.ndarray
    held: np.ndarray


@dataclass(frozen=True)
class Rung:
    """Held-out error of one model on one block; ratio: to the rung before, with a 95 % bootstrap interval."""

    model: str
    block: str
    pos_m: float
    rot_rad: float | None
    sys_pos_m: float | None
    max_pos_m: float
    ratio: float | None
    ratio_interval: tuple[float, float] | None


@dataclass(frozen=True)
class Ladder:
    rungs: tuple[Rung, ...]
    floor: NoiseFloor
    verdicts: tuple[str, ...]

    def of(self, block: str) -> tuple[Rung, ...]:
        return tuple(rung for rung in self.rungs if rung.block == block)


def blocks(data: Measurements, split: Split) -> list[Block]:
    """The split in use, and a region, a time block and a direction cut from the poses it may fit."""
    out = [Block("held-out poses", split.fit, split.held)] if len(split.held) else []
    pool = split.fit if split.given else np.arange(data.n)
    out += [
        Block(name, pool[~mask], pool[mask])
        for name, mask in (
            ("unseen region", _region(data.q[pool])),
            ("time block", _time(data, pool)),
            ("direction", _direction(data, pool)),
        )
        if mask is not None and 4 <= mask.sum() <= 0.6 * len(pool)
    ]
    return out


def _region(q: np.ndarray) -> np.ndarray:
    """The fifth of the poses farthest along the leading direction of the joint angles: one corner."""
    centred = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    _, _, vt = np.linalg.svd(centred, full_matrices=False)
    along = centred @ vt[0]
    return along >= np.quantile(along, 0.8)


def _time(data: Measurements, pool: np.ndarray) -> np.ndarray | None:
    t = data.t_s[pool]
    return t >= np.quantile(t, 0.8) if np.ptp(t) > 0 else None


def _direction(data: Measurements, pool: np.ndarray) -> np.ndarray | None:
    """Poses whose joints were mostly approached upward, a fifth of them."""
    if data.direction is None or np.ptp(data.direction) == 0:
        return None
    total = data.direction[pool].sum(axis=1) + 1e-6 * np.arange(len(pool))
    return total >= np.quantile(total, 0.8)


def climb(
    arm: ArmTable,
    data: Measurements,
    hypotheses: list[Hypothesis],
    floor: NoiseFloor,
    *,
    dh: bool = True,
    progress=None,
) -> Ladder:
    """Fit nominal, DH, DH + first effect, ... on every block and measure what was held back. The verdicts
    compare the whole model with the one that lacks the effect, so that the order of adding is no matter."""
    split = choose_split(data)
    names: dict[str, list[Hypothesis]] = {}
    for h in hypotheses:
        names.setdefault(h.effect if h.name == h.effect else h.name, []).append(h)
    steps: list[tuple[str, bool, list[Hypothesis]]] = [("nominal", False, [])]
    if dh:
        steps.append(("DH", True, []))
    used: list[Hypothesis] = []
    for name, group in names.items():
        used = used + group
        steps.append((f"+ {name}", dh, list(used)))
    without = {name: [h for h in hypotheses if h not in group] for name, group in names.items()}
    rungs: list[Rung] = []
    verdicts: list[str] = []
    rng = np.random.default_rng(3)
    todo = blocks(data, split)
    for number, block in enumerate(todo):
        part, held = data.take(block.fit), data.take(block.held)
        frames = find_frames(arm, part)
        before: np.ndarray | None = None
        for label, with_dh, effects in steps:
            if progress:
                progress(f"{block.name}: {label}", number, len(todo))
            fit = fit_model(arm, part, effects, dh=with_dh, frames=frames)
            r = fit.predict(held)
            rung, square = _rung(label, block.name, r, held, before, rng)
            rungs.append(rung)
            before = square
        for name, others in without.items():
            if len(names) > 1:  # what this effect brings once the others are there
                r_without = fit_model(arm, part, others, dh=dh, frames=frames).predict(held)
                rung, _ = _rung(name, block.name, r, held, (r_without[:, :3] ** 2).sum(axis=1), rng)
            verdicts += _verdict(name, rung)
    return Ladder(tuple(rungs), floor, tuple(verdicts))


def _verdict(name: str, rung: Rung) -> list[str]:
    """Said in so many words when held-out poses do not show a gain."""
    if rung.ratio is None or rung.ratio_interval is None or rung.ratio_interval[1] < 1.0:
        return []
    low, high = rung.ratio_interval
    numbers = f"held-out error ratio {rung.ratio:.3f} (95 % interval {low:.3f} to {high:.3f})"
    if rung.ratio > _NO_GAIN:
        return [f"{name} does not help on {rung.block}: {numbers}"]
    return [f"whether {name} helps on {rung.block} these poses cannot tell: {numbers}"]


def _rung(label, block, r, held, before, rng) -> tuple[Rung, np.ndarray]:
    square = (r[:, :3] ** 2).sum(axis=1)
    pos = float(np.sqrt(square.mean()))
    rot = float(np.sqrt((r[:, 3:] ** 2).sum(axis=1).mean())) if r.shape[1] == 6 else None
    systematic = None
    if held.cov is not None:
        noise = np.einsum("nii->n", held.cov[:, :3, :3]).mean()
        systematic = float(np.sqrt(max(0.0, square.mean() - noise)))
    ratio = interval = None
    if before is not None:
        pick = rng.integers(0, len(square), (_BOOTSTRAP, len(square)))
        boot = np.sqrt(square[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-30))
        ratio = float(np.sqrt(square.mean() / before.mean()))
        interval = (float(np.quantile(boot, 0.025)), float(np.quantile(boot, 0.975)))
    return Rung(label, block, pos, rot, systematic, float(np.sqrt(square.max())), ratio, interval), square
