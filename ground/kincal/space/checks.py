"""What a pose of a search space has to pass: reach, view, line of sight, and distance to everything, also
when the arm is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kincal.flight import Arm, library
from kincal.rotations import Pose
from kincal_shared.schema.space import Description

from .arrays import Floats
from .clearance import Clearance, errors_text
from .collision import CollisionModel
from .error_sampling import Stream
from .fit import require_fit, servo_bound_rad
from .inputs import TablesFolder
from .kinematics import Kinematics, ServoReach
from .reasons import Reason
from .table import Row, stop_joints
from .view import ViewChecks

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera

LOCAL_SHOWN = 0.9  # part of the arms with errors that show a tag at a local initial pose
RESERVE_SHOWN = 0.5  # at a reserve pose: it is there for arms that the others do not show
FAULTY_INCID_MAX_RAD = 1.2  # a tag still decodes, though its pose is poor


class Checks:
    """All checks of one description against one ARM and one CAMERA table. BadInput if they do not fit.

    `kinematics`, `view` and `clearance` answer single questions; the methods here combine them. Postures are
    joints (joints,) [rad or m]; tags are bits. A problem is a text, "" if there is none."""

    def __init__(self, desc: Description, arm: KcArm, camera: KcCamera) -> None:
        require_fit(desc, arm, camera)
        self.desc, self.arm, self.camera = desc, arm, camera
        self.kinematics = Kinematics(desc, arm)
        self.view = ViewChecks(desc, camera)
        self.clearance = Clearance(desc, arm, camera)
        self.hubs = [np.array(h) for h in desc.joints.hubs_rad]
        self.servo_bound_rad = servo_bound_rad(desc, self.kinematics.n)

    @classmethod
    def load(cls, desc: Description, tables: TablesFolder) -> Checks:
        """With the ARM and CAMERA tables of a folder."""
        return cls(desc, tables.arm, tables.camera)

    # ---- tags in sight

    def visible_tags(self, q_rad: Floats) -> int:
        """Tags that joints q show: in view and not hidden."""
        poses = self.kinematics.poses(q_rad)
        views = self.view.aim(poses)
        _, shown = self.view.problems(poses.p_m, views)
        return self.clearance.thick.visible_tags(q_rad, views.camera.p_m[0], int(shown[0]))

    def _detectable(self, q_rad: Floats, arms: Sequence[CollisionModel]) -> list[int]:
        """Tags that each arm shows at joints q to a detector that takes what it gets, the camera aimed where
        the tool of the nominal arm would be."""
        eye = self.view.aim(self.kinematics.poses(q_rad)).camera[0]
        p_m, R = zip(*(arm.tool_pose(q_rad) for arm in arms), strict=True)
        seen = self.view.camera.visible(eye.inverse @ Pose(np.array(p_m), np.array(R)), FAULTY_INCID_MAX_RAD)
        pairs = zip(arms, seen.tolist(), strict=True)
        return [arm.visible_tags(q_rad, eye.p_m, tags) for arm, tags in pairs]

    def detected_with_errors(self, q_rad: Floats) -> list[bool]:
        """Which arms with errors show a tag at joints q."""
        return [bool(tags) for tags in self._detectable(q_rad, self.clearance.wrong)]

    def detected_nominal(self, q_rad: Floats) -> int:
        """Tags that the nominal arm shows at joints q, however obliquely."""
        return self._detectable(q_rad, [self.clearance.thick])[0]

    # ---- postures

    def problems(self, q_rad: Floats) -> list[str]:
        """Why each row of joints (n, joints) is no posture to measure at, nominal arm."""
        q_rad = np.asarray(q_rad, float).reshape(-1, self.kinematics.n)
        poses = self.kinematics.poses(q_rad)
        views = self.view.aim(poses)
        out, shown = self.view.problems(poses.p_m, views)
        allowed = self.kinematics.inside_limits(q_rad)
        for i, q in enumerate(q_rad):
            if not allowed[i]:
                out[i] = str(Reason.JOINT_LIMITS)
            elif not out[i]:
                out[i] = self._hindrance(q, int(shown[i]), views.camera.p_m[i])
                out[i] = out[i] or self.servo_reach_problem(q, poses[i], self.servo_bound_rad)
        return out

    def problem(self, q_rad: Floats) -> str:
        """The same for one posture."""
        return self.problems(q_rad)[0]

    def _hindrance(self, q_rad: Floats, tags: int, eye_m: Floats) -> str:
        """What the nominal arm touches, or that it hides too many of the tags."""
        if pair := self.clearance.nominal.contact(q_rad):
            return Reason.CONTACT_NOMINAL.with_detail(pair)
        shown = self.clearance.thick.visible_tags(q_rad, eye_m, tags)
        return str(Reason.HIDDEN_TAGS) if shown.bit_count() < self.desc.view.tags_min else ""

    def servo_reach_problem(self, q_rad: Floats, goal: Pose, bound_rad: Floats) -> str:
        """Which named case of errors keeps the servo from reaching a tool pose inside its bound (joints,)."""
        case = self.kinematics.case_out_of_reach(q_rad, goal, bound_rad)
        return "" if case is None else Reason.SERVO_REACH.with_detail(f"error case {case + 1}")

    def error_problem(self, q_rad: Floats) -> str:
        """What an arm with errors touches at joints q."""
        found = self.clearance.contact_with_errors(q_rad)
        return Reason.CONTACT_ERRORS.with_detail(found.pair) if found else ""

    def stream(self, purpose: Stream, q_rad: Floats) -> np.random.Generator:
        """Random numbers that belong to joints q, so that whoever asks again gets the same."""
        return np.random.default_rng([self.desc.seed, purpose, *q_rad.astype(np.float32).view(np.uint32)])

    def stop_problem(self, q_rad: Floats) -> str:
        """Why joints q on a verified segment are no stop: the view is that of a candidate, wherever the tool
        is, and most of the arms with errors show a tag."""
        poses = self.kinematics.poses(q_rad)
        (problem,) = _tags_problems(self.view, self.clearance.thick, q_rad[None], poses)
        if problem:
            return problem
        seen, arms = sum(self.detected_with_errors(q_rad)), len(self.clearance.errors)
        few = seen < self.desc.stops.shown_min * arms
        return f"a tag shows with only {seen} of {arms} arms with errors" if few else ""

    def servo_bound_contact(
        self, q_rad: Floats, bound_rad: Floats, samples: int, rng: np.random.Generator
    ) -> str:
        """First pair in contact at sampled postures inside a bound (joints,) around joints q, or ""."""
        return self.clearance.box_contact(*self.kinematics.servo_limits(q_rad, bound_rad), samples, rng)

    def servo_bound_problem(self, q_rad: Floats) -> str:
        """What touches inside the servo bound around a seed."""
        samples, rng = self.desc.clear.servo_bound_samples, self.stream(Stream.SERVO_BOUND, q_rad)
        pair = self.servo_bound_contact(q_rad, self.servo_bound_rad, samples, rng)
        return Reason.SERVO_BOUND.with_detail(pair) if pair else ""

    # ---- hubs and local initial poses

    def hub_problem(self, q_rad: Floats) -> str:
        """Why joints q are no hub."""
        kin = self.kinematics
        over = np.maximum(kin.q_min - q_rad, q_rad - kin.q_max)
        if np.any(over > 0.0):
            j = int(np.argmax(over))
            return f"outside the joint limits: J{j + 1} {q_rad[j]:.2f} rad"
        if pair := self.clearance.nominal.contact(q_rad):
            return Reason.CONTACT_NOMINAL.with_detail(pair)
        if found := self.clearance.contact_with_errors(q_rad):
            return Reason.CONTACT_ERRORS.with_detail(f"{found.pair}; {errors_text(found.errors)}")
        return self._hub_bound_problem(q_rad)

    def _hub_bound_problem(self, q_rad: Floats) -> str:
        hub_bound = library("flight").decimal("KC_HUB_BOUND")  # what flight lets joints be off a hub
        bound = np.minimum(self.servo_bound_rad, hub_bound)
        samples, rng = self.desc.clear.servo_bound_samples, self.stream(Stream.SERVO_BOUND, q_rad)
        pair = self.servo_bound_contact(q_rad, bound, samples, rng)
        return f"not clear within {hub_bound:g} rad of every joint: {pair}" if pair else ""

    def local_problem(self, q_rad: Floats, hub_rad: Floats, reserve: bool = False) -> str:
        """Why joints q are no local initial pose: it has to be as safe as a hub, the segment from its hub
        too, and a tag shows under nearly all errors (a reserve pose: under half of them)."""
        if problem := self.hub_problem(q_rad):
            return problem
        if pair := self.clearance.segment_contact(hub_rad, q_rad):
            return f"not clear on the segment from its hub: {pair}"
        shown, arms = sum(self.detected_with_errors(q_rad)), len(self.clearance.errors)
        wanted = RESERVE_SHOWN if reserve else LOCAL_SHOWN
        few = shown < wanted * arms or not self.detected_nominal(q_rad)
        return f"a tag shows with only {shown} of {arms} arms with errors" if few else ""

    def nearest_hub(self, q_rad: Floats) -> int | None:
        """Nearest hub with a clear segment to joints q; ties by index. None if there is none."""
        order = sorted(range(len(self.hubs)), key=lambda h: (float(np.max(np.abs(q_rad - self.hubs[h]))), h))
        clear = (h for h in order if not self.clearance.segment_contact(self.hubs[h], q_rad))
        return next(clear, None)


def _tags_problems(view: ViewChecks, thick: CollisionModel, q_rad: Floats, poses: Pose) -> list[str]:
    """Why too few tags show at each row of joints (n, joints), the tool at (n,) poses and the camera aimed at
    it; "" if enough do."""
    views = view.aim(poses)
    out, shown = view.problems(poses.p_m, views, box=False)
    for i, q in enumerate(q_rad):
        tags = thick.visible_tags(q, views.camera.p_m[i], int(shown[i]))
        if not out[i] and tags.bit_count() < view.desc.view.tags_min:
            out[i] = str(Reason.HIDDEN_TAGS)
    return out


class CorrectedArm:
    """The arm with the DH errors (by name) that a kinematics table holds, and flight's view of it: the camera
    is aimed at where the tool is. horizon_m: distances below it are told apart."""

    def __init__(
        self,
        desc: Description,
        arm: KcArm,
        camera: KcCamera,
        errors: Mapping[str, float],
        horizon_m: float,
    ) -> None:
        self._arm, self._view = Arm.of_table(arm, errors), ViewChecks(desc, camera)
        self._servo = ServoReach(arm, errors)
        self._solid = CollisionModel(desc, arm, camera, errors, horizon_m)
        self._thick = CollisionModel(desc, arm, camera, errors, 0.0, desc.sight.margin_m)

    def nearest(self, q_rad: Floats) -> tuple[float, str]:
        """Distance [m] and pair of the shapes nearest to each other, as `CollisionModel.nearest`."""
        return self._solid.nearest(q_rad)

    def servo(self, q_rad: Floats, goal: Pose, bound_rad: Floats) -> tuple[Floats, str]:
        """Joints that bring the tool to a goal from a seed, inside limits and servo bound (joints,); or why
        there are none."""
        if (q := self._servo.joints(q_rad, goal, q_rad - bound_rad, q_rad + bound_rad)) is not None:
            return q, ""
        wide = self._servo.joints(q_rad, goal, self._arm.q_min, self._arm.q_max)
        if wide is None:
            return q_rad, "not reached inside the joint limits"
        over = np.abs(wide - q_rad) - bound_rad
        j = int(np.argmax(over))
        return q_rad, f"J{j + 1} {over[j]:.3f} rad beyond its servo bound"

    def stops(self, row: Row) -> Iterator[tuple[int, Floats]]:
        """Places and joints of the stops on the segment to a candidate."""
        for part in row.stops:
            yield part, stop_joints(row.hub_q_rad, row.q_rad, part)

    def view_problems(self, q_rad: Floats) -> list[str]:
        """Why too few tags show at each row of joints (n, joints), by the view of candidates; "" if enough
        do."""
        return _tags_problems(self._view, self._thick, q_rad, self._arm.fk(q_rad))

    def local_view_problem(self, q_rad: Floats) -> str:
        """The same by the view of local initial poses: one tag, however obliquely."""
        poses = self._arm.fk(q_rad[None])
        eye = self._view.aim(poses).camera[0]
        seen = self._view.camera.visible(eye.inverse @ poses, FAULTY_INCID_MAX_RAD)
        tags = self._thick.visible_tags(q_rad, eye.p_m, int(seen[0]))
        return "" if tags else "no tag shows"
