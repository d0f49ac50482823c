"""What the fit leaves at each pose of a proposal, with the table in force and with what is proposed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kincal.flight import Arm, Model, Observations
from kincal.link import read_log
from kincal_shared.errors import BadInput

from .changes import Flown, padded


@dataclass(frozen=True)
class PoseResidual:
    """Measured minus model of one observation, before (with the table in force; NaN if it is not at hand) and
    after. candidate: in the SPACE table; extra: taken on the way to that pose, not at it; tags: that were
    seen; frames: averaged; rejected: not in the fit."""

    pose: int
    candidate: int
    extra: bool
    tags: tuple[int, ...]
    frames: int
    before_pos_m: float
    before_rot_rad: float
    after_pos_m: float
    after_rot_rad: float
    rejected: bool


def residuals(
    log: Path,
    session: int,
    old: Sequence[float] | None,
    new: Sequence[float],
    flown: Flown,
    rejected: Sequence[int] = (),
    rejected_extra: Sequence[int] = (),
) -> tuple[PoseResidual, ...]:
    """Of all observations of a session that the log holds, in order; empty if it holds none that can be used.
    rejected, rejected_extra: as in Status."""
    from kincal.workbench.data.readers.lcm import read_log as read_measurements

    arm = Arm.of_table(flown.arm)
    found = read_log(log, ["KC_MEAS"]).sessions.get(session)
    if found is None or not found.measurements:
        return ()
    try:
        data = read_measurements(log, arm.n, session=session)
    except BadInput:
        return ()
    at = Observations.of(data, list(flown.arm.gravity_m_s2))
    model = Model(arm, flown.terms, at)
    after = _sizes(model.residuals(padded(new, flown.terms.n)))
    before = np.full((2, len(found.measurements)), np.nan)
    if old is not None:
        before = _sizes(model.residuals(padded(old, flown.terms.n)))
    return tuple(
        PoseResidual(
            m.pose,
            m.candidate,
            bool(m.taken_at),
            tuple(m.tag_id[: m.n_tags]),
            m.n_frames,
            float(before[0][i]),
            float(before[1][i]),
            float(after[0][i]),
            float(after[1][i]),
            m.observation in rejected_extra if m.taken_at else m.pose in rejected,
        )
        for i, m in enumerate(found.measurements)
    )


def _sizes(r: np.ndarray) -> np.ndarray:
    """(2, N): position [m] and rotation [rad]."""
    return np.array([np.linalg.norm(r[:, :3], axis=1), np.linalg.norm(r[:, 3:], axis=1)])
