"""What a hidden case shall be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CaseSpec:
    """A case before it is made.

    effects: texts as kinds.parse reads them; n: number of poses; size: prior sigmas where a text names none;
    noise: true noise over stated noise; outliers: share of gross errors; sequence: "shuffled", or "sorted" =
    region by region, approached as the arm comes; fixed_pantilt: the camera never turns.
    """

    id: str
    effects: tuple[str, ...] = ()
    n: int = 100
    seed: int = 1
    size: float = 1.5
    noise: float = 1.0
    outliers: float = 0.0
    sequence: str = "shuffled"
    fixed_pantilt: bool = False
