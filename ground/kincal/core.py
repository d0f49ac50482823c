"""The flight core as a library, so that what is reviewed on the ground is what flies.

`core.lib` holds every public function of fsw/, `core.ffi` makes its structs; both load on first use.
The rest are thin numpy wrappers. The library and the declarations (`libkincal.so`, `kincal_cdef.h`)
are looked for in this package's `_core/`, then in the folder that $KINCAL_CORE names, then in the
`build/` folder of the source tree.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cffi import FFI

from kincal.errors import KincalError

LIBRARY = "libkincal.so"
DECLARATIONS = "kincal_cdef.h"


def folders() -> list[Path]:
    """Where the library is looked for, in this order."""
    package = Path(__file__).resolve().parent
    named = os.environ.get("KINCAL_CORE")
    return [package / "_core", *([Path(named)] if named else []), package.parent.parent / "build"]


@cache
def _load() -> tuple[Any, Any]:
    for folder in folders():
        if (folder / LIBRARY).is_file() and (folder / DECLARATIONS).is_file():
            ffi = FFI()
            ffi.cdef((folder / DECLARATIONS).read_text())
            return ffi, ffi.dlopen(str(folder / LIBRARY))
    looked = ", ".join(str(f) for f in folders())
    raise KincalError("the flight core library was not found", f"looked in {looked}", "run `make core`")


def __getattr__(name: str) -> Any:
    if name in ("ffi", "lib"):
        ffi, lib = _load()
        globals().update(ffi=ffi, lib=lib)
        return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def status_name(status: int) -> str:
    """ "KC_OK", "KC_ERR_ARG" ..."""
    ffi, lib = _load()
    return ffi.string(lib.kc_status_name(status)).decode()


class CoreError(KincalError):
    """The flight core refused; `.status` is its kc_status_t."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(f"{what}: {status_name(status)}")
        self.status = status


def check(status: int, what: str) -> None:
    """Raise CoreError unless the status is KC_OK."""
    if status != 0:
        raise CoreError(status, what)


# --------------------------------------------------------------------------- arrays


