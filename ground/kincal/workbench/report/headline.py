"""The numbers that a reader of an answer looks for first: errors of the arm as it is, after DH calibration
and with effects; what is reachable; the noise floor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from ..comparison.compare import Comparison
from ..diagnosis import Diagnosis
from ..evidence.adequacy import Outliers
from ..prediction.nested import DH, NOMINAL
from . import explain

_LABELS = {
    NOMINAL: "nominal arm",
    DH: "after DH calibration",
    "model": "with the effects of the model",
    "findings": "with the findings",
}


@dataclass(frozen=True)
class BigNumber:
    """A label, an error [m], [rad] (None where unknown), and where it comes from, in words."""

    label: str
    pos_m: float | None
    rot_rad: float | None
    about: str

    @property
    def text(self) -> str:
        """With its unit."""
        if self.pos_m is None or not math.isfinite(self.pos_m):
            return "unknown"
        rotation = "" if self.rot_rad is None else f", {self.rot_rad * 1e3:.3f} mrad"
        return f"{self.pos_m * 1e3:.3f} mm{rotation}"


def big_numbers(c: Comparison, d: Diagnosis | None = None, *, each: bool = False) -> tuple[BigNumber, ...]:
    """Errors of the nominal arm, after DH calibration and with the findings of a diagnosis (each: one after
    another), what is reachable, noise floor."""
    errors = list(_errors(c, d, each))
    black_box = reachable_number(c, None if d is None else d.outliers)
    if d is not None and d.advised.crossed:  # errors of other poses than those before it
        black_box = replace(black_box, about=f"{len(c.split.held)} held-out poses; {black_box.about}")
    elif d is not None and _less(errors[-1], black_box):
        black_box = replace(black_box, about=f"{black_box.about}; the findings do better")
    elif d is not None and d.novel is not None and d.novel.held.gains:
        with_it = replace(errors[-1], pos_m=(errors[-1].pos_m or math.nan) * d.novel.held.ratio)
        if _less(with_it, black_box):
            about = f"{black_box.about}; a smooth function of what was found does better"
            black_box = replace(black_box, about=about)
    return *errors, black_box, _floor(c)


def _less(one: BigNumber, other: BigNumber) -> bool:
    """A smaller position error, and no larger rotation error where both have one."""
    if one.pos_m is None or other.pos_m is None:
        return False
    turned = one.rot_rad is not None and other.rot_rad is not None and one.rot_rad > other.rot_rad
    return one.pos_m < other.pos_m and not turned


def _errors(c: Comparison, d: Diagnosis | None, each: bool) -> Iterator[BigNumber]:
    held, outliers = len(c.split.held), c.outliers if d is None else d.outliers
    about = f"RMS of {held} held-out poses" if held else "RMS of the fitted poses; none are held out"
    errors = () if d is None else d.advised.headline
    if crossed := d is not None and bool(d.advised.crossed):
        about = f"RMS of {c.fit_all.data.n} poses, held out in turns"
    found, usual = {e.model: (e.pos_m, e.rot_rad) for e in errors}, {e.model: e.usual for e in errors}
    found, usual = found or dict(c.errors), usual or c.errors_without(outliers.ids)
    count = explain.among(outliers, c.fit_all.data if crossed else c.measured)
    effects = [name for name in found if name.startswith("+ ")]
    if effects and not each:
        first = {name: found[name] for name in (NOMINAL, DH) if name in found}
        found, usual = {**first, "findings": found[effects[-1]]}, {**usual, "findings": usual[effects[-1]]}
    for name, (pos_m, rot_rad) in found.items():
        without = f"; {explain.without_outliers(count, *usual[name])}" if count else ""
        frames = _frames(c) if name == NOMINAL else ""
        yield BigNumber(_LABELS.get(name, name), pos_m, rot_rad, about + without + frames)


def _frames(c: Comparison) -> str:
    """What is fitted of the nominal arm all the same."""
    arm = c.fit_all.arm
    names = [name for name, frame in (("base", arm.base), ("tool", arm.tool)) if frame.estimate]
    return f"; {' and '.join(names)} frame fitted" if names else ""


def reachable_number(c: Comparison, outliers: Outliers | None = None) -> BigNumber:
    """What a black box reaches; without the outliers (absent: those of the comparison) too."""
    found = c.reachable
    if found is None:
        return BigNumber("reachable", None, None, "no poses are held out")
    by = explain.reachable_by(found, structured=c.structured)
    if not found.enough:
        return BigNumber("reachable", None, None, by)
    without = explain.reachable_without(found, outliers or c.outliers)
    return BigNumber("reachable", found.pos_m, found.rot_rad, without + by)


def _floor(c: Comparison) -> BigNumber:
    f = c.noise_floor
    return BigNumber("noise floor", f.pos_m, f.rot_rad, f.source.removeprefix("unknown: "))
