"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One thing that is odd about an arm table and its measurements.

    code: its kind, for programs; why: what was seen; fix: what to do; gain: how many times smaller the
    misfit is once it is put right, 1 where that is no question of the fit; severity: "error" makes every
    answer wrong, "warning" should be put right, "note" is only said.
    """

    code: str
    why: str
    fix: str
    gain: float = 1.0
    severity: Severity = "error"
    poses: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Why and what to do, in one line."""
        return f"{self.why}; {self.fix}" if self.fix else self.why
