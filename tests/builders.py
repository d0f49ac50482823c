"""Structs of the flight core made from a few numbers, and its functions called on single poses. For tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kincal.flight import check, library
from kincal.flight.builds import doubles
from kincal.rotations import Pose

flight = library("flight")
ffi, lib = flight.ffi, flight.lib
fill, pointer, view = flight.set_fields, flight.pointer, flight.array


# --------------------------------------------------------------------------- rotations and poses


def pose_of(c_pose: Any) -> Pose:
    """Copy of a kc_pose_t."""
    return Pose(view(c_pose.p_m).copy(), view(c_pose.R, 3, 3).copy())


def c_pose(pose: Pose) -> Any:
    """kc_pose_t of a pose."""
    return fill(flight.new("kc_pose_t"), {"p_m": pose.p_m, "R": pose.R.ravel()})


def quat_from_R(R: Any) -> np.ndarray:
    """kc_R_to_quat: (w, x, y, z), w >= 0; exact for half turns."""
    q = np.empty(4)
    lib.kc_R_to_quat(pointer(doubles(R, (3, 3))), pointer(q))
    return q


def R_from_quat(q: Any) -> np.ndarray:
    """kc_quat_to_R"""
    R = np.empty((3, 3))
    lib.kc_quat_to_R(pointer(doubles(q, (4,))), pointer(R))
    return R


def quat_mul(a: Any, b: Any) -> np.ndarray:
    """kc_quat_mul"""
    out = np.empty(4)
    lib.kc_quat_mul(pointer(doubles(a, (4,))), pointer(doubles(b, (4,))), pointer(out))
    return out


def quat_dist_rad(a: Any, b: Any) -> float:
    """kc_quat_dist_rad: rotation angle between two unit quaternions, 0..pi."""
    return float(lib.kc_quat_dist_rad(pointer(doubles(a, (4,))), pointer(doubles(b, (4,)))))


def R_log(R: Any) -> np.ndarray:
    """kc_R_log: rotation vector [rad]."""
    w = np.empty(3)
    lib.kc_R_log(pointer(doubles(R, (3, 3))), pointer(w))
    return w


def R_exp(w_rad: Any) -> np.ndarray:
    """kc_R_exp"""
    R = np.empty((3, 3))
    lib.kc_R_exp(pointer(doubles(w_rad, (3,))), pointer(R))
    return R


def pose_residual(meas: Pose, model: Pose) -> np.ndarray:
    """kc_pose_residual: (p_meas - p_model ; log(R_meas R_model^T))."""
    r = np.empty(6)
    lib.kc_pose_residual(c_pose(meas), c_pose(model), pointer(r))
    return r


# --------------------------------------------------------------------------- tables


def arm_from(joints: Sequence[Mapping[str, Any]], **fields: Any) -> Any:
    """kc_arm_t from one dict per joint (field names of kc_joint_t) and the arm's other fields.

    >>> arm = arm_from([{"a_m": 0.5, "q_min": -2, "q_max": 2}], tool_xyz_m=(0, 0, 0.1))
    """
    common = {
        "name": "arm",
        "base_quat_wxyz": (1, 0, 0, 0),
        "tool_quat_wxyz": (1, 0, 0, 0),
        "gravity_m_s2": (0, 0, -9.81),
        "n_joints": len(joints),
    }
    arm = flight.new("kc_arm_t")
    fill(arm, common | {"joint": [{"speed_max": 1.0} | dict(j) for j in joints]} | fields)
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    status = lib.kc_arm_validate(arm, index, got)
    check(status, f"arm, joint index {index[0]}, value {got[0]}")
    return arm


def basis(
    fn: str = "lin", var: str = "one", index: int = 0, c0: float = 0.0, c1: float = 1.0
) -> dict[str, Any]:
    """kc_basis_t as a dict; names as in kc_terms.h without their prefix, any case."""
    numbers = {
        "fn": flight.constant(f"KC_FN_{fn.upper()}"),
        "var": flight.constant(f"KC_VAR_{var.upper()}"),
    }
    return numbers | {"index": index, "c0": c0, "c1": c1}


def term(coef: int, frame: int, comp: str, *bases: Mapping[str, Any], gain: float = 1.0) -> dict[str, Any]:
    """kc_term_t as a dict: comp "tx" .. "rz", up to two bases (missing ones are 1)."""
    both = [dict(b) for b in bases] + [basis()] * (2 - len(bases))
    number = flight.constant(f"KC_{comp.upper()}")
    return {"coef": coef, "frame": frame, "comp": number, "gain": gain, "basis": both}


def terms_from(
    coefs: Sequence[Mapping[str, Any] | str], terms: Sequence[Mapping[str, Any]], n_joints: int
) -> Any:
    """kc_terms_t from coefficients (a name, or a dict of kc_coef_t fields) and terms."""
    out = flight.new("kc_terms_t")
    common = {"lb": -10.0, "ub": 10.0, "scale": 0.01, "enabled": 1}
    named = [{"name": c} if isinstance(c, str) else dict(c) for c in coefs]
    counts = {"n_coef": len(named), "n_term": len(terms)}
    fill(out, counts | {"coef": [common | c for c in named], "term": list(terms)})
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    status = lib.kc_terms_validate(out, n_joints, index, got)
    check(status, f"terms, index {index[0]}, value {got[0]}")
    return out


def dh_terms(n_joints: int, bound: Sequence[float] = (3.2, 3.2, 0.5, 0.5)) -> Any:
    """kc_terms_t with the 4 n DH errors."""
    out = flight.new("kc_terms_t")
    check(lib.kc_terms_add_dh(out, n_joints, ffi.new("double[4]", [float(b) for b in bound])), "DH terms")
    return out


# --------------------------------------------------------------------------- the model at one pose


@dataclass(frozen=True)
class Loads:
    """Gravity torques about the joints and moments about the frames, each in its own frame [N m]."""

    tau: np.ndarray
    tau_payload: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True)
class Eval:
    """Corrected tool pose, d pose / d q (n, 6), d pose / d coefficient (n_coef, 6) and d pose / d twist
    (frames, 6 components, 6); rows (dp ; dtheta) in the base frame. J and twist None if not asked for."""

    T: Pose
    Jq: np.ndarray
    J: np.ndarray | None
    twist: np.ndarray | None


def context(arm: Any, q: Any, **fields: Any) -> Any:
    """kc_ctx_t of joint readings q on the arm; gravity is the arm's unless given."""
    own = {"g_m_s2": list(arm.gravity_m_s2), "q": doubles(q, (arm.n_joints,))}
    return fill(flight.new("kc_ctx_t"), own | fields)