def doubles(values: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """C-contiguous array of doubles; of that shape if one is given."""
    a = np.ascontiguousarray(values, dtype=float)
    if shape is not None and a.shape != shape:
        raise ValueError(f"expected shape {shape}, got {a.shape}")
    return a


def ptr(a: np.ndarray) -> Any:
    """`double *` to an array's own memory (keep the array alive)."""
    ffi, _ = _load()
    return ffi.cast("double *", ffi.from_buffer(a))


def pose_rows(n: int) -> tuple[np.ndarray, Any]:
    """n kc_pose_t as rows of position and rotation matrix, (n, 12), and the pointer to the first."""
    rows = np.zeros((n, 12))
    return rows, _load()[0].cast("kc_pose_t *", ptr(rows))


def view(field: Any, *shape: int) -> np.ndarray:
    """Numpy view (no copy) on an array field of a struct, doubles; whole field or the given shape."""
    ffi, _ = _load()
    a = np.frombuffer(ffi.buffer(field), dtype=float)
    return a[: int(np.prod(shape))].reshape(shape) if shape else a


# --------------------------------------------------------------------------- rotations and poses


@dataclass(frozen=True)
class Pose:
    """Origin [m] and rotation matrix."""

    p_m: np.ndarray
    R: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.p_m
        return T


def pose_of(c_pose: Any) -> Pose:
    """Copy of a kc_pose_t."""
    return Pose(view(c_pose.p_m).copy(), view(c_pose.R, 3, 3).copy())


def c_pose(T: Pose) -> Any:
    """kc_pose_t of a pose."""
    ffi, _ = _load()
    out = ffi.new("kc_pose_t *")
    view(out.p_m)[:] = T.p_m
    view(out.R, 3, 3)[:] = T.R
    return out


def quat_from_R(R: Any) -> np.ndarray:
    """(w, x, y, z), w >= 0, of a rotation matrix; exact for half turns."""
    _, lib = _load()
    q = np.empty(4)
    lib.kc_R_to_quat(ptr(doubles(R, (3, 3))), ptr(q))
    return q


def R_from_quat(q: Any) -> np.ndarray:
    _, lib = _load()
    R = np.empty((3, 3))
    lib.kc_quat_to_R(ptr(doubles(q, (4,))), ptr(R))
    return R


def quat_mul(a: Any, b: Any) -> np.ndarray:
    _, lib = _load()
    out = np.empty(4)
    lib.kc_quat_mul(ptr(doubles(a, (4,))), ptr(doubles(b, (4,))), ptr(out))
    return out


def quat_dist_rad(a: Any, b: Any) -> float:
    """Rotation angle between two unit quaternions, 0..pi (eq. 1)."""
    _, lib = _load()
    return float(lib.kc_quat_dist_rad(ptr(doubles(a, (4,))), ptr(doubles(b, (4,)))))


def R_log(R: Any) -> np.ndarray:
    """Rotation vector [rad]."""
    _, lib = _load()
    w = np.empty(3)
    lib.kc_R_log(ptr(doubles(R, (3, 3))), ptr(w))
    return w


def R_exp(w_rad: Any) -> np.ndarray:
    _, lib = _load()
    R = np.empty((3, 3))
    lib.kc_R_exp(ptr(doubles(w_rad, (3,))), ptr(R))
    return R


def pose_residual(meas: Pose, model: Pose) -> np.ndarray:
    """(p_meas - p_model ; log(R_meas R_model^T))."""
    _, lib = _load()
    r = np.empty(6)
    lib.kc_pose_residual(c_pose(meas), c_pose(model), ptr(r))
    return r


# --------------------------------------------------------------------------- tables from dicts


def fill(struct: Any, values: Mapping[str, Any]) -> Any:
    """Set the fields of a struct from a dict by name; nested dicts and sequences go into nested
    structs and arrays (from their start), strings into char arrays. Returns the struct."""
    ffi, _ = _load()
    for name, value in values.items():
        old = getattr(struct, name)
        if isinstance(value, str):
            setattr(struct, name, value.encode())
        elif isinstance(value, Mapping):
            fill(old, value)
        elif isinstance(value, Iterable):
            items = np.asarray(value).tolist() if isinstance(value, np.ndarray) else list(value)
            if len(items) > len(old):
                raise ValueError(f"{name}: {len(items)} values, room for {len(old)}")
            for i, item in enumerate(items):
                if isinstance(item, Mapping):
                    fill(old[i], item)
                else:
                    old[i] = item
        else:
            setattr(struct, name, value)
    return struct


def arm_from(joints: Sequence[Mapping[str, Any]], **fields: Any) -> Any:
    """kc_arm_t from one dict per joint (field names of kc_joint_t) and the arm's other fields.

    >>> arm = arm_from([{"a_m": 0.5, "q_min": -2, "q_max": 2}], tool_xyz_m=(0, 0, 0.1))
    """
    ffi, lib = _load()
    arm = ffi.new("kc_arm_t *")
    common = {
        "name": "arm",
        "base_quat_wxyz": (1, 0, 0, 0),
        "tool_quat_wxyz": (1, 0, 0, 0),
        "gravity_m_s2": (0, 0, -9.81),
        "n_joints": len(joints),
    }
    fill(arm, common | {"joint": [{"speed_max": 1.0} | dict(j) for j in joints]} | fields)
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    status = lib.kc_arm_validate(arm, index, got)
    check(status, f"arm, joint index {index[0]}, value {got[0]}")
    return arm


def basis(
    fn: str = "lin", var: str = "one", index: int = 0, c0: float = 0.0, c1: float = 1.0
) -> dict[str, Any]:
    """kc_basis_t as a dict; names as in kc_terms.h without their prefix, any case."""
    _, lib = _load()
    return {
        "fn": getattr(lib, f"KC_FN_{fn.upper()}"),
        "var": getattr(lib, f"KC_VAR_{var.upper()}"),
        "index": index,
        "c0": c0,
        "c1": c1,
    }


def term(coef: int, frame: int, comp: str, *bases: Mapping[str, Any], gain: float = 1.0) -> dict[str, Any]:
    """kc_term_t as a dict: comp "tx" .. "rz", up to two bases (missing ones are 1)."""
    _, lib = _load()
    both = [dict(b) for b in bases] + [basis()] * (2 - len(bases))
    return {
        "coef": coef,
        "frame": frame,
        "comp": getattr(lib, f"KC_{comp.upper()}"),
        "gain": gain,
        "basis": both,
    }


def terms_from(
    coefs: Sequence[Mapping[str, Any] | str], terms: Sequence[Mapping[str, Any]], n_joints: int
) -> Any:
    """kc_terms_t from coefficients (a name, or a dict of kc_coef_t fields) and terms."""
    ffi, lib = _load()
    out = ffi.new("kc_terms_t *")
    common = {"lb": -10.0, "ub": 10.0, "scale": 0.01, "enabled": 1}
    named = [{"name": c} if isinstance(c, str) else dict(c) for c in coefs]
    fill(
        out,
        {
            "n_coef": len(named),
            "n_term": len(terms),
            "coef": [common | c for c in named],
            "term": list(terms),
        },
    )
    index, got = ffi.new("int32_t *"), ffi.new("double *")
    status = lib.kc_terms_validate(out, n_joints, index, got)
    check(status, f"terms, index {index[0]}, value {got[0]}")
    return out


def dh_terms(n_joints: int, bound: Sequence[float] = (3.2, 3.2, 0.5, 0.5)) -> Any:
    """kc_terms_t with the 4 n DH errors."""
    ffi, lib = _load()
    out = ffi.new("kc_terms_t *")
    check(lib.kc_terms_add_dh(out, n_joints, ffi.new("double[4]", [float(b) for b in bound])), "DH terms")
    return out


# --------------------------------------------------------------------------- model


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
    ffi, _ = _load()
    ctx = ffi.new("kc_ctx_t *")
    return fill(ctx, {"g_m_s2": list(arm.gravity_m_s2), "q": doubles(q, (arm.n_joints,))} | fields)


def fk(arm: Any, q: Any) -> Pose:
    """Nominal forward kinematics."""
    ffi, lib = _load()
    T = ffi.new("kc_pose_t *")
    lib.kc_arm_fk(arm, ptr(doubles(q, (arm.n_joints,))), T)
    return pose_of(T)


class Model:
    """An arm with correction terms: poses, loads and Jacobians. Owns its work space; not for threads."""

    def __init__(self, arm: Any, terms: Any) -> None:
        ffi, _ = _load()
        self.arm, self.terms = arm, terms
        self._loads, self._eval = ffi.new("kc_loads_t *"), ffi.new("kc_eval_t *")

    def _coef(self, coef: Any) -> np.ndarray:
        n = int(self.terms.n_coef)
        return np.zeros(n) if coef is None else doubles(coef, (n,))

    def loads(self, q: Any, coef: Any = None, **ctx: Any) -> Loads:
        _, lib = _load()
        n = self.arm.n_joints
        lib.kc_model_loads(
            self.arm, self.terms, ptr(self._coef(coef)), context(self.arm, q, **ctx), self._loads
        )
        out = self._loads
        return Loads(
            view(out.tau, n).copy(), view(out.tau_payload, n).copy(), view(out.moment, n + 1, 3).copy()
        )

    def eval(self, q: Any, coef: Any = None, *, want_J: bool = True, **ctx: Any) -> Eval:
        """Pose and derivatives at the loads of the same coefficients. ctx: fields of kc_ctx_t."""
        ffi, lib = _load()
        c, x = self._coef(coef), context(self.arm, q, **ctx)
        lib.kc_model_loads(self.arm, self.terms, ptr(c), x, self._loads)
        lib.kc_model_eval(self.arm, self.terms, ptr(c), x, self._loads, int(want_J), self._eval)
        ev = self._eval
        J = view(ev.J, int(self.terms.n_coef), 6).copy() if want_J else None
        twist = view(ev.twist, int(lib.KC_FRAME_COUNT), 6, 6).copy() if want_J else None
        return Eval(pose_of(ev.T), view(ev.Jq, self.arm.n_joints, 6).copy(), J, twist)

    def residual(self, obs: Any, coef: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """r (6 or 3) of a kc_obs_t and J (n_coef, same) with r(coef + x) ~ r - J' x."""
        _, lib = _load()
        c, r = self._coef(coef), np.zeros(6)
        ctx = _load()[0].addressof(obs, "ctx")
        lib.kc_model_loads(self.arm, self.terms, ptr(c), ctx, self._loads)
        rows = lib.kc_model_residual(self.arm, self.terms, ptr(c), obs, self._loads, ptr(r), self._eval)
        J = view(self._eval.J, int(self.terms.n_coef), 6).copy()
        return r[:rows], J[:, :rows]


# --------------------------------------------------------------------------- box QP


@dataclass(frozen=True)
class QpResult:
    status: int
    x: np.ndarray
    active: np.ndarray  # -1 at lower, 0 free, 1 at upper
    kkt: float
    iters: int


def qp_solve(H: Any, g: Any, lb: Any, ub: Any, x0: Any = None) -> QpResult:
    """Minimise 1/2 x'Hx + g'x in the box, by the flight solver."""
    ffi, lib = _load()
    H = doubles(H)
    n = len(H)
    qp = ffi.new("kc_qp_t *")
    qp.n = n
    view(qp.H, lib.KC_COEF_MAX, lib.KC_COEF_MAX)[:n, :n] = H
    for name, value in (("g", g), ("lb", lb), ("ub", ub), ("x", 0.0 if x0 is None else x0)):
        view(getattr(qp, name))[:n] = value
    status = lib.kc_qp_solve(qp)
    side = np.array([{0: 0, 1: -1, 2: 1}[qp.active[i]] for i in range(n)])
    return QpResult(status, view(qp.x, n).copy(), side, float(qp.kkt), int(qp.iters))
