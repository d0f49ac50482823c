"""Ground arrays through the flight model: residuals, Jacobians, twists and bases from the core library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kincal import core
from kincal.errors import CannotAnswer

from .arms import ArmTable, quat_to_matrix
from .basis import VARIABLES, Basis
from .data import Measurements
from .effects import Parameter

N_FRAMES = 12
MAX_COEF = 64
MAX_TERM = 160
_VIEW_PASSES = 2  # a scale error of 1 % moves the view by 1 % of 1 %: the second pass is exact enough


def _set(target, values) -> None:
    for i, value in enumerate(values):
        target[i] = float(value)


def matrix_to_quat(rotation: np.ndarray) -> np.ndarray:
    out = core.ffi.new("double[4]")
    core.lib.kc_R_to_quat(core.ffi.new("double[9]", [float(x) for x in rotation.ravel()]), out)
    return np.array(list(out))


@dataclass(frozen=True)
class Evaluation:
    """All poses at one set of coefficients. r, J are in the base frame, not whitened.

    r: (N, c) residual measured - model; J: (N, c, k) = d(model - measured)/d coefficient;
    twist: (N, 72, c) the same derivative for every frame x component; c = 6 or 3.
    """

    r: np.ndarray
    J: np.ndarray
    twist: np.ndarray
    Jq: np.ndarray


class Chain:
    """An arm table with base and tool frame set, and the observations of a data set.

    Builds the flight structs once; `evaluate` then costs about 20 us a pose.
    """

    def __init__(self, arm: ArmTable, data: Measurements, base: np.ndarray, tool: np.ndarray):
        self.arm, self.data = arm, data
        self.c_arm = _c_arm(arm, base, tool)
        self.n = data.n
        self.components = data.components
        self._obs = core.ffi.new("kc_obs_t[]", self.n)
        for i in range(self.n):
            _fill_obs(self._obs[i], arm, data, i)
        self._loads = core.ffi.new("kc_loads_t[]", self.n)
        # Pointers once: taking an address costs more than the call that uses it.
        address = core.ffi.addressof
        self._each = [
            (address(self._obs, i), address(self._obs[i], "ctx"), address(self._loads, i))
            for i in range(self.n)
        ]
        self._p_cam = np.zeros((self.n, 3)) if data.cam_p_m is None else data.cam_p_m
        self._R_cam = np.tile(np.eye(3), (self.n, 1, 1))
        if data.cam_quat_wxyz is not None:
            self._R_cam = np.array([quat_to_matrix(q) for q in data.cam_quat_wxyz])
        self._has_pixels = data.u_px is not None and data.v_px is not None and arm.camera is not None
        self._eval = core.ffi.new("kc_eval_t *")
        self._r = core.ffi.new("double[6]")

    def terms(self, parameters: Sequence[tuple[str, Parameter]]):
        """A flight term table of these coefficients (name, parameter), no bounds, all enabled."""
        if len(parameters) > MAX_COEF:
            raise CannotAnswer(
                f"the model has {len(parameters)} coefficients, flight carries at most {MAX_COEF}; "
                "remove an effect"
            )
        table = core.ffi.new("kc_terms_t *")
        k = 0
        for c, (name, parameter) in enumerate(parameters):
            fill_coef(table.coef[c], name, parameter)
            for term in parameter.terms:
                if k == MAX_TERM:
                    raise CannotAnswer(f"the model has more than {MAX_TERM} terms; remove an effect")
                fill_term(table.term[k], c, term)
                k += 1
        table.n_coef, table.n_term = len(parameters), k
        return table

    def loads(self, terms, coef: np.ndarray) -> None:
        """Re-evaluate what terms depend on at these coefficients (held until the next call): gravity
        loads, and where the sensor should see the tool."""
        c_coef = core.ffi.new("double[64]", [float(x) for x in coef])
        for _, ctx, loads in self._each:
            core.lib.kc_model_loads(self.c_arm, terms, c_coef, ctx, loads)
        for _ in range(_VIEW_PASSES if self._looks(terms) else 1):
            self._view(terms, c_coef)

    @staticmethod
    def _looks(terms) -> bool:
        """Whether a term depends on where the sensor sees the tool."""
        number = {VARIABLES[name][0] for name in ("u", "v", "r2", "xcam", "ycam", "zcam")}
        return any(b.var in number for k in range(terms.n_term) for b in terms.term[k].basis)

    def _view(self, terms, c_coef) -> None:
        """Position in the sensor frame as the model expects it. The measured one would carry the noise of
        the residual into the columns, and a wrong scale could shrink the residual itself."""
        buf_r = np.frombuffer(core.ffi.buffer(self._r), dtype=float)
        for i, (obs, ctx, loads) in enumerate(self._each):
            core.lib.kc_model_residual(self.c_arm, terms, c_coef, obs, loads, self._r, self._eval)
            seen = self._R_cam[i].T @ (self.data.p_m[i] - buf_r[:3] - self._p_cam[i])
            ctx.p_cam_tool_m[0], ctx.p_cam_tool_m[1], ctx.p_cam_tool_m[2] = seen
            if not self._has_pixels and seen[2] > 0.0:
                ctx.u_norm, ctx.v_norm = seen[0] / seen[2], seen[1] / seen[2]

    def evaluate(self, terms, coef: np.ndarray) -> Evaluation:
        """Residuals and derivatives of every pose at the coefficients, loads as last set."""
        k, c = terms.n_coef, self.components
        r = np.empty((self.n, c))
        jacobian = np.empty((self.n, c, k))
        twist = np.empty((self.n, N_FRAMES * 6, c))
        jq = np.empty((self.n, c, self.arm.n))
        c_coef = core.ffi.new("double[64]", [float(x) for x in coef])
        ev = self._eval
        buf_j = np.frombuffer(core.ffi.buffer(ev.J), dtype=float).reshape(MAX_COEF, 6)
        buf_t = np.frombuffer(core.ffi.buffer(ev.twist), dtype=float).reshape(N_FRAMES * 6, 6)
        buf_q = np.frombuffer(core.ffi.buffer(ev.Jq), dtype=float).reshape(-1, 6)
        buf_r = np.frombuffer(core.ffi.buffer(self._r), dtype=float)
        for i, (obs, _, loads) in enumerate(self._each):
            core.lib.kc_model_residual(self.c_arm, terms, c_coef, obs, loads, self._r, ev)
            r[i] = buf_r[:c]
            jacobian[i] = buf_j[:k, :c].T
            twist[i] = buf_t[:, :c]
            jq[i] = buf_q[: self.arm.n, :c].T
        return Evaluation(r, jacobian, twist, jq)

    def basis_values(self, basis: Basis) -> np.ndarray:
        """(N,) values of a basis, by flight's own code."""
        c_basis = core.ffi.new("kc_basis_t *")
        fill_basis(c_basis, basis)
        evaluate = core.lib.kc_basis_eval
        return np.array([evaluate(c_basis, ctx, loads) for _, ctx, loads in self._each])


