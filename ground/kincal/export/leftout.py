"""What a format cannot carry: which effects, why, and how much they move the tool."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .calibrated import CalibratedArm, FittedTerm, component_name, frame_name, term_text
from .expressions import points_of


@dataclass(frozen=True)
class LeftOut:
    """An effect of the model that a format does not hold.

    why: in words; position_mm: RMS change of the position that it made over the fitted poses, None if that
    is not known.
    """

    effect: str
    why: str
    position_mm: float | None

    def __str__(self) -> str:
        """One line."""
        size = "" if self.position_mm is None else f", worth {self.position_mm:.3g} mm"
        return f"{self.effect}{size}: {self.why}"


def left_out(arm: CalibratedArm, terms: Iterable[FittedTerm]) -> tuple[LeftOut, ...]:
    """One entry for each effect among the terms that a format cannot carry, largest first."""
    by_effect: dict[str, list[FittedTerm]] = {}
    for term in terms:
        by_effect.setdefault(term.coefficient.group, []).append(term)
    sizes = arm.record.position_change_mm
    found = [LeftOut(name, _why(group), sizes.get(name)) for name, group in by_effect.items()]
    return tuple(sorted(found, key=lambda one: -(one.position_mm or 0.0)))


def _why(terms: list[FittedTerm]) -> str:
    if any(points_of(term) for term in terms):
        return "it corrects the pose that a camera finds from its target, not the arm"
    if any(term.on_sensor for term in terms):
        return "it corrects the sensor, not the arm"
    varying = list(dict.fromkeys(term_text(term) for term in terms if not term.constant))
    if varying:
        more = ", ..." if len(varying) > 2 else ""
        return f"it changes with {', '.join(varying[:2])}{more}"
    places = (f"{component_name(term.comp)} at {frame_name(term.frame)}" for term in terms)
    return f"a DH table has no place for {', '.join(dict.fromkeys(places))}"
