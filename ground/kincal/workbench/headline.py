"""The numbers that a reader of an answer looks for first: error now, reachable, noise floor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from . import explain
from .compare import Comparison
from .diagnosis import Diagnosis


@dataclass(frozen=True)
class BigNumber:
    """A label, an error [m], [rad] (None where unknown), the error once the findings are added (None if
    nothing was), and where it comes from, in words."""

    label: str
    pos_m: float | None
    rot_rad: float | None
    about: str
    after_m: float | None = None
    after_rad: float | None = None

    @property
    def text(self) -> str:
        """With its unit; before and after where something was found."""
        if self.pos_m is None or not math.isfinite(self.pos_m):
            return "unknown"
        position = _arrow(self.pos_m, self.after_m, "mm")
        rotation = "" if self.rot_rad is None else f", {_arrow(self.rot_rad, self.after_rad, 'mrad')}"
        return position + rotation


def _arrow(before: float, after: float | None, unit: str) -> str:
    change = "" if after is None or not math.isfinite(after) else f" → {after * 1e3:.3f}"
    return f"{before * 1e3:.3f}{change} {unit}"


def big_numbers(c: Comparison, d: Diagnosis | None = None) -> tuple[BigNumber, ...]:
    """Error now (and with the findings of a diagnosis), what is reachable, noise floor."""
    now, black_box = _now(c, d), _reachable(c)
    if now.after_m is not None and black_box.pos_m is not None and now.after_m < black_box.pos_m:
        black_box = replace(black_box, about=f"{black_box.about}; the findings do better")
    return now, black_box, _floor(c)


def _now(c: Comparison, d: Diagnosis | None) -> BigNumber:
    held = len(c.split.held)
    pos_m, rot_rad = c.rms["held"] if held else c.rms["fit"]
    about = f"RMS of {held} held-out poses" if held else "RMS of the fitted poses; none are held out"
    if d is None or not held or not any(e.in_model for e in d.effects):
        return BigNumber("error now", pos_m, rot_rad, about)
    after = d.remainder.held_pos_m, d.remainder.held_rot_rad
    return BigNumber("error now, and with the findings", pos_m, rot_rad, about, *after)


def _reachable(c: Comparison) -> BigNumber:
    found = c.reachable
    if found is None:
        return BigNumber("reachable", None, None, "no poses are held out")
    if not found.enough:
        return BigNumber("reachable", None, None, explain.reachable_by(found))
    return BigNumber("reachable", found.pos_m, found.rot_rad, explain.reachable_by(found))


def _floor(c: Comparison) -> BigNumber:
    f = c.noise_floor
    return BigNumber("noise floor", f.pos_m, f.rot_rad, f.source.removeprefix("unknown: "))