def _c_arm(arm: ArmTable, base: np.ndarray, tool: np.ndarray):
    out = core.ffi.new("kc_arm_t *")
    out.name = arm.name.encode("ascii", "replace")[:23]
    out.n_joints = arm.n
    for i, joint in enumerate(arm.joints):
        row = out.joint[i]
        row.type = int(joint.prismatic)
        row.phi_rad, row.alpha_rad, row.a_m, row.d_m = joint.phi_rad, joint.alpha_rad, joint.a_m, joint.d_m
        row.q_min, row.q_max, row.speed_max = joint.q_min, joint.q_max, 1.0
        row.has_mass = int(arm.has_masses)
        if arm.has_masses:
            row.mass_kg = joint.mass_kg
            _set(row.com_m, joint.com_m)
        row.gear_ratio = joint.gear_ratio or 0.0
    for frame, xyz, quat in (
        (base, out.base_xyz_m, out.base_quat_wxyz),
        (tool, out.tool_xyz_m, out.tool_quat_wxyz),
    ):
        _set(xyz, frame[:3, 3])
        _set(quat, matrix_to_quat(frame[:3, :3]))
    _set(out.gravity_m_s2, arm.gravity_m_s2)
    return out


def _fill_obs(obs, arm: ArmTable, data: Measurements, i: int) -> None:
    ctx = obs.ctx
    _set(ctx.q, data.q[i])
    if data.direction is not None:
        _set(ctx.dir, data.direction[i])
    if data.qdot is not None:
        _set(ctx.qdot, data.qdot[i])
    _set(ctx.g_m_s2, arm.gravity_m_s2 if data.g_m_s2 is None else data.g_m_s2[i])
    for name in ("temp_c", "t_s", "payload_kg", "range_m", "incid_rad", "pan_rad", "tilt_rad", "tag"):
        values = getattr(data, name)
        if values is not None:
            setattr(ctx, name, float(values[i]))
    _set(obs.p_m, data.p_m[i])
    obs.has_rot = int(data.quat_wxyz is not None)
    _set(obs.q_wxyz, data.quat_wxyz[i] if data.quat_wxyz is not None else (1.0, 0.0, 0.0, 0.0))
    # without camera columns the sensor is the measurement frame itself
    obs.has_cam = 1
    _set(obs.q_cam_wxyz, (1.0, 0.0, 0.0, 0.0))
    _set(ctx.p_cam_tool_m, data.p_m[i])
    if data.cam_p_m is not None:
        _set(obs.p_cam_m, data.cam_p_m[i])
        _set(obs.q_cam_wxyz, data.cam_quat_wxyz[i])
        seen = quat_to_matrix(data.cam_quat_wxyz[i]).T @ (data.p_m[i] - data.cam_p_m[i])
        _set(ctx.p_cam_tool_m, seen)
        ctx.u_norm, ctx.v_norm = _image(arm, data, i, seen)
    cov = np.eye(6) if data.cov is None else data.cov[i]
    _set(obs.cov, cov.ravel())


