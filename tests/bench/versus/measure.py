"""Times of several programs for the same work, taken in turn in one run, and what follows from them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

OURS = "KinCal"
Timed = Callable[[], float]
"""Does the work once and gives its processor seconds: what else the machine does counts for less."""


@dataclass(frozen=True)
class Ratio:
    """Seconds of another program in parts of ours. part, case, other: what, on what, compared with what;
    ratio: median over rounds; low, high: 10 and 90 % of the rounds; ours_s: our median; off: largest
    difference between the two results, and its unit in words."""

    part: str
    case: str
    other: str
    ratio: float
    low: float
    high: float
    ours_s: float
    off: float
    off_what: str


@dataclass(frozen=True)
class Growth:
    """Median seconds by size. part: what; variable: what grows; seconds: by program, one a size."""

    part: str
    variable: str
    sizes: tuple[int, ...]
    seconds: dict[str, tuple[float, ...]]

    def exponent(self, name: str) -> float:
        """Of the power law that fits best: slope of log seconds over log size."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.seconds[name]), 1)[0])


def in_turn(calls: Mapping[str, Timed], rounds: int, warm: int = 1) -> dict[str, list[float]]:
    """Seconds of every program, one a round. In a round each has its turn, in the other order every second
    time, so that what else the machine does hits all alike."""
    took: dict[str, list[float]] = {name: [] for name in calls}
    for k in range(-warm, rounds):
        for name in list(calls) if k % 2 == 0 else reversed(list(calls)):
            seconds = calls[name]()
            if k >= 0:
                took[name].append(seconds)
    return took


def compared(
    part: str,
    case: str,
    calls: Mapping[str, Timed],
    off: Mapping[str, float],
    off_what: str,
    rounds: int,
) -> list[Ratio]:
    """Ratios of all other programs to ours. off: largest difference of each one's result from ours."""
    took = in_turn(calls, rounds)
    ours = np.array(took[OURS])
    out = []
    for name, seconds in took.items():
        if name != OURS:
            low, mid, high = np.quantile(np.array(seconds) / ours, [0.1, 0.5, 0.9])
            found = (float(mid), float(low), float(high), float(np.median(ours)))
            out.append(Ratio(part, case, name, *found, off[name], off_what))
    return out


def timed(work: Callable[[], object]) -> Timed:
    """A call, as it is timed: in one thread."""

    def call() -> float:
        begun = time.thread_time()
        work()
        return time.thread_time() - begun

    return call


def growth(
    part: str,
    variable: str,
    sizes: tuple[int, ...],
    calls_of: Callable[[int], Mapping[str, Timed]],
    rounds: int,
) -> Growth:
    """Median seconds of every program at every size."""
    medians = [
        {name: float(np.median(seconds)) for name, seconds in in_turn(calls_of(size), rounds).items()}
        for size in sizes
    ]
    return Growth(part, variable, sizes, {name: tuple(m[name] for m in medians) for name in medians[0]})