def fk(arm: Any, q: Any) -> Pose:
    """kc_arm_fk: nominal forward kinematics."""
    T = flight.new("kc_pose_t")
    lib.kc_arm_fk(arm, pointer(doubles(q, (arm.n_joints,))), T)
    return pose_of(T)


class PoseModel:
    """An arm with correction terms, one pose a call: poses, loads and Jacobians."""

    def __init__(self, arm: Any, terms: Any) -> None:
        self.arm, self.terms = arm, terms
        self._loads, self._eval = flight.new("kc_loads_t"), flight.new("kc_eval_t")

    def _coef(self, coef: Any) -> np.ndarray:
        n = int(self.terms.n_coef)
        return np.zeros(n) if coef is None else doubles(coef, (n,))

    def loads(self, q: Any, coef: Any = None, **ctx: Any) -> Loads:
        """kc_model_loads"""
        n, out = self.arm.n_joints, self._loads
        x = context(self.arm, q, **ctx)
        lib.kc_model_loads(self.arm, self.terms, pointer(self._coef(coef)), x, out)
        moment = view(out.moment, n + 1, 3).copy()
        return Loads(view(out.tau, n).copy(), view(out.tau_payload, n).copy(), moment)

    def basis(self, var: str, index: int, q: Any, coef: Any = None) -> float:
        """kc_basis_eval of a variable as it is, at the loads of these coefficients."""
        self.loads(q, coef)
        one = fill(flight.new("kc_basis_t"), basis(var=var, index=index))
        return float(lib.kc_basis_eval(one, context(self.arm, q), self._loads))

    def eval(self, q: Any, coef: Any = None, *, want_J: bool = True, **ctx: Any) -> Eval:
        """kc_model_eval at the loads of the same coefficients. ctx: fields of kc_ctx_t."""
        c, x, ev = self._coef(coef), context(self.arm, q, **ctx), self._eval
        lib.kc_model_loads(self.arm, self.terms, pointer(c), x, self._loads)
        lib.kc_model_eval(self.arm, self.terms, pointer(c), x, self._loads, int(want_J), ev)
        J = view(ev.J, int(self.terms.n_coef), 6).copy() if want_J else None
        twist = self._twist() if want_J else None
        return Eval(pose_of(ev.T), view(ev.Jq, self.arm.n_joints, 6).copy(), J, twist)

    def _twist(self) -> np.ndarray:
        """kc_model_twist of every component at every frame."""
        out = np.zeros((lib.KC_FRAME_COUNT, 6, 6))
        for frame, comp in np.ndindex(out.shape[:2]):
            lib.kc_model_twist(self._eval, frame, comp, pointer(out[frame, comp]))
        return out

    def residual(self, obs: Any, coef: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """kc_model_residual: r (6 or 3) and J (n_coef, same) with r(coef + x) ~ r - J' x."""
        c, r = self._coef(coef), np.zeros(6)
        lib.kc_model_loads(self.arm, self.terms, pointer(c), flight.address(obs.ctx), self._loads)
        rows = lib.kc_model_residual(
            self.arm, self.terms, pointer(c), obs, self._loads, pointer(r), self._eval
        )
        return r[:rows], view(self._eval.J, int(self.terms.n_coef), 6).copy()[:, :rows]


# --------------------------------------------------------------------------- box QP


@dataclass(frozen=True)
class QpResult:
    """active: -1 at lower, 0 free, 1 at upper."""

    status: int
    x: np.ndarray
    active: np.ndarray
    kkt: float
    iters: int


def qp_solve(H: Any, g: Any, lb: Any, ub: Any, x0: Any = None) -> QpResult:
    """kc_qp_solve: minimise 1/2 x'Hx + g'x in the box."""
    H, qp = doubles(H), flight.new("kc_qp_t")
    qp.n = n = len(H)
    view(qp.H, lib.KC_COEF_MAX, lib.KC_COEF_MAX)[:n, :n] = H
    for name, value in (("g", g), ("lb", lb), ("ub", ub), ("x", 0.0 if x0 is None else x0)):
        view(getattr(qp, name))[:n] = value
    status = lib.kc_qp_solve(qp)
    side = {lib.KC_QP_FREE: 0, lib.KC_QP_AT_LOWER: -1, lib.KC_QP_AT_UPPER: 1}
    active = np.array([side[qp.active[i]] for i in range(n)])
    return QpResult(status, view(qp.x, n).copy(), active, float(qp.kkt), int(qp.iters))
