"""The record of a fit that M.toml keeps (frames, data, split, covariance), so that it can be exported."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from kincal.rotations import Pose
from kincal_shared.schema.arm import ArmTable, Frame, Joint
from kincal_shared.schema.model import DataEntry, ExpectedEntry, FitEntry, FrameEntry, SightEntry
from kincal_shared.schema.names import PNP

from ..fit.least_squares import Fit, rms
from ..model.modelfile import ModelFile
from ..model.parameters import BETA, is_beta
from ..model.pnp import sight_of_column
from ..model.sight import sights
from ..prediction.nested import CROSSED, HELD_OUT
from .fitting import FitResult


def fitted(
    model: ModelFile, result: FitResult, *, arm: str, files: Sequence[Path], version: str
) -> ModelFile:
    """The model file with the values of a fit and its record.

    arm: path or name of the arm table; files: measurements that were read; version: of the tool.
    """
    rows = zip(result.names, result.estimate, result.std_err, strict=True)
    return replace(
        model,
        arm=arm,
        values={name: (float(value), float(std_err)) for name, value, std_err in rows},
        units=dict(zip(result.names, result.units, strict=True)),
        constants=result.constants,
        fit=fit_record(result, files, version),
    )


def fit_record(result: FitResult, files: Sequence[Path], version: str) -> FitEntry:
    """What the table [fit] of M.toml holds."""
    fit, comparison = result.fit, result.comparison
    held = comparison.rms["held"] if len(comparison.split.held) else (None, None)
    table = comparison.table_errors
    return FitEntry(
        when=datetime.now(UTC).isoformat(timespec="seconds"),
        tool_version=version,
        arm_sha256=arm_digest(fit.arm),
        data=[DataEntry(path=str(path), sha256=file_digest(path)) for path in files],
        poses=comparison.poses,
        components=6 if comparison.components == 6 else 3,
        held=[comparison.data.ids[i] for i in comparison.split.held],
        held_mm=None if held[0] is None else held[0] * 1e3,
        held_mrad=None if held[1] is None else held[1] * 1e3,
        held_table_mm=None if table is None else table.held[0] * 1e3,
        exported_table_mm=None if table is None else table.exported[0] * 1e3,
        expected=_expected(result),
        end_s=fit.data.end_s,
        noise_scale=fit.scale,
        base=_frame(fit.base),
        tool=_frame(fit.tool),
        sight=sight_entry(fit),
        position_change_mm=position_changes_mm(fit),
        covariance=[[float(f"{x:.9g}") for x in row[: i + 1]] for i, row in enumerate(fit.cov)],
    )


def _expected(result: FitResult) -> ExpectedEntry | None:
    """The error of the whole model on poses in turns where they took turns, else on the held-out ones."""
    comparison, last = result.comparison, {m.block: m for m in result.nested.models}
    judged = {CROSSED: comparison.fit_all.data, HELD_OUT: comparison.held_data}
    for block, data in judged.items():
        if data is not None and (model := last.get(block)) is not None:
            usual, mrad = model.usual, (model.rot_rad, model.usual[1])
            others = data.take(data.are_not(comparison.outliers.ids))
            return ExpectedEntry(
                held_out=block,
                poses=data.n,
                outliers=data.n - others.n,
                distinct=others.n if others.repeats is None else len(np.unique(others.repeats)),
                mm=model.pos_m * 1e3,
                mrad=None if mrad[0] is None else mrad[0] * 1e3,
                usual_mm=usual[0] * 1e3,
                usual_mrad=None if mrad[1] is None else mrad[1] * 1e3,
            )
    return None


def sight_entry(fit: Fit) -> SightEntry | None:
    """Camera and target that effects act through; None if none does, or if they assume several."""
    used = {
        sight_of_column(basis.index)
        for parameter in fit.parameters
        for term in parameter.terms
        for basis in term.basis
        if basis.var in PNP
    }
    if len(used) != 1:
        return None
    sight = sights(fit.arm, fit.data)[used.pop()]
    return SightEntry.model_validate(
        {
            "on_tool": fit.arm.mount == "tool",
            "points_m": sight.points_m.tolist(),
            "second_m": None if sight.second_m is None else sight.second_m.tolist(),
            "low": tuple(sight.low.tolist()),
            "high": tuple(sight.high.tolist()),
            "focal": tuple(sight.focal.tolist()),
        }
    )


def _frame(pose: Pose) -> FrameEntry:
    x, y, z = (float(v) for v in pose.p_m)
    w, i, j, k = (float(v) for v in pose.quat_wxyz)
    return FrameEntry(xyz_m=(x, y, z), quat_wxyz=(w, i, j, k))


def position_changes_mm(fit: Fit) -> dict[str, float]:
    """Effect (and the turns between parallel axes) -> RMS change of the position residual over the poses [mm]
    without its coefficients."""
    full = fit.model.residuals(fit.estimate)
    groups = {h.name: {f"{h.name}.{p.name}" for p in h.parameters} for h in fit.hypotheses}
    if beta := {name for name in fit.names if is_beta(name)}:
        groups[BETA] = beta

    def change_mm(own: set[str]) -> float:
        without = np.where([name in own for name in fit.names], 0.0, fit.estimate)
        return rms(fit.model.residuals(without) - full)[0] * 1e3

    return {name: change_mm(own) for name, own in groups.items()}


def file_digest(path: Path) -> str:
    """SHA-256 of a file; of a folder (a ROS bag) over its files in the order of their names."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        with open(file, "rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def arm_digest(arm: ArmTable) -> str:
    """SHA-256 of what the model takes from an arm table: the same for any layout of the file, names aside."""
    numbers = [*map(_frame_numbers, (arm.base, arm.tool)), [float(x) for x in arm.gravity_m_s2]]
    text = repr([*map(_joint_numbers, arm.joints), *numbers])
    return hashlib.sha256(text.encode()).hexdigest()


def _joint_numbers(joint: Joint) -> tuple[object, ...]:
    com = None if joint.com_m is None else tuple(map(float, joint.com_m))
    dh = tuple(float(x) for x in (joint.a_m, joint.alpha_rad, joint.d_m, joint.phi_rad))
    return (joint.prismatic, *dh, joint.mass_kg, com, joint.gear_ratio)


def _frame_numbers(frame: Frame) -> object:
    """An unknown frame has no numbers."""
    return None if frame.estimate else [float(x) for x in (*frame.xyz_m, *frame.quat_wxyz)]
