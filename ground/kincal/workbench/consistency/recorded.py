"""What can be said of measurements without a fit: rows, limits, units, joints that stand still."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from kincal_shared.schema.arm import ArmTable

from ..data.copies import few_digits
from ..data.measurements import Measurements
from ..numerics.types import Array
from .findings import Finding

STILL = 0.02  # [rad or m], a joint that moves less stands still
_LIMIT_TOLERANCE = 0.01  # [rad or m] beyond a limit that is not worth a word
_DOUBLED = 0.4  # share of repeated rows that makes a file doubled
_ONE_POSE = 3  # poses up to which repeated rows are too little data rather than a file given twice
_LEAST_REPEATS = 3  # that tell how alike replicates are
_BEST_DEVICE_M = 1e-6
_MOST_LIMIT = 4.0 * math.pi + 0.1  # [rad], beyond any turning joint's
_MOST_NOISE = 0.2  # of the spread of the poses, beyond which stated noise is in another unit
TRUE_NOISE_M = 0.003  # up to which noise may be as large as stated: a few poses close together
TRUE_NOISE_RAD = 0.005  # the same of rotations, as of a tag seen by a camera
IN_RADIANS = "write sr_rad in radians, c11..c66 in m^2 and rad^2"
IN_METRES = "write sp_m in metres, c11..c66 in m^2 and rad^2"
_CONSTANTS = ("dir", "temp_c", "payload_kg", "range_m", "incid_rad")


def of_data(arm: ArmTable, data: Measurements) -> Iterator[Finding]:
    """Everything that is odd in what was recorded."""
    yield from _duplicates(data)
    yield from _too_alike(data)
    yield from _frozen(data)
    yield from _limits_in_degrees(arm)
    yield from _noise_in_millimetres(data)
    yield from _outside_limits(arm, data)
    yield from _still(data)
    yield from _constant(data)
    if data.unknown_columns:
        why = f"nothing reads the columns {', '.join(data.unknown_columns)}"
        yield Finding("unknown_columns", why, "say what they are with --column or --map", severity="note")


def _duplicates(data: Measurements) -> Iterator[Finding]:
    if not data.duplicates:
        return
    rows = data.n + data.duplicates
    doubled = data.duplicates >= _DOUBLED * rows and data.n > _ONE_POSE
    digits = (
        f"to the last digit, or with fewer digits ({data.rounded})" if data.rounded else "to the last digit"
    )
    yield Finding(
        "duplicates",
        f"{data.duplicates} of {rows} rows repeat another row {digits}; they were left out: a copy is not a "
        "replicate, which is approached and measured again",
        "the file looks doubled; give every row once" if doubled else "give every row once",
        severity="error" if doubled else "warning",
    )


def _too_alike(data: Measurements) -> Iterator[Finding]:
    """Replicates that agree better than any device measures arms; stated ones of few digits may be equal."""
    if data.repeats is None or (data.replicate_stated and few_digits(data)):
        return
    _, number, count = np.unique(data.repeats, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(number, x) for x in data.p_m.T]) / count[:, None]
    dof = int((count - 1).sum())
    spread_m = math.sqrt(float(((data.p_m - mean[number]) ** 2).sum()) / dof)
    if dof >= _LEAST_REPEATS and spread_m < _BEST_DEVICE_M:
        yield Finding(
            "replicates",
            f"{dof} repeated measurements differ by {spread_m * 1e6:.2g} um (RMS), while laser trackers have "
            "10: they look like copies, or like readings of an arm that did not move in between",
            "give each measurement once; a replicate is approached and measured again",
            severity="warning",
        )


def _frozen(data: Measurements) -> Iterator[Finding]:
    """Bit-equal poses at readings that differ, several times in a row."""
    same = ~np.diff(data.p_m, axis=0).any(axis=1) & (np.abs(np.diff(data.q, axis=0)).max(axis=1) > STILL)
    runs = same[1:] & same[:-1]
    if runs.any():
        where = data.ids[int(np.flatnonzero(runs)[0])]
        yield Finding(
            "frozen",
            f"from pose {where} on the measured position is the same to the last digit while joints move",
            "remove the rows in which the sensor did not follow",
            severity="warning",
        )


def _limits_in_degrees(arm: ArmTable) -> Iterator[Finding]:
    for number, joint in enumerate(arm.joints, 1):
        most = max(abs(joint.q_min), abs(joint.q_max))
        if not joint.prismatic and most > _MOST_LIMIT:
            yield Finding(
                "degrees",
                f"the arm table has a limit of joint {number} at {most:g}, which looks like degrees",
                f"write radians: {most:g} degrees are {math.radians(most):.6g}",
            )
            return


def _noise_in_millimetres(data: Measurements) -> Iterator[Finding]:
    if data.cov is None:
        return
    sigma_m = stated_m(data.cov)
    spread_m = float(np.linalg.norm(data.p_m.std(axis=0)))
    if sigma_m > _MOST_NOISE * spread_m > 0.0 and sigma_m > TRUE_NOISE_M:
        yield Finding(
            "millimetres",
            f"the stated noise is {sigma_m:.3g} m while the poses spread over {spread_m:.3g} m: "
            "it looks like millimetres",
            IN_METRES,
        )


def stated_m(cov: Array) -> float:
    """Typical 1-sigma noise of a coordinate of the position, from covariances (N, 6, 6) [m]."""
    return float(np.sqrt(np.median(np.einsum("nii->n", cov[:, :3, :3]) / 3.0)))


def stated_rad(cov: Array) -> float:
    """Typical 1-sigma noise of a component of the rotation, from covariances (N, 6, 6) [rad]."""
    return float(np.sqrt(np.median(np.einsum("nii->n", cov[:, 3:, 3:]) / 3.0)))


def _outside_limits(arm: ArmTable, data: Measurements) -> Iterator[Finding]:
    """Joints whose readings leave the limits of the arm table, and by how much."""
    for j, joint in enumerate(arm.joints):
        q = data.q[:, j]
        beyond = np.maximum(joint.q_min - q, q - joint.q_max)
        outside = int((beyond > _LIMIT_TOLERANCE).sum())
        if outside:
            unit = "m" if joint.prismatic else "rad"
            yield Finding(
                "outside_limits",
                f"joint {j + 1} is outside its limits in {outside} of {data.n} poses, by up to "
                f"{beyond.max():.3g} {unit} (limits {joint.q_min:.4g} to {joint.q_max:.4g})",
                _turns(beyond.max()) if not joint.prismatic else "compare the limits of the arm table",
                severity="warning",
            )


def _turns(beyond_rad: float) -> str:
    if beyond_rad > math.pi:
        return "subtract full turns if the controller counts them, or widen q_min_rad and q_max_rad"
    return "compare q_min_rad and q_max_rad of the arm table with the data sheet"


def _still(data: Measurements) -> Iterator[Finding]:
    still = np.flatnonzero(np.ptp(data.q, axis=0) < STILL)
    if len(still):
        names = ", ".join(str(j + 1) for j in still)
        yield Finding(
            "spread",
            f"{'joint' if len(still) == 1 else 'joints'} {names} {'does' if len(still) == 1 else 'do'} not "
            "move in these data: nothing about them can be estimated",
            "measure poses in which every joint moves",
            severity="note",
        )


def _constant(data: Measurements) -> Iterator[Finding]:
    names = [name for name in _CONSTANTS if data.has(name) and data.constant(name)]
    if names:
        yield Finding(
            "constant",
            f"the columns {', '.join(names)} never change: no effect that depends on them can be found",
            "",
            severity="note",
        )
