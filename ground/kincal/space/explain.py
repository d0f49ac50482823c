"""Why a candidate is in a search space, and why there is none in some region."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kincal.results import spans
from kincal_shared.errors import BadInput

from .arrays import Floats
from .checks import Checks
from .clearance import errors_text
from .error_sampling import Stream
from .samples import BLOCK, Box, Sample, examine, verify
from .table import SpaceTable

_ROUNDING_RAD = 1e-6


@dataclass(frozen=True)
class CheckLine:
    """One check of one candidate, found and wanted as text. Lines that do not count are information only."""

    check: str
    got: str
    want: str
    ok: bool
    counts: bool = True


@dataclass(frozen=True)
class Region:
    """What became of tool poses in a small box: how many were examined, how many could be candidates, and why
    the others could not (reason -> count, most frequent first)."""

    examined: int
    good: int
    reasons: dict[str, int]


def explain_region(checks: Checks, centre_m: Floats, half_m: float, samples: int) -> Region:
    """Examines and verifies tool poses within half_m of a place (base frame): why is there no candidate?"""
    lo, hi = np.asarray(centre_m) - half_m, np.asarray(centre_m) + half_m
    box = Box(tuple(lo.tolist()), tuple(hi.tolist()))
    counts = [min(BLOCK, samples - first) for first in range(0, samples, BLOCK)]
    examined = (s for block, n in enumerate(counts) for s in examine(checks, block, n, box))
    reasons = Counter(filter(None, (_rejection(checks, s) for s in examined)))
    return Region(samples, samples - reasons.total(), dict(reasons.most_common()))


def _rejection(checks: Checks, sample: Sample) -> str:
    """Why a sample could not be a candidate, or ""."""
    if sample.rejection or sample.q_rad is None:
        return sample.rejection
    return verify(checks, sample.q_rad).rejection


def explain_candidate(checks: Checks, table: SpaceTable, index: int) -> list[CheckLine]:
    """All checks of a candidate with their figures. BadInput if the table has no such candidate."""
    _require_candidate(table, index)
    return [*_Explanation(checks, table, index).lines()]


def _require_candidate(table: SpaceTable, index: int) -> None:
    last = table.n_candidates - 1
    if not 0 <= index < len(table.q_rad):
        raise BadInput(f"candidate {index}: the table has 0..{last}")
    if index > last:
        raise BadInput(
            f"candidate {index} is a local initial pose, not one to choose",
            "",
            "see joints.local_initial_rad in the description; `kincal space check` verifies them again",
        )


class _Explanation:
    """The checks of one candidate, one method a group."""

    def __init__(self, checks: Checks, table: SpaceTable, index: int) -> None:
        self.checks, self.desc = checks, checks.desc
        self.bound_rad, self.hub = table.servo_bound_rad, int(table.hub[index])
        self.q, self.hub_q = table.q_rad[index], table.hub_q_rad[self.hub]
        poses = checks.kinematics.poses(self.q)
        self.pose, self.views = poses[0], checks.view.aim(poses)

    def lines(self) -> Iterator[CheckLine]:
        """All checks, in the order in which the search makes them."""
        yield self._joint_limits()
        yield from self._view()
        yield from self._tags()
        yield from self._clearance()
        yield from self._servo()
        yield self._detections()

    def _joint_limits(self) -> CheckLine:
        kin, margin = self.checks.kinematics, np.array(self.desc.joints.margin_rad)
        room = np.minimum(self.q - kin.q_min, kin.q_max - self.q) - margin
        j = int(np.argmin(room))
        text = f"J{j + 1} {room[j]:.2f} rad inside its margin"
        return CheckLine("joint limits", text, ">= 0", bool(room[j] >= -_ROUNDING_RAD))

    def _view(self) -> Iterator[CheckLine]:
        t, v, views, p_m = self.desc.tool, self.desc.view, self.views, self.pose.p_m
        inside = bool(np.all(p_m >= t.box_min_m) and np.all(p_m <= t.box_max_m))
        yield CheckLine("tool in the box", " ".join(f"{x:.3f}" for x in p_m) + " m", "inside", inside)
        far_m = float(np.linalg.norm(views.tool.p_m[0]))
        near_enough = v.range_min_m <= far_m <= v.range_max_m
        wanted = f"{v.range_min_m}..{v.range_max_m} m"
        yield CheckLine("camera distance", f"{far_m:.2f} m", wanted, near_enough)
        angles = f"pan {views.pan_rad[0]:.2f}, tilt {views.tilt_rad[0]:.2f} rad"
        yield CheckLine("pan-tilt unit", angles, "inside its margins", bool(views.inside[0]))

    def _tags(self) -> Iterator[CheckLine]:
        v, view, views = self.desc.view, self.checks.view, self.views
        edge_px, incid = view.tag_edges_px(views)[0], np.degrees(view.incidence_rad(views)[0])
        good = self.checks.visible_tags(self.q)
        every = (1 << view.n_tags) - 1
        in_sight = self.checks.clearance.thick.visible_tags(self.q, views.camera.p_m[0], every)
        wanted = f"<= {np.degrees(v.incid_max_rad):.0f} deg, >= {v.tag_min_px:.0f} px"
        for k in range(view.n_tags):
            sight = "free line of sight" if in_sight >> k & 1 else "hidden by the arm"
            text = f"{incid[k]:.0f} deg, edge {edge_px[k]:.0f} px, {sight}"
            yield CheckLine(f"tag {k}", text, wanted, bool(good >> k & 1), counts=False)
        n = good.bit_count()
        yield CheckLine("tags in view", str(n), f">= {v.tags_min}", n >= v.tags_min)

    def _clearance(self) -> Iterator[CheckLine]:
        clear, clearance = self.desc.clear, self.checks.clearance
        pair = clearance.nominal.contact(self.q)
        wanted = f">= {clear.nominal_m * 1e3:.0f} mm"
        yield CheckLine("nominal clearance", pair or "nothing near", wanted, not pair)
        found, arms = clearance.contact_with_errors(self.q), len(clearance.errors)
        text = f"{found.pair} with {errors_text(found.errors)}" if found else f"{arms} arms"
        wanted = f">= {clear.perturbed_m * 1e3:.0f} mm"
        yield CheckLine("clearance with errors", text, wanted, not found)
        pair = clearance.segment_contact(self.hub_q, self.q)
        name = f"segment from hub {self.hub}"
        yield CheckLine(name, pair or "clear", "clear with all errors", not pair)

    def _servo(self) -> Iterator[CheckLine]:
        checks, samples = self.checks, self.desc.clear.servo_bound_samples
        if self.desc.error_bounds.reach:
            problem = checks.servo_reach_problem(self.q, self.pose, self.bound_rad)
            text = problem or "reaches the pose"
            yield CheckLine("servo under named errors", text, "inside its bound", not problem)
        rng = checks.stream(Stream.SERVO_BOUND, self.q)
        pair = checks.servo_bound_contact(self.q, self.bound_rad, samples, rng)
        name, wanted = f"servo bound +-{spans(self.bound_rad)} rad", f"{samples} postures clear"
        yield CheckLine(name, pair or "clear", wanted, not pair)

    def _detections(self) -> CheckLine:
        shown, arms = sum(self.checks.detected_with_errors(self.q)), len(self.checks.clearance.errors)
        text = f"{shown} of {arms} arms with errors"
        return CheckLine("still shows a tag", text, "for information", True, counts=False)
