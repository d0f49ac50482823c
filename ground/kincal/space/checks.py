"""What a candidate has to pass: reach, view, sight, distance to everything, also when the arm is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kincal import core
from kincal.errors import KincalError
from kincal.geometry import ArmChain, Camera, quat_to_R, with_dh_errors

from . import drawn
from .bodies import Bodies
from .description import Description

# Bits of kc_cand_t.why: what was checked and found good.
WHY = {
    1: "joints inside their limits with margin",
    2: "tool inside the position box",
    4: "distance to the camera inside its range, tags large enough in the image",
    8: "enough tags inside the image with margin, head aimed at the tool",
    16: "incidence of those tags below the limit",
    32: "head angles inside their limits with margin",
    64: "arm as drawn clear of itself, deck, ground, mast and instruments, with safety distance",
    128: "straight segment from the hub clear, also with all drawn errors",
    256: "line of sight to those tags clear of the arm (rays)",
    512: "clear at the seed with all drawn errors",
    1024: "servo box around the seed clear under sampled postures and errors",
    2048: "the servo can reach the pose under every named case of errors, if the description asks for it",
}
WHY_ALL = sum(WHY)
WHY_FIRST, WHY_SPARE = 1 << 15, 1 << 14  # first looks, KC_CAND_FIRST and _SPARE of kc_path.h
FIRST_SHOWN = 0.9  # of the arms with errors show a tag at a first look
SPARE_SHOWN = 0.5  # at a spare one: it is there for those that the others do not show
HUB_LEASH = 0.05  # what flight lets joints be off a hub, KC_HUB_LEASH of kc_path.h
FAULTY_INCID_MAX_RAD = 1.2  # a tag still decodes, though its pose is poor
# Far more starts than 20 steps could mend are cheaper tried anew from another start.
# Under named errors: as close as the servo is asked to come, and as far from the limits (CONFIG).
_SERVO = {"iter_max": 60, "tol_pos_m": 2e-3, "tol_rot_rad": 5e-3, "margin": 0.0, "step_max": 0.5}
_SERVO_MARGIN = 0.02
_IK = {"iter_max": 20, "tol_pos_m": 1e-6, "tol_rot_rad": 1e-6, "margin": 0.0, "step_max": 1.0}


@dataclass(frozen=True)
class Looks:
    """The head aimed at tool poses: its angles, whether they are allowed, where the camera is, and the tool
    in the camera frame. One row per pose."""

    pan: np.ndarray
    tilt: np.ndarray
    inside: np.ndarray
    eye: np.ndarray
    p_cam: np.ndarray
    R_cam: np.ndarray


def _longest(arm: Any, n: int) -> float | None:
    """Links before the last joint stretched out; None if one of them slides."""
    joints = [arm.joint[j] for j in range(n)]
    if any(j.type != core.lib.KC_REVOLUTE for j in joints):
        return None
    return sum(float(np.hypot(j.a_m, j.d_m)) for j in joints[:-1])


class Checks:
    """Checks of one description against one arm and one camera."""

    def __init__(self, desc: Description, arm: Any, camera: Any) -> None:
        self.desc, self.arm = desc, arm
        self.chain, self.camera = ArmChain(arm), Camera(camera)
        n = self.chain.n
        leash = desc.joints.servo_leash_rad
        leash = leash if isinstance(leash, list) else [leash] * n
        lists = {
            "joints.margin_rad": desc.joints.margin_rad,
            "joints.servo_leash_rad": leash,
            **{f"joints.hubs_rad.{i}": h for i, h in enumerate(desc.joints.hubs_rad)},
            **{f"joints.first_rad.{i}": f for i, f in enumerate(desc.joints.first_rad)},
            **{f"survive.{f}": getattr(desc.survive, f) for f in ("phi_rad", "alpha_rad", "a_m", "d_m")},
        }
        for where, values in lists.items():
            if len(values) != n:
                raise KincalError(
                    f"{len(values)} values for an arm of {n} joints", where, "give one value per joint"
                )
        margin = np.array(desc.joints.margin_rad)
        self.lo, self.hi = self.chain.q_min + margin, self.chain.q_max - margin
        if np.any(self.lo >= self.hi):
            j = int(np.argmax(self.lo - self.hi))
            raise KincalError(
                f"a margin of {margin[j]:g} rad leaves J{j + 1} no room: its limits are "
                f"{self.chain.q_min[j]:g} and {self.chain.q_max[j]:g} rad",
                f"joints.margin_rad[{j}]",
                "make the margin smaller",
            )
        self._fits(desc, camera)
        self.hubs = [np.array(h) for h in desc.joints.hubs_rad]
        self.leash = np.array(leash).astype(np.float32).astype(float)  # as the table keeps it
        # A margin at the image rim is a camera with a smaller image.
        self._tight = core.ffi.new("kc_camera_t *", camera[0])
        m = desc.view.image_margin_px
        self._tight.width_px = int(camera.width_px - 2 * m)
        self._tight.height_px = int(camera.height_px - 2 * m)
        self._tight.cx_px = camera.cx_px - m
        self._tight.cy_px = camera.cy_px - m
        self.sizes = np.array([float(t.size_m) for t in camera.tag[0 : int(camera.n_tags)]])
        self.nominal = Bodies(desc, arm, camera, None, desc.clear.nominal_m)
        self.thick = Bodies(desc, arm, camera, None, 0.0, desc.sight.margin_m)
        self.errors = drawn.draw(desc, n)
        self.wrong = [Bodies(desc, arm, camera, e, desc.clear.drawn_m) for e in self.errors]
        self._eval = core.ffi.new("kc_eval_t *")
        self._opt = core.ffi.new("kc_ik_opt_t *", _IK)
        self._narrow = core.ffi.new("kc_arm_t *", arm[0])  # limits less margins: solved inside them at once
        for j in range(n):
            self._narrow.joint[j].q_min, self._narrow.joint[j].q_max = self.lo[j], self.hi[j]
        self._reach_m = _longest(arm, n)
        self._cases = [with_dh_errors(arm, c) for c in desc.survive.case] if desc.survive.reach else []
        self._servo_opt = core.ffi.new("kc_ik_opt_t *", _SERVO)

    def _fits(self, desc: Description, camera: Any) -> None:
        """What a description asks for has to be there in the arm and camera tables."""
        v, n = desc.view, self.chain.n
        for s in desc.shape:
            if s.joint > n:
                raise KincalError(f"{s.name!r} is on joint {s.joint} of an arm of {n}", "shape")
        for case in desc.survive.case:
            for name in case:
                if int(name[1]) > n:
                    raise KincalError(f"{name!r}: the arm has {n} joints", "survive.case")
        room = 0.5 * min(camera.width_px, camera.height_px)
        if v.image_margin_px >= room:
            raise KincalError(
                f"{v.image_margin_px:g} px leave nothing of {camera.width_px} x {camera.height_px} px",
                "view.image_margin_px",
                f"stay below {room:g}",
            )
        head = 0.5 * min(camera.pan_max_rad - camera.pan_min_rad, camera.tilt_max_rad - camera.tilt_min_rad)
        if v.head_margin_rad >= head:
            raise KincalError(
                f"{v.head_margin_rad:g} rad leave the head no room",
                "view.head_margin_rad",
                f"stay below {head:g}",
            )
        if v.tags_min > camera.n_tags:
            raise KincalError(
                f"{v.tags_min} tags wanted, the camera table has {camera.n_tags}", "view.tags_min"
            )

    # ---- seen

    def looks(self, p: np.ndarray, R: np.ndarray) -> Looks:
        c, n = self.camera.camera, len(p)
        p = np.ascontiguousarray(p, float)
        pan, tilt, reach = np.empty(n), np.empty(n), np.empty(n, bool)
        poses, pose = core.pose_rows(n)
        at, x, y = core.ptr(p), core.ptr(pan), core.ptr(tilt)
        for i in range(n):
            reach[i] = core.lib.kc_camera_aim(c, at + 3 * i, x + i, y + i) == 0
            core.lib.kc_camera_pose(c, pan[i], tilt[i], pose + i)
        m = self.desc.view.head_margin_rad
        inside = (
            reach
            & (pan >= c.pan_min_rad + m)
            & (pan <= c.pan_max_rad - m)
            & (tilt >= c.tilt_min_rad + m)
            & (tilt <= c.tilt_max_rad - m)
        )
        eye, back = poses[:, :3], poses[:, 3:].reshape(n, 3, 3).transpose(0, 2, 1)
        return Looks(pan, tilt, inside, eye, np.einsum("nij,nj->ni", back, p - eye), back @ R)

    def incidence(self, look: Looks) -> np.ndarray:
        """Angle between line of sight and normal of each tag [rad], (n, tags)."""
        out = []
        for xyz, R_tag in self.camera.tags:
            centre = look.p_cam + look.R_cam @ xyz
            normal_in = look.R_cam @ R_tag[:, 2]  # z into the tag, away from the viewer
            cos = np.sum(centre * normal_in, axis=1) / np.linalg.norm(centre, axis=1)
            out.append(np.arccos(np.clip(cos, -1.0, 1.0)))
        return np.array(out).T

    def edge_px(self, look: Looks) -> np.ndarray:
        """Shortest edge of each tag's black square in the image, (n, tags)."""
        c, out = self.camera.camera, []
        for (xyz, R_tag), size in zip(self.camera.tags, self.sizes, strict=True):
            h = 0.5 * size
            corner = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])
            at = look.p_cam[:, None] + (xyz + corner @ R_tag.T) @ look.R_cam.transpose(0, 2, 1)
            uv = at[..., :2] / np.maximum(at[..., 2:], 1e-6) * [c.fx_px, c.fy_px]
            edges = np.linalg.norm(uv - uv[:, [3, 0, 1, 2]], axis=2)
            out.append(np.min(edges, axis=1))
        return np.array(out).T

    def view_problems(self, p: np.ndarray, look: Looks) -> tuple[list[str], np.ndarray]:
        """First check of the view that each tool pose fails ("": none), and the tags that show if nothing
        hides them (bits; 0 where a check fails)."""
        t, v, n = self.desc.tool, self.desc.view, len(p)
        far = np.linalg.norm(look.p_cam, axis=1)
        facing = np.sum(self.incidence(look) <= v.incid_max_rad, axis=1)
        rows, pose = core.pose_rows(n)
        rows[:, :3], rows[:, 3:] = look.p_cam, look.R_cam.reshape(n, 9)
        in_image = np.array(
            [core.lib.kc_camera_visible(self._tight, pose + i, v.incid_max_rad) for i in range(n)], int
        )
        bits = 1 << np.arange(len(self.sizes))
        seen = in_image & (self.edge_px(look) >= v.tag_min_px) @ bits
        failed = {
            "outside the position box": np.any((p < t.box_min_m) | (p > t.box_max_m), axis=1),
            "too near to or far from the camera": (far < v.range_min_m) | (far > v.range_max_m),
            "head limits": ~look.inside,
            "tags too oblique or facing away": facing < v.tags_min,
            "too few tags in the image": np.bitwise_count(in_image) < v.tags_min,
            "tags too small in the image": np.bitwise_count(seen) < v.tags_min,
        }
        reasons = list(failed)
        first = np.argmax([*failed.values(), np.ones(n, bool)], axis=0)
        bad = first < len(reasons)
        return [reasons[k] if k < len(reasons) else "" for k in first], np.where(bad, 0, seen)

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool poses of the arm as drawn at joints q, one row each."""
        q = np.ascontiguousarray(q, float).reshape(-1, self.chain.n)
        rows, pose = core.pose_rows(len(q))
        at = core.ptr(q)
        for i in range(len(q)):
            core.lib.kc_arm_fk(self.arm, at + self.chain.n * i, pose + i)
        return rows[:, :3].copy(), rows[:, 3:].reshape(-1, 3, 3).copy()

    def tags(self, q: np.ndarray) -> int:
        """Tags that joints q show: in view and not hidden."""
        p, R = self.poses(q)
        look = self.looks(p, R)
        _, seen = self.view_problems(p, look)
        return self.thick.seen(q, look.eye[0], int(seen[0]))

    def _shown(self, q: np.ndarray, arms: Sequence[Bodies]) -> list[int]:
        """Tags that each arm shows at joints q to a detector that takes what it gets, the head aimed where
        the nominal arm's tool would be."""
        p, R = self.poses(q)
        look = self.looks(p, R)
        eye = look.eye[0]
        _, R_cam = self.camera.pose(look.pan[0], look.tilt[0])
        out = []
        for arm in arms:
            at, R_tool = arm.tool(q)
            mask = self.camera.visible(R_cam.T @ (at - eye), R_cam.T @ R_tool, FAULTY_INCID_MAX_RAD)
            out.append(arm.seen(q, eye, mask) if mask else 0)
        return out

    def shown_by_wrong(self, q: np.ndarray) -> list[bool]:
        """Which arms with errors show a tag at joints q."""
        return [bool(x) for x in self._shown(q, self.wrong)]

    def first_tags(self, q: np.ndarray) -> int:
        """Tags that a first look shows, the arm being as drawn."""
        return self._shown(q, [self.thick])[0]

    # ---- clear

    def beyond(self, p: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Tool poses that no joints of the nominal arm can reach: the axis of the last joint would be farther
        from the base than all links before it, stretched out."""
        if self._reach_m is None:
            return np.zeros(len(p), bool)
        a = self.arm
        last = a.joint[self.chain.n - 1]
        R_n = R @ quat_to_R(list(a.tool_quat_wxyz)).T
        at = p - R_n @ np.array(list(a.tool_xyz_m))
        axis = R_n @ np.array([0.0, np.sin(last.alpha_rad), np.cos(last.alpha_rad)])
        at = at - last.a_m * R_n[:, :, 0] - last.d_m * axis
        return np.linalg.norm(at - self.chain.base_m, axis=1) > self._reach_m + 1e-9

    def reach(self, p: np.ndarray, R: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joints inside the margins that bring the nominal tool to each pose, and whether any were found."""
        rows, goal = core.pose_rows(len(p))
        rows[:, :3], rows[:, 3:] = p, R.reshape(-1, 9)
        q = np.ascontiguousarray(start, float)
        at, null = core.ptr(q), core.ffi.NULL
        good = np.array(
            [
                core.lib.kc_ik_solve(
                    self._narrow, null, null, goal + i, self._opt, at + self.chain.n * i, self._eval
                )
                == 0
                for i in range(len(p))
            ],
            bool,
        )
        # the table keeps single precision; so does everything that is proven
        q = q.astype(np.float32).astype(float)
        return q, good & np.all((q >= self.lo) & (q <= self.hi), axis=1)

    def servo_problem(self, q: np.ndarray, p: np.ndarray, R: np.ndarray, leash: np.ndarray) -> str:
        """Whether arms with the named errors can be brought to a pose from inside the servo box: from the
        seed, or with the joints' own errors taken back."""
        lo, hi = self.box(q, leash)
        lo = np.maximum(lo, self.chain.q_min + _SERVO_MARGIN)
        hi = np.minimum(hi, self.chain.q_max - _SERVO_MARGIN)
        rows, goal = core.pose_rows(1)
        rows[0, :3], rows[0, 3:] = p, R.reshape(9)
        null = core.ffi.NULL
        for k, arm in enumerate(self._cases):
            back = np.zeros(self.chain.n)
            for j in range(self.chain.n):
                arm.joint[j].q_min, arm.joint[j].q_max = lo[j], hi[j]
                back[j] = arm.joint[j].phi_rad - self.arm.joint[j].phi_rad
            for start in (q - back, q.copy()):
                at = core.ptr(start)
                if core.lib.kc_ik_solve(arm, null, null, goal, self._servo_opt, at, self._eval) == 0:
                    break
            else:
                return f"out of the servo's reach under case {k}"
        return ""

    def problems(self, q: np.ndarray) -> list[str]:
        """First check that each row of joints fails as a place to stand, or an empty string."""
        q = np.asarray(q, float).reshape(-1, self.chain.n)
        p, R = self.poses(q)
        look = self.looks(p, R)
        out, seen = self.view_problems(p, look)
        limits = np.any((q < self.lo) | (q > self.hi), axis=1)
        for i, x in enumerate(q):
            if limits[i]:
                out[i] = "joint limits"
            elif not out[i]:
                if pair := self.nominal.touching(x):
                    out[i] = f"too near as drawn: {pair}"
                elif self.thick.seen(x, look.eye[i], int(seen[i])).bit_count() < self.desc.view.tags_min:
                    out[i] = "the arm hides the tags"
                else:
                    out[i] = self.servo_problem(x, p[i], R[i], self.leash)
        return out

    def problem(self, q: np.ndarray) -> str:
        return self.problems(q)[0]

    def wrong_touching(self, q: np.ndarray) -> tuple[str, int] | None:
        """First pair that touches on an arm with errors, and which arm."""
        for k, arm in enumerate(self.wrong):
            if pair := arm.touching(q):
                return pair, k
        return None

    def first_problem(self, q: np.ndarray, hub: np.ndarray, spare: bool = False) -> str:
        """Why joints q are no first look, or an empty string: as safe as a hub, the way there too, and a tag
        shows under nearly all errors."""
        if problem := self.hub_problem(q):
            return problem
        if pair := self.segment_problem(hub, q):
            return f"not clear on the way from its hub: {pair}"
        shown = sum(self.shown_by_wrong(q))
        wanted = SPARE_SHOWN if spare else FIRST_SHOWN
        few = shown < wanted * len(self.errors) or not self.first_tags(q)
        return f"showing a tag with {shown} of {len(self.errors)} arms with errors" if few else ""

    def segment_problem(self, a: np.ndarray, b: np.ndarray) -> str:
        """What is in the way of the straight joint-space segment, both ends included."""
        n = max(int(np.ceil(np.max(np.abs(b - a)) / self.desc.clear.step_rad)), 1)
        way = [a + (b - a) * s for s in np.linspace(0.0, 1.0, n + 1)]
        for arm in (self.nominal, *self.wrong):
            for q in way:
                if pair := arm.touching(q):
                    return pair
        return ""

    def box(self, q: np.ndarray, leash: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joints the servo may use around a seed."""
        return np.maximum(q - leash, self.chain.q_min), np.minimum(q + leash, self.chain.q_max)

    def stream(self, purpose: int, q: np.ndarray) -> np.random.Generator:
        """Random numbers that belong to joints q, so that whoever asks again draws the same."""
        return np.random.default_rng([self.desc.seed, purpose, *q.astype(np.float32).view(np.uint32)])

    def leash_problem(self, q: np.ndarray, leash: np.ndarray, samples: int, rng: np.random.Generator) -> str:
        """What touches at sampled postures of the servo box: half of them corners, and the arms in turn
        (the nominal one first)."""
        lo, hi = self.box(q, leash)
        arms = [self.nominal, *self.wrong]
        offset = int(rng.integers(len(arms)))
        u = rng.random((samples, self.chain.n))
        u[1::2] = np.round(u[1::2])
        for i, at in enumerate(lo + (hi - lo) * u):
            if pair := arms[(offset + i) % len(arms)].touching(at):
                return pair
        return ""

    def hub_problem(self, q: np.ndarray) -> str:
        """Why joints q are no hub, or an empty string."""
        if np.any(q < self.chain.q_min) or np.any(q > self.chain.q_max):
            j = int(np.argmax(np.maximum(self.chain.q_min - q, q - self.chain.q_max)))
            return f"outside the joint limits: J{j + 1} {q[j]:.2f} rad"
        if pair := self.nominal.touching(q):
            return f"too near as drawn: {pair}"
        if found := self.wrong_touching(q):
            pair, k = found
            return f"too near with errors {self.errors[k]}: {pair}"
        leash = np.minimum(self.leash, HUB_LEASH)
        if pair := self.leash_problem(q, leash, self.desc.clear.leash_samples, self.stream(3, q)):
            return f"not clear within {HUB_LEASH} rad of every joint: {pair}"
        return ""

    def hub_of(self, q: np.ndarray) -> int | None:
        """Nearest hub with a proven segment."""
        order = sorted(range(len(self.hubs)), key=lambda h: (float(np.max(np.abs(q - self.hubs[h]))), h))
        return next((h for h in order if not self.segment_problem(self.hubs[h], q)), None)
