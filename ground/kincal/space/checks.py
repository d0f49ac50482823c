"""What a candidate has to pass: reach, view, sight, distance to everything, also when the arm is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from kincal import core
from kincal.errors import KincalError
from kincal.geometry import ArmChain, Camera

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
}
WHY_ALL = sum(WHY)
FAULTY_INCID_MAX_RAD = 1.2  # a tag still decodes, though its pose is poor
_IK = {"iter_max": 60, "tol_pos_m": 1e-6, "tol_rot_rad": 1e-6, "margin": 0.0, "step_max": 0.5}


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
            raise KincalError("margins leave a joint no room", "joints.margin_rad")
        self.hubs = [np.array(h) for h in desc.joints.hubs_rad]
        self.leash = np.array(leash).astype(np.float32).astype(float)  # as the table keeps it
        # A margin at the image rim is a camera with a smaller image.
        self._tight = core.ffi.new("kc_camera_t *", camera[0])
        m = desc.view.image_margin_px
        self._tight.width_px = int(camera.width_px - 2 * m)
        self._tight.height_px = int(camera.height_px - 2 * m)
        self._tight.cx_px = camera.cx_px - m
        self._tight.cy_px = camera.cy_px - m
        self.tight = Camera(self._tight)
        self.sizes = np.array([float(t.size_m) for t in camera.tag[0 : int(camera.n_tags)]])
        self.nominal = Bodies(desc, arm, camera, None, desc.clear.nominal_m)
        self.thick = Bodies(desc, arm, camera, None, 0.0, desc.sight.margin_m)
        self.errors = drawn.draw(desc, n)
        self.wrong = [Bodies(desc, arm, camera, e, desc.clear.drawn_m) for e in self.errors]
        self._eval = core.ffi.new("kc_eval_t *")
        self._goal, self._q = core.ffi.new("kc_pose_t *"), core.ffi.new("double[]", n)
        self._opt = core.ffi.new("kc_ik_opt_t *", _IK)

    # ---- seen

    def look(self, p: np.ndarray, R: np.ndarray) -> tuple[float, float, bool, np.ndarray, np.ndarray]:
        """Head angles that centre the tool, whether they are allowed, and the tool in the camera frame."""
        pan, tilt, reach = self.camera.aim(p)
        c, m = self.camera.camera, self.desc.view.head_margin_rad
        inside = (
            reach
            and c.pan_min_rad + m <= pan <= c.pan_max_rad - m
            and c.tilt_min_rad + m <= tilt <= c.tilt_max_rad - m
        )
        p_cam, R_cam = self.camera.pose(pan, tilt)
        return pan, tilt, inside, R_cam.T @ (p - p_cam), R_cam.T @ R

    def edge_px(self, p_cam: np.ndarray, R_cam: np.ndarray) -> np.ndarray:
        """Shortest edge of each tag's black square in the image."""
        c, out = self.camera.camera, []
        for (xyz, R_tag), size in zip(self.camera.tags, self.sizes, strict=True):
            h = 0.5 * size
            corner = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])
            at = p_cam + (xyz + corner @ R_tag.T) @ R_cam.T
            uv = at[:, :2] / np.maximum(at[:, 2:], 1e-6) * [c.fx_px, c.fy_px]
            out.append(np.min(np.linalg.norm(uv - np.roll(uv, 1, axis=0), axis=1)))
        return np.array(out)

    def view_problem(self, p: np.ndarray, R: np.ndarray) -> tuple[str, int]:
        """First check of the view that a tool pose fails, and the tags that show if nothing hides them."""
        t, v = self.desc.tool, self.desc.view
        if np.any(p < t.box_min_m) or np.any(p > t.box_max_m):
            return "outside the position box", 0
        _pan, _tilt, inside, p_cam, R_cam = self.look(p, R)
        if not v.range_min_m <= np.linalg.norm(p_cam) <= v.range_max_m:
            return "too near to or far from the camera", 0
        if not inside:
            return "head limits", 0
        if np.sum(self.camera.incidence(p_cam, R_cam) <= v.incid_max_rad) < v.tags_min:
            return "tags too oblique or facing away", 0
        seen = self.tight.visible(p_cam, R_cam, v.incid_max_rad)
        if seen.bit_count() < v.tags_min:
            return "too few tags in the image", 0
        large = sum(1 << int(i) for i in np.flatnonzero(self.edge_px(p_cam, R_cam) >= v.tag_min_px))
        if (seen & large).bit_count() < v.tags_min:
            return "tags too small in the image", 0
        return "", seen & large

    def tags(self, q: np.ndarray) -> int:
        """Tags that joints q show: in view and not hidden."""
        p, R = self.chain.fk(q)
        problem, seen = self.view_problem(p, R)
        return 0 if problem else seen & self.sight(self.thick, q, p)

    def sight(self, bodies: Bodies, q: np.ndarray, aim_at: np.ndarray) -> int:
        pan, tilt, _ = self.camera.aim(aim_at)
        eye, _ = self.camera.pose(pan, tilt)
        return bodies.seen(q, eye, self.camera.camera)

    def seen_by_wrong(self, q: np.ndarray, k: int) -> bool:
        """Arm k shows a tag at joints q, the head aimed where the nominal arm's tool would be."""
        p, _ = self.chain.fk(q)
        pan, tilt, _ = self.camera.aim(p)
        eye, R_cam = self.camera.pose(pan, tilt)
        at, R = self.wrong[k].tool(q)
        mask = self.camera.visible(R_cam.T @ (at - eye), R_cam.T @ R, FAULTY_INCID_MAX_RAD)
        return bool(mask and mask & self.wrong[k].seen(q, eye, self.camera.camera))

    # ---- clear

    def reach(self, p: np.ndarray, R: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        """Joints inside the margins that bring the nominal tool there."""
        self._goal.p_m = [float(x) for x in p]
        self._goal.R = [float(x) for x in R.reshape(9)]
        self._q[0 : self.chain.n] = [float(x) for x in start]
        status = core.lib.kc_ik_solve(
            self.arm, core.ffi.NULL, core.ffi.NULL, self._goal, self._opt, self._q, self._eval
        )
        q = np.array(list(self._q))
        # the table keeps single precision; so does everything that is proven
        q = q.astype(np.float32).astype(float)
        return q if status == 0 and np.all(q >= self.lo) and np.all(q <= self.hi) else None

    def problem(self, q: np.ndarray) -> str:
        """First check that joints q fail as a place to stand, or an empty string."""
        if np.any(q < self.lo) or np.any(q > self.hi):
            return "joint limits"
        p, R = self.chain.fk(q)
        problem, seen = self.view_problem(p, R)
        if problem:
            return problem
        if (seen & self.sight(self.thick, q, p)).bit_count() < self.desc.view.tags_min:
            return "the arm hides the tags"
        pair = self.nominal.touching(q)
        return f"too near as drawn: {pair}" if pair else ""

    def wrong_touching(self, q: np.ndarray) -> tuple[str, int] | None:
        """First pair that touches on an arm with errors, and which arm."""
        for k, arm in enumerate(self.wrong):
            if pair := arm.touching(q):
                return pair, k
        return None

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

    def leash_problem(self, q: np.ndarray, leash: np.ndarray, samples: int, rng: np.random.Generator) -> str:
        """What touches at sampled postures of the servo box: half of them corners, and the arms in turn
        (the nominal one first)."""
        lo, hi = self.box(q, leash)
        arms = [self.nominal, *self.wrong]
        offset = int(rng.integers(len(arms)))
        for i in range(samples):
            u = rng.random(self.chain.n)
            at = lo + (hi - lo) * (np.round(u) if i % 2 else u)
            if pair := arms[(offset + i) % len(arms)].touching(at):
                return pair
        return ""

    def hub_of(self, q: np.ndarray) -> int | None:
        """Nearest hub with a proven segment."""
        order = sorted(range(len(self.hubs)), key=lambda h: (float(np.max(np.abs(q - self.hubs[h]))), h))
        return next((h for h in order if not self.segment_problem(self.hubs[h], q)), None)
