"""What `kincal arm` prints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kincal.arms import ImportedArm, ShippedArm


_FIXED = (
    "note: base and tool frame are those of the URDF; a tracker or motion capture measures another point in "
    "a frame of its own: --estimate-frames"
)


def arms(shipped: Sequence[ShippedArm]) -> str:
    """One line an arm: name, joints, convention, title; its source below."""
    width = max(len(one.name) for one in shipped)
    lines = []
    for one in shipped:
        masses = ", with masses" if one.masses else ""
        lines.append(f"{one.name:<{width}}  {one.joints} joints, {one.convention} DH{masses}: {one.title}")
        lines.append(f"{'':<{width}}  source: {one.source}")
    return "\n".join(lines)


def imported(made: ImportedArm, path: Path, estimate_frames: bool) -> str:
    """What was made of a URDF, and how near the table is to it."""
    masses = "with" if made.has_masses else "without"
    lines = [
        f"{path}: {made.robot}, {len(made.joints)} joints, {masses} masses: {', '.join(made.joints)}",
        f"check: largest difference to the URDF at 100 random joint vectors "
        f"{made.difference.position_m:.1e} m, {made.difference.rotation_rad:.1e} rad",
        *(f"note: {note}" for note in made.notes),
        *([] if estimate_frames else [_FIXED]),
    ]
    return "\n".join(lines)
