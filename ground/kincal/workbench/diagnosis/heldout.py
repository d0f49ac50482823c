"""What poses that a model was not fitted to gain from an effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evidence.adequacy import gross
from ..numerics.types import Array, Groups
from ..prediction.gain import Gain, held_ratio, judged, nothing_gained, together


@dataclass(frozen=True)
class HeldGain:
    """Held-out position RMS [m] without and with an effect, and a 95 % bootstrap interval over the poses of
    their ratio (with / without). NaN where no poses are held out.

    cross_validated: too few poses are held out; all poses were, in turns; rotation: ratio of the RMS rotation
    errors, None without rotations.
    """

    before_m: float
    after_m: float
    interval: tuple[float, float]
    cross_validated: bool = False
    rotation: float | None = None

    @classmethod
    def of(
        cls, before: Array, after: Array, groups: Groups | None = None, *, cross_validated: bool
    ) -> HeldGain:
        """From squared position errors (M,) [m^2] of the same poses; gross outliers, off by far with and
        without the effect, tell nothing of it and are left out. groups: (M,) equal for replicates."""
        usual = ~(gross(before) & gross(after))
        before, after = before[usual], after[usual]
        _, interval = held_ratio(after, before, None if groups is None else groups[usual])
        return cls(float(np.sqrt(before.mean())), float(np.sqrt(after.mean())), interval, cross_validated)

    @property
    def gains(self) -> bool:
        """Held-out poses are predicted better, as `judged`: a torque of micronewton metres gained nothing,
        with certainty."""
        return self.judged == "helps"

    @property
    def harms(self) -> bool:
        """Held-out poses are predicted worse, as `judged`."""
        return self.judged == "harms"

    @property
    def ratio(self) -> float:
        """Of RMS errors, with orientations of positions and rotations in equal shares."""
        return together(self.after_m / self.before_m, self.rotation)

    @property
    def nothing(self) -> bool:
        """Held-out poses gain nothing: two thousandths at most, or positions lose as much."""
        return nothing_gained(self.after_m / self.before_m, self.rotation)

    @property
    def judged(self) -> Gain:
        """Whether held-out poses are predicted better, in words."""
        return judged(self.after_m / self.before_m, self.interval, nothing=self.nothing)

    @property
    def worse(self) -> bool:
        """The error of the held-out poses grows, be it by chance."""
        return self.after_m > self.before_m


NO_HELD_OUT = HeldGain(float("nan"), float("nan"), (float("nan"), float("nan")))
