"""The arm as solid shapes in MuJoCo's collision engine: what touches, and what hides a tag."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from kincal.rotations import Pose
from kincal_shared.schema.space import Description

from .arrays import Floats
from .fit import require_fit
from .inputs import TablesFolder
from .mjcf import ArmModel

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera, KcTag

_PRINT_POINTS = [[x, y, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1)]  # of a tag, in half sizes
_RAY_MAX_M = 10.0
_PRINT_GAP_M = 0.001  # a ray that ends so close before the print has met the print


class CollisionModel:
    """One arm (nominal, or with DH errors by name) among its keep-out volumes.

    Nearer than `contact_m` counts as contact; links are `grow_m` thicker than described."""

    def __init__(
        self,
        desc: Description,
        arm: KcArm,
        camera: KcCamera,
        errors: Mapping[str, float] | None = None,
        contact_m: float = 0.0,
        grow_m: float = 0.0,
    ) -> None:
        self.contact_m = contact_m
        built = ArmModel(desc, arm, camera, errors or {})
        self.model = mujoco.MjModel.from_xml_string(built.xml(contact_m, grow_m))
        self.data = mujoco.MjData(self.model)
        # a view: every access through `data` costs as much as a move
        self._q = self.data.qpos[: int(arm.n_joints)]
        self._tool = self.model.body("tool").id
        self.labels = [built.label_of[self.model.geom(i).name] for i in range(self.model.ngeom)]
        half = 0.5 * desc.sight.border
        self._prints_m = [_print_points(t, half * float(t.size_m)) for t in camera.tag[0 : camera.n_tags]]
        plates = {s.tag: s.name for s in desc.shape if s.joint == 0 and s.tag is not None}
        self._plate_of = {tag: self.model.geom(name).id for tag, name in plates.items()}

    def _move(self, q_rad: Floats) -> None:
        self._q[:] = q_rad
        mujoco.mj_kinematics(self.model, self.data)

    def contact(self, q_rad: Floats) -> str:
        """First pair in contact at joints q, "a - b", or an empty string."""
        self._move(q_rad)
        mujoco.mj_collision(self.model, self.data)
        if not self.data.ncon:
            return ""
        near = np.flatnonzero(self.data.contact.dist[: self.data.ncon] < self.contact_m)
        if not len(near):
            return ""
        return self._pair(int(near[0]))

    def nearest(self, q_rad: Floats) -> tuple[float, str]:
        """Least distance [m] of the pairs nearer than `contact_m` at joints q, and that pair as in `contact`;
        inf and "" if there is none. Negative: one is inside the other."""
        self._move(q_rad)
        mujoco.mj_collision(self.model, self.data)
        found = self.data.contact.dist[: self.data.ncon]
        if not self.data.ncon or found.min() >= self.contact_m:
            return float("inf"), ""
        return float(found.min()), self._pair(int(np.argmin(found)))

    def _pair(self, contact: int) -> str:
        return " - ".join(sorted(self.labels[g] for g in self.data.contact.geom[contact]))

    def tool_pose(self, q_rad: Floats) -> tuple[Floats, Floats]:
        """Position [m] and rotation of the tool in the base frame, by MuJoCo's own kinematics."""
        self._move(q_rad)
        return self.data.xpos[self._tool].copy(), self.data.xmat[self._tool].reshape(3, 3).copy()

    def visible_tags(self, q_rad: Floats, eye_m: Floats, tags: int) -> int:
        """Those of `tags` (bits) with nothing of the arm between the camera at `eye_m` and nine points of the
        print (rays)."""
        if not tags:
            return 0
        p_m, R = self.tool_pose(q_rad)
        asked = [i for i in range(len(self._prints_m)) if tags >> i & 1]
        return sum(1 << i for i in asked if self._in_sight(i, eye_m, p_m + self._prints_m[i] @ R.T))

    def _in_sight(self, tag: int, eye_m: Floats, points_m: Floats) -> bool:
        n = len(points_m)
        ids, hit_m = np.zeros(n, np.int32), np.zeros(n)
        to = points_m - eye_m
        reach_m = np.sqrt(np.sum(to * to, axis=1))
        unit = (to / reach_m[:, None]).reshape(-1)
        mujoco.mj_multiRay(
            self.model, self.data, eye_m, unit, None, False, -1, ids, hit_m, None, n, _RAY_MAX_M
        )
        blocked = (ids >= 0) & (hit_m < reach_m - _PRINT_GAP_M) & (ids != self._plate_of.get(tag, -1))
        return not np.any(blocked)


def clear_of_contact(desc: Description, tables: TablesFolder) -> Callable[[Floats], NDArray[np.bool_]]:
    """A test of joints (N, joints) [rad or m]: whether the nominal arm keeps its distance to itself and to
    what is around it, (N,). BadInput if the description does not fit the tables."""
    require_fit(desc, tables.arm, tables.camera)
    nominal = CollisionModel(desc, tables.arm, tables.camera, None, desc.clear.nominal_m)

    def clear(q_rad: Floats) -> NDArray[np.bool_]:
        return np.array([not nominal.contact(q) for q in q_rad], dtype=bool)

    return clear


def _print_points(tag: KcTag, half_m: float) -> Floats:
    """Nine points of a tag's print in the tool frame, (9, 3)."""
    return Pose.of_wxyz(list(tag.xyz_m), list(tag.quat_wxyz)).apply(half_m * np.array(_PRINT_POINTS))
