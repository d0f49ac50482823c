"""What the fitted values of a model file say of other measurements: nothing is fitted to them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kincal.export import CalibratedArm
from kincal.export.calibrated import BASE, TOOL
from kincal.workbench.comparison.fitrecord import file_digest
from kincal.workbench.comparison.fitting import check_needs
from kincal.workbench.data.measurements import Measurements, at_time
from kincal.workbench.evidence.adequacy import gross
from kincal.workbench.fit.least_squares import rms
from kincal.workbench.model.effects import Library, Parameter
from kincal.workbench.model.flight_model import flight_model
from kincal.workbench.numerics.types import Array, Groups
from kincal.workbench.prediction.gain import group_means, unpaired_ratio
from kincal.workbench.prediction.nested import HELD_OUT
from kincal.workbench.prediction.reachable import PosRot
from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.model import ExpectedEntry, FitEntry

_WORST = 5
_MOST_OUTLIERS = 0.1  # of the poses: more are no bad poses, something has changed
_LEAST_COMPARED = 8  # poses: an interval of fewer is too narrow (of one it is no interval)


@dataclass(frozen=True)
class PoseError:
    """Measured minus predicted at a pose [m], [rad] (None without rotations)."""

    id: str
    pos_m: float
    rot_rad: float | None


@dataclass(frozen=True)
class Predicted:
    """Errors at N poses that no value was fitted to. nominal: of the arm table, in the base and tool frame
    that the fit found; oriented: the poses have orientations that are not compared; model: with all fitted
    values; held: the error on held-out poses when it was fitted, None if there were none; expected: the
    error that the fit said of poses in turns, else of these, as the model file has it; residuals: (N, c)
    of the model, measured minus predicted; worst: poses, the worst first; fitted: files of these measurements
    that the model was fitted to; far: number of poses that are off by far more than the others; outliers:
    their ids, none where these are too many to be bad poses; usual: as `model`, without them; ratio: position
    error without them over the expected one without outliers, with its 95 % interval, None with few poses on
    either side or where the model was fitted to these measurements; as_in_the_end: effects of time, taken
    as they were in the end of the fitted session."""

    arm: str
    source: str
    poses: int
    components: int
    oriented: bool
    skipped: int
    nominal: PosRot
    model: PosRot
    held: PosRot | None
    expected: ExpectedEntry | None
    residuals: Array
    worst: tuple[PoseError, ...]
    fitted: tuple[str, ...]
    far: int
    outliers: tuple[str, ...]
    usual: PosRot
    ratio: tuple[float, tuple[float, float]] | None
    as_in_the_end: tuple[str, ...] = ()

    @property
    def largest(self) -> PosRot:
        """Largest error of the model, position and rotation each."""
        pos, rot = _sizes(self.residuals)
        return float(pos.max()), None if rot is None else float(rot.max())


def predict(
    calibrated: CalibratedArm, data: Measurements, library: Library, files: tuple[Path, ...] = ()
) -> Predicted:
    """The errors of a fitted arm at measurements; library: of its effects; files: that the measurements were
    read from. What moved with the time of the fitted session stays where it was in the end of it.
    CannotAnswer if the data lack what an effect needs; BadInput if they are neither that session as it was
    fitted nor apart from it."""
    record = calibrated.record
    known = [entry.sha256 for entry in record.data]
    digests = [file_digest(file) for file in files]
    fitted = tuple(str(file) for file, own in zip(files, digests, strict=True) if own in known)
    if calibrated.of_session and fitted and digests != known:
        raise _of_another_clock(calibrated)
    if calibrated.of_session and not fitted:
        data = at_time(data, _end_s(calibrated))
    check_needs(library, calibrated.effects, calibrated.arm, data)
    named = [(c.name, Parameter(c.name, c.unit, c.prior_sigma, c.terms)) for c in calibrated.coefficients]
    model = flight_model(calibrated.arm, data, calibrated.base, calibrated.tool, named)
    values = np.array([c.value for c in calibrated.coefficients])
    frames = np.array([c.group in (BASE, TOOL) for c in calibrated.coefficients], dtype=bool)
    compared = slice(min(record.components, data.components))  # positions leave the tool's turn open
    residuals = model.residuals(values)[:, compared]
    held = None if record.held_mm is None else (record.held_mm * 1e-3, _scaled(record.held_mrad))
    square = np.array((residuals[:, :3] ** 2).sum(axis=1))
    far, expected = gross(square), record.expected or _of_held(record)
    bad = far if far.mean() <= _MOST_OUTLIERS else np.zeros_like(far)
    usual = ~bad
    ratio = None if expected is None or fitted else _ratio(square[usual], data.take(usual).repeats, expected)
    return Predicted(
        arm=calibrated.arm.name,
        source=data.source,
        poses=data.n,
        components=residuals.shape[1],
        oriented=data.components > residuals.shape[1],
        skipped=len(data.skipped),
        nominal=rms(model.residuals(np.where(frames, values, 0.0))[:, compared]),
        model=rms(residuals),
        held=held,
        expected=expected,
        residuals=residuals,
        worst=_worst(data, residuals),
        fitted=fitted,
        far=int(far.sum()),
        outliers=tuple(data.ids[i] for i in np.flatnonzero(bad)),
        usual=rms(residuals[usual]),
        ratio=ratio,
        as_in_the_end=() if fitted else calibrated.of_session,
    )


def _of_another_clock(calibrated: CalibratedArm) -> BadInput:
    """Why some files of a session, or all of them with others, do not tell its time: several files are put
    on one clock, which begins with the first."""
    files = ", ".join(entry.path for entry in calibrated.record.data)
    return BadInput(
        f"{', '.join(calibrated.of_session)}: follows the time of the fitted session, and these files are "
        "neither all of that session in its order nor of others alone",
        calibrated.file,
        f"name all files of the fit in its order ({files}), or only files of other sessions",
    )


def _end_s(calibrated: CalibratedArm) -> float:
    """The end of the fitted session."""
    if calibrated.record.end_s is None:
        raise CannotAnswer(
            f"{', '.join(calibrated.of_session)}: the fit does not say when its session ended, it is of an "
            "earlier version",
            calibrated.file,
            "`kincal model fit` again",
        )
    return calibrated.record.end_s


def _of_held(record: FitEntry) -> ExpectedEntry | None:
    """What a fit of an earlier version says of other poses."""
    if record.held_mm is None or not record.held:
        return None
    mm, mrad, count = record.held_mm, record.held_mrad, len(record.held)
    return ExpectedEntry(
        held_out=HELD_OUT, poses=count, distinct=count, mm=mm, mrad=mrad, usual_mm=mm, usual_mrad=mrad
    )


def _ratio(
    square: Array, groups: Groups | None, expected: ExpectedEntry
) -> tuple[float, tuple[float, float]] | None:
    """Of squared errors [m^2] to the expected one; None where few poses say little of either."""
    if min(len(group_means(square, groups)), expected.distinct) < _LEAST_COMPARED:
        return None
    return unpaired_ratio(square, expected.usual_mm * 1e-3, expected.distinct, groups)


def _scaled(mrad: float | None) -> float | None:
    return None if mrad is None else mrad * 1e-3


def _sizes(residuals: Array) -> tuple[Array, Array | None]:
    """(N,) position and rotation errors."""
    rotation = np.linalg.norm(residuals[:, 3:], axis=1) if residuals.shape[1] == 6 else None
    return np.linalg.norm(residuals[:, :3], axis=1), rotation


def _worst(data: Measurements, residuals: Array) -> tuple[PoseError, ...]:
    pos, rot = _sizes(residuals)
    return tuple(
        PoseError(data.ids[i], float(pos[i]), None if rot is None else float(rot[i]))
        for i in np.argsort(-pos)[:_WORST]
    )
