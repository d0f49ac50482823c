"""Calibrations of measured real arms: least squares of DH errors, base and tool, and what is left on poses
that were held out.

All fit the same poses, from the nominal arm and from the same base and tool frames, and are judged by the
same held-out poses. scipy is given a vectorised model in numpy, with derivatives by differences and as
formulas. figaroh is called as its documentation says: its own parameters, its own frames. diagnose is no fit:
it looks for effects beyond DH errors, hundreds of models long; nobody else has one."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.rotations import matrix_of_wxyz
from kincal.workbench.data.split import choose_split
from kincal.workbench.fit.least_squares import find_frames, fit_model

from .build import OUT, ROOT
from .measure import OURS, Growth, Timed, growth, in_turn, timed

Array = np.ndarray
SETS = ("wam/wam", "fr3/fr3", "ur5/ur5", "ur10/ur10d")
BY_DIFFERENCES = SETS[:2]  # parallel axes make a valley, along which derivatives by differences take minutes
MOST_POSES = 300  # of a set
REPEATED_S = 3.0  # what takes longer is measured once
SIGMA = np.array([1e-3] * 3 + [3e-3] * 3)  # what errors of position [m] and orientation [rad] are worth
ALONE = "KinCal, frames too"
DIAGNOSE = "KinCal diagnose"
DIFFERENCES, FORMULAS, FIGAROH = "scipy, differences", "scipy, formulas", "figaroh"


@dataclass(frozen=True)
class Set:
    """Measurements of an arm: those that are fitted, and those that are held out."""

    name: str
    arm: wb.ArmTable
    data: wb.Measurements
    part: wb.Measurements
    held: wb.Measurements


@cache
def read(name: str, most: int = MOST_POSES) -> Set:
    """A set of docs/data, every so-manieth pose if there are more."""
    folder = ROOT / "docs" / "data" / Path(name).parent
    arm = wb.read_arm(folder / f"{folder.name}.toml")
    data = wb.read_measurements(folder / f"{Path(name).name}.csv", arm)
    if data.n > most:
        data = data.take(np.linspace(0, data.n - 1, most).astype(int))
    split = choose_split(data)
    return Set(folder.name, arm, data, data.take(split.fit), data.take(split.held))


@dataclass(frozen=True)
class Outcome:
    """Held-out error of a fit: RMS position [m]; rotation [rad] or None."""

    pos_m: float
    rot_rad: float | None

    @classmethod
    def of(cls, r: Array) -> Outcome:
        """From residuals (N, 3 or 6)."""
        rot = float(np.sqrt((r[:, 3:] ** 2).sum(axis=1).mean())) if r.shape[1] == 6 else None
        return cls(float(np.sqrt((r[:, :3] ** 2).sum(axis=1).mean())), rot)


# ---- ours


def ours(s: Set, frames: Any) -> Outcome:
    """The fit, its held-out error."""
    return Outcome.of(fit_model(s.arm, s.part, frames=frames).predict(s.held))


def diagnosed(s: Set) -> Outcome:
    """What the model with all effects that were found leaves."""
    left = wb.diagnose(s.arm, s.data, wb.Library.load()).remainder
    return Outcome(left.held_pos_m, left.held_rot_rad)


# ---- scipy


@dataclass(frozen=True)
class Numpy:
    """The arm in numpy, many poses at once. x: 4 n DH errors, six numbers each (position, rotation vector)
    of base and tool. dh: (n, 4) phi, alpha, a, d; base, tool: where they start, (4, 4)."""

    dh: Array
    prismatic: Array
    base: Array
    tool: Array
    q: Array
    p_m: Array
    R: Array | None

    @classmethod
    def of(cls, s: Set, data: wb.Measurements, frames: Any) -> Numpy:
        """From the nominal arm."""
        dh = np.array([[j.phi_rad, j.alpha_rad, j.a_m, j.d_m] for j in s.arm.joints])
        slides = np.array([j.prismatic for j in s.arm.joints])
        base, tool = (_matrix(f.p_m, f.R) for f in frames)
        R = None if data.quat_wxyz is None else matrix_of_wxyz(data.quat_wxyz)
        return cls(dh, slides, base, tool, data.q, data.p_m, R)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return 4 * len(self.dh) + 12

    def frames(self, x: Array) -> tuple[Array, Array]:
        """After the base and each link, (n + 2, N, 4, 4), the last one the tool; and the base alone."""
        dh = self.dh + x[:-12].reshape(-1, 4)
        T = np.broadcast_to(self.base @ _moved(x[-12:-6]), (len(self.q), 4, 4))
        out = [T]
        for row, q, slides in zip(dh, self.q.T, self.prismatic, strict=True):
            phi, d = (row[0], row[3] + q) if slides else (row[0] + q, row[3])
            T = T @ _link(np.broadcast_to(phi, q.shape), row[1], row[2], np.broadcast_to(d, q.shape))
            out.append(T)
        out.append(T @ self.tool @ _moved(x[-6:]))
        return np.stack(out), out[0]

    def residuals(self, x: Array) -> Array:
        """Measured less model, (N, 3 or 6)."""
        end = self.frames(x)[0][-1]
        r = self.p_m - end[:, :3, 3]
        if self.R is None:
            return r
        turn = Rotation.from_matrix(self.R @ end[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
        return np.hstack([r, turn])

    def weighed(self, x: Array) -> Array:
        """As least squares takes them."""
        r = self.residuals(x)
        return (r / SIGMA[: r.shape[1]]).ravel()

    def jacobian(self, x: Array) -> Array:
        """Of `weighed`. Rotation vectors of residuals and frames are small: their exponential maps count as
        the identity."""
        F, _ = self.frames(x)
        p, columns = F[-1][:, :3, 3], []
        for j in range(len(self.dh)):
            z, o = F[j][:, :3, 2], F[j][:, :3, 3]
            across, end = F[j + 1][:, :3, 0], F[j + 1][:, :3, 3]
            columns += [_turn(z, p - o), _turn(across, p - end), _shift(across), _shift(z)]
        rows = [F[0], F[-1]]
        for T in rows:
            columns += [_shift(T[:, :3, k]) for k in range(3)]
            columns += [_turn(T[:, :3, k], p - T[:, :3, 3]) for k in range(3)]
        J = -np.stack(columns, axis=2)
        c = 3 if self.R is None else 6
        return np.asarray((J[:, :c] / SIGMA[:c, None]).reshape(-1, self.n))


def _matrix(p_m: Array, R: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p_m
    return T


def _moved(x: Array) -> Array:
    return _matrix(x[:3], Rotation.from_rotvec(x[3:]).as_matrix())


def _link(phi: Array, alpha: float, a: float, d: Array) -> Array:
    c, s, ca, sa = np.cos(phi), np.sin(phi), np.cos(alpha), np.sin(alpha)
    T = np.zeros((len(phi), 4, 4))
    T[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
    T[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
    T[:, 2, 1:3] = sa, ca
    T[:, 2, 3], T[:, 3, 3] = d, 1.0
    return T


def _turn(axis: Array, arm: Array) -> Array:
    return np.hstack([np.cross(axis, arm), axis])


def _shift(axis: Array) -> Array:
    return np.hstack([axis, np.zeros_like(axis)])


def by_scipy(s: Set, frames: Any, formulas: bool) -> Outcome:
    """Levenberg-Marquardt of MINPACK, from zero errors."""
    model = Numpy.of(s, s.part, frames)
    found = least_squares(
        model.weighed, np.zeros(model.n), model.jacobian if formulas else "2-point", method="lm"
    )
    return Outcome.of(Numpy.of(s, s.held, frames).residuals(found.x))


# ---- figaroh


def _pinocchio_model(s: Set) -> Any:
    """The nominal arm; base and tool are left to figaroh."""
    import pinocchio as pin

    model, at, parent = pin.Model(), pin.SE3.Identity(), 0
    for k, joint in enumerate(s.arm.joints, 1):
        parent = model.addJoint(parent, pin.JointModelRZ(), at, f"q{k}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
        link = _link(np.array([joint.phi_rad]), joint.alpha_rad, joint.a_m, np.array([joint.d_m]))[0]
        at = pin.SE3(link)
    model.addFrame(pin.Frame("flange", parent, at, pin.FrameType.OP_FRAME))
    return model


def _figaroh_file(data: wb.Measurements, name: str) -> Path:
    """Measurements as figaroh reads them: position and roll, pitch, yaw, then joints."""
    path, columns = OUT / name, {f"{c}1": v for c, v in zip("xyz", data.p_m.T, strict=True)}
    if data.quat_wxyz is not None:
        rpy = Rotation.from_quat(data.quat_wxyz, scalar_first=True).as_euler("xyz")
        columns |= {f"{c}1": v for c, v in zip(("phix", "phiy", "phiz"), rpy.T, strict=True)}
    columns |= {f"q{k}": v for k, v in enumerate(data.q.T, 1)}
    path.parent.mkdir(parents=True, exist_ok=True)
    header = ",".join(columns)
    np.savetxt(path, np.column_stack([*columns.values()]), delimiter=",", header=header, comments="")
    return path


def by_figaroh(s: Set) -> Outcome:
    """figaroh's calibration at its full_params level, with the residuals that its documentation shows."""
    import pinocchio as pin
    import yaml
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm

    six = s.data.quat_wxyz is not None
    config = {
        "robot": {"name": s.name},
        "tasks": {
            "calibration": {
                "enabled": True,
                "type": "kinematic_calibration",
                "kinematics": {"base_frame": "universe", "tool_frame": "flange"},
                "parameters": {"calibration_level": "full_params", "outlier_threshold": None},
                "measurements": {"markers": [{"measurable_dof": [True] * 3 + [six] * 3}]},
                "data": {
                    "source_file": str(_figaroh_file(s.part, f"{s.name}-fit.csv")),
                    "number_of_samples": s.part.n,
                },
            }
        },
    }
    path = OUT / f"{s.name}.yaml"
    path.write_text(yaml.safe_dump(config))
    model = _pinocchio_model(s)

    class Robot:
        """What figaroh takes for one."""

        def __init__(self) -> None:
            self.model, self.data, self.q0 = model, model.createData(), pin.neutral(model)

    class Calibration(BaseCalibration):
        """Weights as all others have them."""

        def cost_function(self, var: Array) -> Array:
            found = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            residuals = self._compute_logmap_residuals(self.PEE_measured, found)
            return np.asarray(self.apply_measurement_weighting(residuals, 1 / SIGMA[0], 1 / SIGMA[3]))

    calibration = Calibration(Robot(), str(path))
    calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}
    calibration.initialize()
    solution, _ = calibration.solve_optimisation()
    held = calibration.calib_config | {"NbSample": s.held.n}
    found = calc_updated_fkm(model, model.createData(), solution.x, s.held.q, held)
    kept = calibration.observations.from_csv(_figaroh_file(s.held, f"{s.name}-held.csv"), model, held)
    measured = kept.to_legacy(model, held)[0]
    calibration.calib_config = held
    r = np.asarray(calibration._compute_logmap_residuals(measured, found))
    return Outcome.of(r.reshape(-1, s.held.n).T)


