"""A fitted model: its numbers, what it predicts, and what it takes to use it elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal import __version__
from kincal.export import CalibratedArm, Exported, calibrated_fit
from kincal.export import export as export_files
from kincal.export.files import Format
from kincal.export.source import describe, python_source
from kincal.export.urdf import urdf
from kincal.flight import Observations
from kincal.rotations import Pose
from kincal.workbench.comparison.fitrecord import fit_record, fitted
from kincal.workbench.comparison.fitting import FitResult
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.diagnosis.unnamed_effects import find_unnamed
from kincal.workbench.model.effects import Library
from kincal.workbench.model.modelfile import ModelFile, write_model
from kincal.workbench.numerics.types import Progress, no_progress
from kincal.workbench.report.answers import fit_text
from kincal_shared.errors import BadInput
from kincal_shared.schema.model import UnnamedEntry

from . import html
from .case import Case
from .inputs import Arm, Data, checked, files_of, measurements

Floats = NDArray[np.float64]

# Drivers of the exported code -> columns of observations, where the names differ.
_COLUMNS = {"gravity_m_s2": "g_m_s2", "sensor_xyz_m": "cam_p_m", "sensor_wxyz": "cam_quat_wxyz"}
_PASSES = 3  # until what depends on where the sensor sees the tool is settled to rounding


@dataclass(frozen=True)
class Fitted:
    """A fitted model. `result` holds all numbers of the fit; files: measurements it was fitted to; unnamed:
    terms of the unnamed effects; libraries: files of effects of one's own."""

    arm: Arm
    result: FitResult
    files: tuple[Path, ...] = ()
    unnamed: Mapping[str, UnnamedEntry] = field(default_factory=dict)
    libraries: tuple[Path, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """(k) coefficients."""
        return self.result.names

    @property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Coefficient -> value, standard error, unit."""
        r = self.result
        rows = zip(r.names, r.estimate, r.std_err, r.units, strict=True)
        return {name: (float(value), float(std_err), unit) for name, value, std_err, unit in rows}

    @property
    def covariance(self) -> Floats:
        """(k, k) covariance of the coefficients, in their units."""
        return self.result.fit.cov

    @cached_property
    def calibrated(self) -> CalibratedArm:
        """The fitted arm as plain numbers."""
        return calibrated_fit(self.result.fit, fit_record(self.result, self.files, __version__))

    def residuals(self, data: Data | Measurements | None = None) -> Floats:
        """(N, c) measured - model, base frame [m, rad], c = 6 or 3 without orientations; of the poses that
        were fitted, or of others; those of another session without effects of the fitted session (drift)."""
        if data is None:
            return self.result.fit.evaluation.r
        return self.result.fit.predict(measurements(self.arm, data))

    def predict(self, q: ArrayLike, **drivers: ArrayLike) -> Pose:
        """Tool in the base frame at joint readings q (N, n) [rad or m], N poses; (n,) gives one.

        drivers: what else the effects depend on (direction, temp_c ...), one value for all poses or one for
        each. BadInput names a driver that is missing.
        """
        joints = np.atleast_2d(np.asarray(q, dtype=float))
        columns = {"q": joints, **self._columns(drivers, len(joints))}
        pose = Pose(np.zeros((len(joints), 3)), np.tile(np.eye(3), (len(joints), 1, 1)))
        for _ in range(_PASSES):
            columns |= {"p_m": pose.p_m, "quat_wxyz": pose.quat_wxyz}
            seen = Observations.of_columns(columns, self.arm.table.gravity_m_s2)
            pose = self.result.fit.model.at(seen).poses(self.result.estimate)
        return pose if np.ndim(q) > 1 else pose[0]

    def correct(self, q: ArrayLike, **drivers: ArrayLike) -> Floats:
        """Joint readings that bring the real tool to where the nominal arm, in the base and tool frame that
        were found, has it at q (N, n) or (n,); the position only where no orientations were measured.
        drivers: the same for all. BadInput if that is not reached."""
        joints = np.asarray(q, dtype=float)
        solve: Callable[..., Floats] = self._code.correct
        try:
            rows = [solve(row, **drivers) for row in np.atleast_2d(joints)]
        except ValueError as error:
            raise BadInput(str(error), todo="leave out readings that the arm cannot correct") from None
        return np.array(rows).reshape(joints.shape)

    def to_urdf(self) -> str:
        """A URDF with the corrected origins; effects that it cannot hold are named in a comment."""
        return urdf(self.calibrated)

    def export(self, form: Format, path: str | Path) -> Exported:
        """Write dh, json, urdf, python or c. BadInput for a wrong suffix."""
        return export_files(self.calibrated, form, path, keep=self.files)

    def save(self, path: str | Path) -> None:
        """Write the model file M.toml, for the commands."""
        libraries = tuple(str(path.resolve()) for path in self.libraries)
        model = replace(ModelFile.of(self.result.texts), unnamed=dict(self.unnamed), libraries=libraries)
        arm = self.arm.table.source
        named = str(Path(arm).resolve()) if Path(arm).is_file() else arm
        write_model(path, fitted(model, self.result, arm=named, files=self.files, version=__version__))

    def __str__(self) -> str:
        """What `kincal model fit` prints."""
        return fit_text(self.result)

    def _repr_html_(self) -> str:
        rows = [
            (m.model, html.mm(m.pos_m), html.mm(m.rot_rad)) for m in self.result.nested.of("held-out poses")
        ]
        values = [(n, f"{v:.6g}", f"{s:.2g}", u) for n, (v, s, u) in self.parameters.items()]
        return html.table(("model", "held-out mm", "mrad"), rows, self.arm.name) + html.table(
            ("coefficient", "value", "std err", "unit"), values
        )

    @cached_property
    def _code(self) -> ModuleType:
        """The exported Python code: what is used here is what is taken away."""
        module = ModuleType("kincal_calibrated")
        exec(compile(python_source(self.calibrated), "calibrated.py", "exec"), vars(module))
        return module

    def _columns(self, given: dict[str, ArrayLike], n: int) -> dict[str, Floats]:
        """Drivers as columns of n rows, those with a default filled in."""
        known = {driver.name: driver for driver in describe(self.calibrated, "python").drivers}
        unknown = [name for name in given if name not in known]
        missing = [name for name, driver in known.items() if driver.default is None and name not in given]
        if unknown or missing:
            raise BadInput(
                f"drivers missing: {', '.join(missing) or 'none'}; unknown: {', '.join(unknown) or 'none'}",
                todo=f"the model depends on {', '.join(known) or 'the joints alone'}",
            )
        out: dict[str, Floats] = {}
        for name, driver in known.items():
            value: Any = given.get(name, driver.default if driver.size else (driver.default or (0.0,))[0])
            shape = (n, driver.size) if driver.size else (n,)
            out[_COLUMNS.get(name, name)] = np.broadcast_to(np.asarray(value, dtype=float), shape).copy()
        return out


def fit(
    arm: Arm,
    data: Data | Measurements,
    effects: Sequence[str] = (),
    *,
    force: bool = False,
    progress: Progress = no_progress,
    effect_files: Sequence[Path] = (),
) -> Fitted:
    """Fit DH errors, base and tool frame as the arm table says, and these effects, also unnamed ones
    ("unnamed[joint 1: q3]"), whose terms are chosen from the data; "unnamed" alone: as many as pay.
    effect_files: libraries of effects of one's own. Errors as `kincal.workbench.fit`, and BadInput if
    arm and data do not belong together, unless forced."""
    read, library = checked(arm, data, force), Library.load(*effect_files)
    found = find_unnamed(arm.table, read, effects, library=library, progress=progress)
    entries = [addition.effect.entry() for addition in found.additions]
    case = Case(arm.table, read, found.names, library=library.with_unnamed(entries))
    result = case.fit(progress)
    return Fitted(arm, result, files_of(data), {entry.name: entry for entry in entries}, tuple(effect_files))
