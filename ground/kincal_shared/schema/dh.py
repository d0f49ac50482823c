"""DH errors as correction terms: each is one component of the twist before or after a joint's link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from .names import COMPONENTS


@dataclass(frozen=True)
class DhError:
    """An error of one DH parameter. at: the frame before the joint, or that after its link; comp: of the
    twist there (COMPONENTS)."""

    name: str
    at: Literal["before", "link"]
    comp: str

    @property
    def unit(self) -> str:
        """Of the error."""
        return "rad" if self.comp.startswith("r") else "m"

    @property
    def component(self) -> int:
        """Number of the twist component."""
        return COMPONENTS.index(self.comp)

    def frame(self, joint: int) -> int:
        """Frame of the error of a joint (from 1)."""
        return joint - 1 if self.at == "before" else joint

    def joint(self, frame: int) -> int:
        """Joint whose error acts at a frame; 0 if there is none."""
        return frame + 1 if self.at == "before" else frame


DH_ERRORS: Final = (
    DhError("phi_rad", "before", "rz"),
    DhError("alpha_rad", "link", "rx"),
    DhError("a_m", "link", "tx"),
    DhError("d_m", "before", "tz"),
)
"""In the order of a joint's coefficients."""

BETA_ERROR: Final = DhError("beta_rad", "link", "ry")
"""Hayati & Mirmirani's beta, where the next axis is nearly parallel (METHOD.md 9)."""

DH_FIELDS: Final = tuple(error.name for error in DH_ERRORS)
"""Names of the DH parameters, with units."""
