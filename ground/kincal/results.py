"""A run as plain values: what the console, the page and the pictures show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from kincal.link.messages import Progress

Value: TypeAlias = "float | str | bool"  # of a column of a campaign

PAIRS_NAMED = 3  # of shapes, per reason

_LEAST_CHANCE = 1e-12  # below it the tail of a distribution says nothing


@dataclass(frozen=True)
class PoseLine:
    """One pose of a calibration."""

    number: int  # from 1
    candidate: int
    servo_steps: int
    tool_m: tuple[float, float, float]  # measured, base frame
    res_pos_m: float  # against the kinematics before this pose was used
    res_rot_rad: float
    f: float
    gp_mean: float
    gp_sigma: float
    pred_pos_m: float  # predicted sigma over the search space, after
    pred_rot_rad: float
    held_pos_m: float = float("nan")  # held-out RMS with the estimate after this pose
    held_rot_rad: float = float("nan")
    f_run: float = float("nan")  # f with the largest residuals of the whole run as scale, for pictures
    local: bool = False  # a local initial pose, not a candidate

    @classmethod
    def of(cls, p: Progress) -> PoseLine:
        """From flight's message alone: not where the tool was, nor the error over held-out poses."""
        return cls(
            number=p.pose,
            candidate=p.candidate,
            servo_steps=p.servo_steps,
            tool_m=(float("nan"),) * 3,
            res_pos_m=p.res_pos_m,
            res_rot_rad=p.res_rot_rad,
            f=p.f,
            gp_mean=p.gp_mean,
            gp_sigma=p.gp_sigma,
            pred_pos_m=p.pred_pos_m,
            pred_rot_rad=p.pred_rot_rad,
        )

    @property
    def place(self) -> str:
        """Where it was measured, in few letters: candidate index, or that it was a local initial pose."""
        return "local" if self.local else str(self.candidate)


@dataclass(frozen=True)
class CoefResult:
    """One coefficient: true (nan if unknown), estimated and its 1-sigma."""

    name: str
    unit: str
    true: float
    estimate: float
    sigma: float
    status: str

    @property
    def error(self) -> float:
        """Estimate minus true value; nan if that is unknown."""
        return self.estimate - self.true

    @property
    def idle(self) -> bool:
        """Masked at zero and with nothing to find: not worth a line."""
        known = self.true == self.true and self.true != 0.0
        return self.status == "masked" and self.estimate == 0.0 and not known

    @property
    def inside_3_sigma(self) -> bool:
        """Whether the true value lies within 3 sigma of the estimate."""
        return abs(self.error) <= 3.0 * self.sigma


@dataclass(frozen=True)
class HeldOut:
    """RMS pose error over held-out joint vectors with known true poses."""

    n: int
    pos_m: float
    rot_rad: float


@dataclass(frozen=True)
class Criterion:
    """One acceptance criterion, found and wanted as text."""

    name: str
    got: str
    want: str
    ok: bool


@dataclass(frozen=True)
class Curve:
    """Progress of one run for the comparison picture."""

    label: str
    poses: tuple[PoseLine, ...]


@dataclass(frozen=True)
class Scene:
    """Geometry for the 3-D picture [m, base frame]."""

    candidates: np.ndarray  # (n, 3) tool positions of the search space
    skeletons: np.ndarray  # (poses, points, 3) joints of the arm at the chosen poses, corrected model
    mast: np.ndarray  # (2, 3) foot and head of the camera mast
    camera_m: np.ndarray  # (3,)
    frustum: np.ndarray  # (4, 3) image corners at some distance, camera aimed at the last pose


@dataclass(frozen=True)
class RunResult:
    """One whole run. crc: of the proposed correction; active_crc: of the KIN table in force at the end;
    after_is: what `after` is of: the correction in force ("after"), or one that is not ("proposed")."""

    title: str
    scenario: str
    mode: str
    seed: int
    acquisition: str
    n_goal: int
    poses: tuple[PoseLine, ...] = ()
    coefs: tuple[CoefResult, ...] = ()
    before: HeldOut | None = None
    after: HeldOut | None = None
    verdict: str = "no proposal"
    crc: int = 0
    active_crc: int = 0
    decision: str = "none"  # who accepted, or why not
    rank: int = 0
    n_free: int = 0
    p_fit: float = float("nan")
    p_no_change: float = float("nan")
    noise_scale: float = float("nan")
    criteria: tuple[Criterion, ...] = ()
    curves: tuple[Curve, ...] = ()
    scene: Scene | None = None
    events: tuple[str, ...] = ()  # warnings and errors
    mission_s: float = 0.0
    wall_s: float = 0.0
    ended: str = ""  # why the calibration stopped measuring
    after_is: str = "after"

    @property
    def ok(self) -> bool:
        """Whether there are criteria and all are met."""
        return bool(self.criteria) and all(criterion.ok for criterion in self.criteria)

    def as_dict(self) -> dict[str, Any]:
        """For summary.json: everything but the geometry."""
        out = asdict(self)
        out.pop("scene")
        out["ok"] = self.ok
        out["crc"], out["active_crc"] = f"{self.crc:08x}", f"{self.active_crc:08x}"
        return out


def angle_text(rad: float) -> str:
    """An angle with the unit that reads best."""
    if not np.isfinite(rad):
        return "-"
    return f"{rad:.3f} rad" if abs(rad) >= 0.1 else f"{rad * 1e3:.2f} mrad"


def chance_text(p: float) -> str:
    """A probability; nothing has none at all."""
    if not np.isfinite(p):
        return "-"
    return f"{p:.3g}" if p >= _LEAST_CHANCE else f"below {_LEAST_CHANCE:g}"


def length_text(m: float) -> str:
    """A length with the unit that reads best."""
    if not np.isfinite(m):
        return "-"
    return f"{m:.3f} m" if abs(m) >= 0.1 else f"{m * 1e3:.2f} mm"


def spans(values: Iterable[float]) -> str:
    """A number for each joint, written once if it is the same for all."""
    text = [f"{v:.2f}" for v in values]
    return text[0] if len(set(text)) == 1 else " ".join(text)


def summed(reasons: dict[str, int]) -> list[tuple[int, str]]:
    """Why samples were dropped, most frequent first; reasons that name two shapes taken together."""
    pairs: dict[str, Counter[str]] = {}
    for reason, n in reasons.items():
        kind, _, pair = reason.partition(": ")
        pairs.setdefault(kind, Counter())[pair] += n
    out = []
    for kind, count in pairs.items():
        named = [f"{pair} {n}" for pair, n in count.most_common(PAIRS_NAMED) if pair]
        more = ", ..." if len(count) > PAIRS_NAMED else ""
        out.append((count.total(), f"{kind} ({', '.join(named)}{more})" if named else kind))
    return sorted(out, key=lambda x: (-x[0], x[1]))


@dataclass(frozen=True)
class Flown:
    """A case that was flown. dispersed: values of the built world by key; outcome: columns of
    kincal_shared.schema.campaign.OUTCOME; digest: SHA-256 of all commands, measurements, estimates,
    events and proposals of flight; cpu_s: processor time [s]."""

    dispersed: dict[str, Value]
    outcome: dict[str, Value | None]
    digest: str
    cpu_s: float
