"""What the tests of exports share: models of every kind, and generated code loaded again."""

from __future__ import annotations

import ctypes
import importlib.util
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kincal import workbench as wb
from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal.workbench.fit.least_squares import fit_model
from kincal.workbench.model.effects import Hypothesis, Parameter, Term

FRAMES = {"tool": FRAME_TOOL, "camera": FRAME_CAMERA, "meas": FRAME_MEAS}
WARNINGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion",
            "-Werror", "-ffp-contract=off")  # fmt: skip


def python_module(path: Path):
    """The generated Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class CModule:
    """The generated C source, compiled without a warning, called as the generated Python is."""

    def __init__(self, path: Path, prefix: str, drivers: list[tuple[str, int]], n: int) -> None:
        so = path.with_suffix(".so")
        subprocess.run(["gcc", *WARNINGS, "-shared", "-fPIC", "-O2", "-o", so, path, "-lm"], check=True)
        self.lib, self.prefix, self.n, self.names = ctypes.CDLL(str(so)), prefix, n, drivers
        fields = [(name, ctypes.c_double * size if size else ctypes.c_double) for name, size in drivers]
        if any(name == "image" for name, _ in drivers):
            fields.insert(-1, ("has_image", ctypes.c_int))
        self.struct = type("Drivers", (ctypes.Structure,), {"_fields_": fields or [("none", ctypes.c_int)]})
        pose = [("p", ctypes.c_double * 3), ("R", ctypes.c_double * 9)]
        self.pose = type("Pose", (ctypes.Structure,), {"_fields_": pose})

    def drivers(self, given):
        out = self.struct.from_buffer_copy(self.struct.in_dll(self.lib, f"{self.prefix}_defaults"))
        for name, size in self.names:
            if given.get(name) is not None:
                value = (ctypes.c_double * size)(*given[name]) if size else float(given[name])
                setattr(out, name, value)
                if name == "image":
                    out.has_image = 1
        return ctypes.byref(out)

    def _q(self, q):
        return (ctypes.c_double * self.n)(*q)

    def _matrix(self, pose):
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = np.array(pose.R).reshape(3, 3), pose.p
        return out

    def _call(self, name, *arguments):
        pose = self.pose()
        getattr(self.lib, f"{self.prefix}_{name}")(*arguments, ctypes.byref(pose))
        return self._matrix(pose)

    def forward(self, q, **d):
        return self._call("forward", self._q(q), self.drivers(d))

    def measured(self, q, **d):
        return self._call("measured", self._q(q), self.drivers(d))

    def nominal(self, q):
        return self._call("nominal", self._q(q))

    def inverse(self, p_m, R, q, **d):
        goal, joints = self.pose(), self._q(q)
        goal.p[:] = list(p_m)
        goal.R[:] = list(np.eye(3).ravel() if R is None else np.ravel(R))
        reached = getattr(self.lib, f"{self.prefix}_inverse")(
            ctypes.byref(goal), int(R is not None), self.drivers(d), joints
        )
        return np.array(joints), bool(reached)

    def correct(self, q, **d):
        joints = self._q(q)
        reached = getattr(self.lib, f"{self.prefix}_correct")(self._q(q), self.drivers(d), joints)
        return np.array(joints), bool(reached)


def random_data(arm, seed: int, count: int = 12, **columns):
    """Measurements of random joints with every column; what was measured is filled in by the test."""
    rng = np.random.default_rng(seed)
    low, high = np.array([[max(j.q_min, -3.0), min(j.q_max, 3.0)] for j in arm.joints]).T
    n = arm.n
    turns = Rotation.random(count, random_state=np.random.RandomState(seed))
    all_columns = {
        "direction": rng.choice([-1.0, 1.0], (count, n)), "qdot": rng.normal(0, 0.5, (count, n)),
        "temp_c": rng.uniform(-10, 40, count), "t_s": np.sort(rng.uniform(0, 3600, count)),
        "payload_kg": rng.uniform(0, 5, count), "g_m_s2": rng.normal([0, 0, -9.0], 1.0, (count, 3)),
        "range_m": rng.uniform(0.5, 2, count), "incid_rad": rng.uniform(0, 1.6, count),
        "pan_rad": rng.uniform(-1, 1, count), "tilt_rad": rng.uniform(-1, 1, count),
        "tag": rng.choice([0.0, 0.5, 1.0], count), "cam_p_m": rng.normal([0, 0, -2.5], 0.1, (count, 3)),
        "cam_quat_wxyz": Rotation.from_rotvec(rng.normal(0, 0.2, (count, 3))).as_quat(scalar_first=True),
        "move": rng.normal(0, 1.0, (count, n)),
    }  # fmt: skip
    kept = {k: v for k, v in all_columns.items() if columns.get(k, True)}
    return wb.Measurements(
        source="random", ids=tuple(map(str, range(count))), q=rng.uniform(low, high, (count, n)),
        p_m=rng.normal(0, 0.5, (count, 3)), quat_wxyz=turns.as_quat(scalar_first=True), **kept,
    )  # fmt: skip


def drivers_at(data, i, wanted) -> dict:
    """Drivers of the generated code at pose i, of those that it takes."""
    columns = {
        "direction": data.direction, "qdot": data.qdot, "temp_c": data.temp_c, "t_s": data.t_s,
        "payload_kg": data.payload_kg, "gravity_m_s2": data.g_m_s2, "range_m": data.range_m,
        "incid_rad": data.incid_rad, "pan_rad": data.pan_rad, "tilt_rad": data.tilt_rad, "tag": data.tag,
        "sensor_xyz_m": data.cam_p_m, "sensor_wxyz": data.cam_quat_wxyz, "move": data.move,
    }  # fmt: skip
    return {name: column[i] for name, column in columns.items() if column is not None and name in wanted}


def hypothesis(name: str, *terms: tuple) -> Hypothesis:
    """An effect of given terms (frame, comp, gain, basis, basis), one coefficient each."""
    parameters = tuple(
        Parameter(f"c{k}", "1", 1e-3, (Term(FRAMES.get(frame, frame), comp, gain, (b1, b2)),))
        for k, (frame, comp, gain, b1, b2) in enumerate(terms)
    )
    return Hypothesis(name, name, parameters)


def unfitted(arm, data, hypotheses, seed: int = 3):
    """A `Fit` whose coefficients are random, of a realistic size: what exports must reproduce."""
    rng = np.random.default_rng(seed)
    fit = fit_model(arm, data, hypotheses, robust=False)
    sizes = np.array([0.02 if p.unit == "rad" else 0.01 if p.unit == "m" else 1e-3 for p in fit.parameters])
    return replace(fit, estimate=rng.normal(0, 1, len(fit.names)) * sizes)