def _image(arm: ArmTable, data: Measurements, i: int, seen: np.ndarray) -> tuple[float, float]:
    """Normalised image position: from the pixels if the camera is known, else from the ray itself."""
    if data.u_px is not None and data.v_px is not None and arm.camera is not None:
        cam = arm.camera
        return (data.u_px[i] - cam.cx_px) / cam.fx_px, (data.v_px[i] - cam.cy_px) / cam.fy_px
    if seen[2] <= 0.0:
        return 0.0, 0.0
    return seen[0] / seen[2], seen[1] / seen[2]


def fill_coef(coef, name: str, parameter: Parameter, bound: float = 1e3) -> None:
    coef.name = name.encode("ascii", "replace")[:23]
    coef.lb, coef.ub = -bound, bound
    coef.prior_sigma, coef.scale = parameter.sigma, parameter.sigma
    coef.enabled = 1


def fill_basis(out, basis: Basis) -> None:
    out.fn, out.var, out.index = basis.fn_number, basis.var_number, basis.index
    out.c0, out.c1 = basis.c0, basis.c1


def fill_term(out, coef: int, term) -> None:
    out.coef, out.frame, out.comp, out.gain = coef, term.frame, term.comp, term.gain
    for i, basis in enumerate(term.basis):
        fill_basis(out.basis[i], basis)


def nominal_chain(arm: ArmTable, data: Measurements) -> np.ndarray:
    """(N, 4, 4) chain T_01 .. T_{n-1,n} of the nominal arm, without base and tool frame."""
    identity = np.eye(4)
    c_arm = _c_arm(arm, identity, identity)
    pose = core.ffi.new("kc_pose_t *")
    out = np.tile(np.eye(4), (data.n, 1, 1))
    for i in range(data.n):
        core.lib.kc_arm_fk(c_arm, core.ffi.new("double[8]", [float(x) for x in data.q[i]]), pose)
        out[i, :3, :3] = np.array(list(pose.R)).reshape(3, 3)
        out[i, :3, 3] = list(pose.p_m)
    return out
