"""The result of a run against the ground truth, by the flight model with the tables of the run."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal import space, tables
from kincal.flight import Arm, Model, Observations, Terms
from kincal.link import Session, estimated_sigma, names
from kincal.results import CoefResult, HeldOut, PoseLine, Scene
from kincal.rotations import Floats, Pose, angle_of_matrix

if TYPE_CHECKING:
    from kincal.link.messages import Meas, Progress, Proposal

# Names the simulator gives to what it injects -> coefficients of the terms table.
INJECTED = (
    (re.compile(r"J(\d+)\.compliance_rad_per_nm"), r"joint_compliance[\1]"),
    (re.compile(r"J(\d+)\.gain"), r"encoder_gain[\1]"),
)
_UNKNOWN = float("nan")


def coef_name(injected: str) -> str:
    """Coefficient that corrects an injected error, by the simulator's name of it."""
    for pattern, name in INJECTED:
        if pattern.fullmatch(injected):
            return pattern.sub(name, injected)
    return injected


@dataclass(frozen=True)
class GroundTruth:
    """What the simulator knows. errors: injected errors by coefficient. At n held-out postures: joints q_rad
    (n, joints), direction of approach (n, joints), true tool poses (n,) in the base frame."""

    errors: dict[str, float]
    q_rad: Floats
    direction: Floats
    poses: Pose

    @classmethod
    def of(cls, truth: dict[str, Any]) -> GroundTruth:
        """From the contents of truth.json."""
        held = truth["held_out"]
        q_rad = np.array([h["q_rad"] for h in held], float)
        return cls(
            {coef_name(name): float(value) for name, value in truth["errors"].items()},
            q_rad,
            np.array([h.get("dir", [0.0] * q_rad.shape[1]) for h in held], float),
            Pose.of_wxyz([h["p_m"] for h in held], [h["q_wxyz"] for h in held]),
        )


class Evaluator:
    """The flight model with the tables of a folder, and the ground truth once it is known.

    names: of all coefficients, in the order of the TERMS table. initial_coef: their values in the KIN
    table."""

    def __init__(self, tables_dir: Path, truth: GroundTruth | None = None) -> None:
        self.tables = space.TablesFolder(tables_dir)
        self.arm, self.terms = Arm.of_table(self.tables.arm), Terms.of_table(self.tables.terms)
        self.names = list(self.terms.names)
        self.space = self.tables.space
        self.initial_coef = np.array(list(self.tables.kin.value[0 : self.terms.n]))
        self.a1 = float(self.tables.config.a1)
        self.truth: GroundTruth | None = None
        self._held_out: Model | None = None
        if truth is not None:
            self.learn(truth)

    def learn(self, truth: GroundTruth) -> None:
        """Take the ground truth, which a run writes when it begins."""
        columns = {"q": truth.q_rad, "direction": truth.direction}
        at = Observations.of_columns(columns, list(self.tables.arm.gravity_m_s2))
        self.truth, self._held_out = truth, Model(self.arm, self.terms, at)

    @property
    def errors(self) -> dict[str, float]:
        """Injected errors by coefficient; empty without ground truth."""
        return self.truth.errors if self.truth else {}

    def held_out(self, coef: Floats) -> HeldOut:
        """RMS pose error over the held-out postures with coefficients (k,); nan without ground truth."""
        if self.truth is None or self._held_out is None:
            return HeldOut(0, _UNKNOWN, _UNKNOWN)
        model, true = self._held_out.poses(coef), self.truth.poses
        off_m = np.linalg.norm(model.p_m - true.p_m, axis=1)
        off_rad = angle_of_matrix(model.R.transpose(0, 2, 1) @ true.R)
        return HeldOut(len(off_m), _rms(off_m), _rms(off_rad))

    def pose_line(self, p: Progress, meas: Meas | None) -> PoseLine:
        """One pose of a calibration; meas: its measurement, if at hand."""
        held = self.held_out(np.array(p.coef[: self.terms.n]))
        line = PoseLine.of(p)
        return replace(
            line,
            tool_m=line.tool_m if meas is None else (meas.p_m[0], meas.p_m[1], meas.p_m[2]),
            held_pos_m=held.pos_m,
            held_rot_rad=held.rot_rad,
            local=p.candidate >= self.space.n_candidates,
        )

    def lines(self, session: Session) -> tuple[PoseLine, ...]:
        """All poses of a session, with f on the scale of the whole run."""
        measured = {m.pose: m for m in session.at_poses}
        most_m = max((p.res_pos_m for p in session.progress), default=1.0) or 1.0
        most_rad = max((p.res_rot_rad for p in session.progress), default=1.0) or 1.0
        lines = (self.pose_line(p, measured.get(p.pose)) for p in session.progress)
        a1 = self.a1
        return tuple(
            replace(x, f_run=-(a1 * x.res_pos_m / most_m + (1.0 - a1) * x.res_rot_rad / most_rad))
            for x in lines
        )

    def coefs(self, proposal: Proposal) -> tuple[CoefResult, ...]:
        """All coefficients of a proposal; what was not injected is truly zero."""
        absent, sigma = 0.0 if self.truth else _UNKNOWN, estimated_sigma(proposal)
        return tuple(
            CoefResult(
                name,
                tables.unit_of(name),
                self.errors.get(name, absent),
                proposal.value[i],
                sigma[i],
                names.coef_status_name(proposal.status[i]),
            )
            for i, name in enumerate(self.names[: proposal.n_coef])
        )

    def scene(self, session: Session, coef: Floats) -> Scene:
        """Arm with the DH errors among coefficients (k,), once at each pose of the session."""
        arm = Arm.of_table(self.tables.arm, dict(zip(self.names, coef, strict=False)))
        measured = {m.pose: m for m in session.at_poses}  # not those on the way to a pose
        at = [measured[p.pose].q_rad for p in session.progress if p.pose in measured]
        q_rad = np.array([q[: arm.n] for q in at]).reshape(-1, arm.n)
        return space.scene(self.space, self.tables.arm, self.tables.camera, q_rad, arm.points)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