def _quietly(call: Callable[[], Outcome]) -> Callable[[], Outcome]:
    """Without what it prints."""

    def quiet() -> Outcome:
        logging.getLogger("figaroh").setLevel(logging.ERROR)
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return call()

    return quiet


# ---- all of them


@dataclass(frozen=True)
class Row:
    """Programs on a set. poses: fitted, held out; seconds: median of each; error: held out."""

    name: str
    poses: tuple[int, int]
    seconds: dict[str, float]
    error: dict[str, Outcome]


def fitters(s: Set) -> dict[str, Callable[[], Outcome]]:
    """Those that take milliseconds to seconds. The frames are found beforehand, but for ALONE."""
    frames = find_frames(s.arm, s.part)
    return {
        OURS: lambda: ours(s, frames),
        ALONE: lambda: ours(s, find_frames(s.arm, s.part)),
        FORMULAS: lambda: by_scipy(s, frames, True),
        DIFFERENCES: lambda: by_scipy(s, frames, False),
    }


def row_of(name: str, rounds: int) -> Row:
    """All programs on a set."""
    s = read(name)
    work = fitters(s)
    if name not in BY_DIFFERENCES:
        del work[DIFFERENCES]
    work |= {FIGAROH: _quietly(lambda: by_figaroh(s)), DIAGNOSE: lambda: diagnosed(s)}
    error: dict[str, Outcome] = {}
    first: dict[str, float] = {}
    for who, call in work.items():
        found: list[Outcome] = []
        first[who] = timed(lambda call=call, found=found: found.append(call()))()
        error[who] = found[0]
    again = {who: timed(call) for who, call in work.items() if first[who] < REPEATED_S}
    medians = {who: float(np.median(values)) for who, values in in_turn(again, rounds, warm=0).items()}
    seconds = first | medians
    return Row(s.name, (s.part.n, s.held.n), seconds, error)


def rows(rounds: int) -> Iterator[Row]:
    """All sets."""
    for name in SETS:
        yield row_of(name, rounds)


def by_poses(rounds: int) -> Growth:
    """A large set, cut."""

    def calls_of(poses: int) -> dict[str, Timed]:
        work = fitters(read("ur10/ur10d", poses))
        return {who: timed(work[who]) for who in (OURS, FORMULAS)}

    return growth("fit", "poses", (75, 150, 300, 600), calls_of, rounds)
