"""The arm with correction terms at many poses: residuals, derivatives, bases, poses.

Every number comes from the C model that flies (fsw/model), compiled with the ground's limits; the loop over
poses is in C too. A model is a pure function of its coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.schema.names import FAULTS, PNP

from .arm import Arm
from .builds import Floats, doubles, library
from .terms import BasisLike, Terms, fill_basis

if TYPE_CHECKING:
    from .headers import CData


class CameraLike(Protocol):
    """Pinhole intrinsics [px]."""

    @property
    def fx_px(self) -> float:
        """Focal length along u [px]."""

    @property
    def fy_px(self) -> float:
        """Focal length along v [px]."""

    @property
    def cx_px(self) -> float:
        """Principal point, u [px]."""

    @property
    def cy_px(self) -> float:
        """Principal point, v [px]."""


class PnpLike(Protocol):
    """Columns of PnP poses at N poses."""

    def __call__(self, numbers: Sequence[int], expected: Pose) -> Floats:
        """(N, 6, k) twists of the columns `numbers` [m, rad per unit] in the measured frame, the view taken
        at the expected poses (N)."""


# Columns of the data that go into kc_ctx_t under their own name.
_SCALARS = ("temp_c", "t_s", "payload_kg", "range_m", "incid_rad", "pan_rad", "tilt_rad", "tag")


class Observations:
    """What was read and measured at N poses of an arm with n joints; fixed once made.

    components: 6 with orientations, 3 with positions only; pnp: columns of poses that come from a camera and
    a target of many points, if they do.
    """

    def __init__(
        self,
        records: NDArray[Any],
        n_joints: int,
        components: int,
        keep_image: bool,
        pnp: PnpLike | None = None,
    ) -> None:
        records.setflags(write=False)
        self.records, self.n_joints = records, n_joints
        self.components, self.keep_image = components, keep_image
        self.pnp = pnp

    def seen_by(self, pnp: PnpLike | None) -> Observations:
        """The same with columns of PnP poses."""
        return Observations(self.records, self.n_joints, self.components, self.keep_image, pnp)

    @property
    def n(self) -> int:
        """Number of poses."""
        return len(self.records)

    @classmethod
    def of(cls, data: object, gravity_m_s2: ArrayLike, camera: CameraLike | None = None) -> Observations:
        """From a data set: any object with the attributes of kincal.workbench's Measurements.

        gravity_m_s2: (3,) in the base frame, used where the data hold none. camera: intrinsics, with which
        pixel columns give the image position; without them it follows from where the tool is.
        """
        names = (
            "q",
            "p_m",
            "quat_wxyz",
            "direction",
            "move",
            "qdot",
            "g_m_s2",
            "cam_p_m",
            "cam_quat_wxyz",
            *_SCALARS,
        )
        columns = {name: getattr(data, name) for name in names if getattr(data, name, None) is not None}
        u, v = getattr(data, "u_px", None), getattr(data, "v_px", None)
        if camera is not None and u is not None and v is not None:
            columns["u_norm"] = (u - camera.cx_px) / camera.fx_px
            columns["v_norm"] = (v - camera.cy_px) / camera.fy_px
        return cls.of_columns(columns, gravity_m_s2)

    @classmethod
    def of_columns(cls, columns: Mapping[str, ArrayLike], gravity_m_s2: ArrayLike) -> Observations:
        """From arrays by name; all but q (N, n) may be missing.

        p_m (N, 3) [m] and quat_wxyz (N, 4): measured tool in the base frame; direction, move, qdot (N, n);
        g_m_s2 (N, 3); cam_p_m (N, 3) and cam_quat_wxyz (N, 4): camera in the base frame; temp_c, t_s,
        payload_kg, range_m, incid_rad, pan_rad, tilt_rad, tag, and u_norm, v_norm (normalised image
        position, from pixels): (N,).
        """
        given = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
        n, joints = given["q"].shape
        rows = np.zeros(n, dtype=library("ground").dtype("kc_obs_t"))
        ctx = rows["ctx"]
        for name, field in (("q", "q"), ("direction", "dir"), ("qdot", "qdot")):
            if name in given:
                ctx[field][:, :joints] = given[name]
        if "move" in given:
            ctx["move"][:, 1 : 1 + joints] = given["move"]
        ctx["g_m_s2"] = given.get("g_m_s2", np.asarray(gravity_m_s2, dtype=float))
        for name in _SCALARS:
            ctx[name] = given.get(name, 0.0)
        rows["p_m"] = given.get("p_m", 0.0)
        rows["has_rot"] = int("quat_wxyz" in given)
        rows["q_wxyz"] = given.get("quat_wxyz", (1.0, 0.0, 0.0, 0.0))
        cls._place_camera(rows, given)
        return cls(rows, joints, 6 if "quat_wxyz" in given else 3, "u_norm" in given)

    @staticmethod
    def _place_camera(rows: NDArray[Any], given: Mapping[str, Floats]) -> None:
        """Camera pose, and where it measured the tool; without a camera the sensor is the measurement frame
        itself."""
        rows["has_cam"] = 1
        rows["q_cam_wxyz"] = given.get("cam_quat_wxyz", (1.0, 0.0, 0.0, 0.0))
        rows["p_cam_m"] = given.get("cam_p_m", 0.0)
        R = matrix_of_wxyz(rows["q_cam_wxyz"])
        seen = np.einsum("nji,nj->ni", R, rows["p_m"] - rows["p_cam_m"])
        rows["ctx"]["p_cam_tool_m"] = seen
        if "cam_p_m" not in given:
            return
        front = seen[:, 2] > 0.0
        for k, name in enumerate(("u_norm", "v_norm")):
            ray = np.divide(seen[:, k], seen[:, 2], out=np.zeros(len(seen)), where=front)
            rows["ctx"][name] = given.get(name, ray)

    def take(self, index: ArrayLike) -> Observations:
        """Some of the poses: positions or a mask, in that order; without columns of PnP poses."""
        return Observations(
            self.records[np.asarray(index)].copy(), self.n_joints, self.components, self.keep_image
        )


@dataclass(frozen=True)
class Evaluation:
    """All N poses at one set of coefficients; base frame, not whitened; c = 6 or 3 components.

    r: (N, c) residual, measured - model [m, rad];
    J: (N, c, k) d(model - measured) / d coefficient;
    twist: (N, n + 4, 6, c) the same derivative by frame and component: frames 0..n, then FRAME_TOOL,
    FRAME_CAMERA and FRAME_MEAS, which count from the end;
    Jq: (N, c, n) d pose / d joint at fixed corrections.
    """

    r: Floats
    J: Floats
    twist: Floats
    Jq: Floats


@dataclass(frozen=True)
class _Held:
    """Observations as the terms see them at some coefficients, and the gravity loads there."""

    observations: NDArray[Any]
    loads: NDArray[Any]


class Model:
    """An arm with correction terms at the poses of some observations.

    coef is (k,), in the order of the terms. loads_at: coefficients at which gravity loads and the view of
    the sensor are taken, `coef` itself unless given; a fit keeps them where it stands while it tries a step.
    Their derivative is second order and not part of J.
    """

    def __init__(self, arm: Arm, terms: Terms, observations: Observations) -> None:
        if observations.n_joints != arm.n:
            raise ValueError(f"observations of {observations.n_joints} joints, an arm of {arm.n}")
        self.arm, self.terms, self.observations = arm, terms, observations
        self._ground = library("ground")
        self._last: tuple[bytes, _Held] | None = None
        self._last_columns: tuple[tuple[bytes, int], Floats] | None = None

    @property
    def n(self) -> int:
        """Number of poses."""
        return self.observations.n

    @property
    def components(self) -> int:
        """6 with orientations, 3 with positions only."""
        return self.observations.components

    def at(self, observations: Observations) -> Model:
        """The same arm and terms at other poses."""
        return Model(self.arm, self.terms, observations)

    def residuals(self, coef: ArrayLike, loads_at: ArrayLike | None = None) -> Floats:
        """(N, c) measured - model [m, rad]; `evaluate(...).r` to rounding, in half the time."""
        r = np.empty((self.n, self.components))
        x, held = self._at(coef, loads_at)
        self._ground.lib.kg_residuals(
            self.arm.struct,
            self.terms.struct,
            self._ground.pointer(x),
            self.n,
            self.components,
            *self._pointers(held),
            self._ground.pointer(r),
        )
        return r

    def linearised(self, coef: ArrayLike, loads_at: ArrayLike | None = None) -> tuple[Floats, Floats]:
        """r (N, c) and J (N, c, k) of `evaluate`, without what only a finished fit needs."""
        r = np.empty((self.n, self.components))
        J = np.empty((self.n, self.components, self.terms.n))
        self._evaluate(coef, loads_at, r=r, J=J)
        return r, J

    def evaluate(self, coef: ArrayLike, loads_at: ArrayLike | None = None) -> Evaluation:
        """Residuals and all derivatives."""
        n, c, joints = self.n, self.components, self.arm.n
        out = Evaluation(
            np.empty((n, c)),
            np.empty((n, c, self.terms.n)),
            np.empty((n, joints + 4, 6, c)),
            np.empty((n, c, joints)),
        )
        self._evaluate(coef, loads_at, r=out.r, J=out.J, twist=out.twist, Jq=out.Jq)
        return out

    def poses(self, coef: ArrayLike, loads_at: ArrayLike | None = None) -> Pose:
        """(N,) corrected tool poses in the base frame."""
        x, held = self._at(coef, loads_at)
        return self._expected(held, x)

    def pose_jacobian(self, coef: ArrayLike, loads_at: ArrayLike | None = None) -> Floats:
        """(N, 6, k) d pose / d coefficient: position [m], rotation about the tool point [rad], base frame.
        Nothing measured plays a part; camera-side terms are zero."""
        J = np.empty((self.n, 6, self.terms.n))
        ground, (x, held) = self._ground, self._at(coef, loads_at)
        ground.lib.kg_poses(
            self.arm.struct,
            self.terms.struct,
            ground.pointer(x),
            self.n,
            *self._pointers(held),
            ground.pointer(None, "kc_pose_t"),
            ground.pointer(J),
        )
        return J

    def basis_values(self, basis: BasisLike, coef: ArrayLike) -> Floats:
        """(N,) values of a basis at the loads and the view of these coefficients."""
        if basis.var in PNP:
            return self._pnp_values(basis, self._coef(coef))
        ground, held = self._ground, self._hold(self._coef(coef))
        struct = ground.new("kc_basis_t")
        fill_basis(struct, basis)
        out = np.empty(self.n)
        ground.lib.kg_basis(struct, self.n, *self._pointers(held), ground.pointer(out))
        return out

    # -- calls into C

    def _coef(self, coef: ArrayLike) -> Floats:
        return doubles(coef, (self.terms.n,))

    def _at(self, coef: ArrayLike, loads_at: ArrayLike | None) -> tuple[Floats, _Held]:
        """Coefficients, and the observations as held at those that loads are taken at."""
        x = self._coef(coef)
        return x, self._hold(x if loads_at is None else self._coef(loads_at))

    def _pointers(self, held: _Held) -> tuple[CData, CData]:
        return (
            self._ground.pointer(held.observations, "kc_obs_t"),
            self._ground.pointer(held.loads, "kc_loads_t"),
        )

    def _hold(self, coef: Floats) -> _Held:
        """Loads and view at the coefficients; the last ones are remembered."""
        key = coef.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        ground, records = self._ground, self.observations.records
        held = _Held(np.empty_like(records), np.empty(self.n, dtype=ground.dtype("kc_loads_t")))
        ground.lib.kg_hold(
            self.arm.struct,
            self.terms.struct,
            ground.pointer(coef),
            self.n,
            ground.pointer(records, "kc_obs_t"),
            self.observations.keep_image,
            *self._pointers(held),
        )
        self._hold_pnp(held, coef)
        self._last = (key, held)
        return held

    def _hold_pnp(self, held: _Held, coef: Floats) -> None:
        """Columns of PnP poses that the terms use, at the poses that the model expects."""
        if self.terms.pnp:
            columns = self._pnp(self.terms.pnp, self._expected(held, coef))
            held.observations["ctx"]["pnp"][:, :, 1 : 1 + len(self.terms.pnp)] = columns

    def _pnp(self, numbers: Sequence[int], expected: Pose) -> Floats:
        if self.observations.pnp is None:
            return np.zeros((self.n, 6, len(numbers)))
        return self.observations.pnp(numbers, expected)

    def _pnp_values(self, basis: BasisLike, coef: Floats) -> Floats:
        """One component of a column, for all poses. Columns of one sight come together; the last are
        remembered."""
        sight, fault = divmod(basis.index - 1, len(FAULTS))
        key = (coef.tobytes(), sight)
        if self._last_columns is None or self._last_columns[0] != key:
            numbers = [1 + sight * len(FAULTS) + k for k in range(len(FAULTS))]
            self._last_columns = key, self._pnp(numbers, self._expected(self._hold(coef), coef))
        values: Floats = self._last_columns[1][:, list(PNP).index(basis.var), fault]
        return basis.c1 * (values - basis.c0)

    def _expected(self, held: _Held, coef: Floats) -> Pose:
        """(N,) poses of the arm at the coefficients; what is on the camera's side plays no part."""
        rows = np.empty((self.n, 12))
        self._ground.lib.kg_poses(
            self.arm.struct,
            self.terms.struct,
            self._ground.pointer(coef),
            self.n,
            *self._pointers(held),
            self._ground.pointer(rows, "kc_pose_t"),
            self._ground.pointer(None),
        )
        return Pose(rows[:, :3].copy(), rows[:, 3:].reshape(-1, 3, 3).copy())

    def _evaluate(
        self,
        coef: ArrayLike,
        loads_at: ArrayLike | None,
        *,
        r: Floats | None = None,
        J: Floats | None = None,
        twist: Floats | None = None,
        Jq: Floats | None = None,
    ) -> None:
        """Fill the arrays that are given."""
        ground, (x, held) = self._ground, self._at(coef, loads_at)
        ground.lib.kg_evaluate(
            self.arm.struct,
            self.terms.struct,
            ground.pointer(x),
            self.n,
            self.components,
            *self._pointers(held),
            *(ground.pointer(array) for array in (r, J, twist, Jq)),
        )
