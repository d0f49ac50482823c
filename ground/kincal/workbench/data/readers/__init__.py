"""Measurements from files. One module a format gives a table; what its columns mean is the same for all.

`read_measurements` finds the format by content, reads one or several files and joins them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from kincal_shared.errors import BadInput
from kincal_shared.reading import refuse_stream
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.datamap import DataMap

from ..clock import one_clock
from ..direction import with_direction
from ..measurements import Measurements
from ..readings import LeftM, one_measurement_a_pose
from .arrays import read_npz, read_parquet
from .assembly import measurements
from .joining import joined, once
from .lcm import is_log, read_log
from .ros import is_bag, read_bag
from .table import Joints, Reader
from .text import read_text

__all__ = ["read_csv", "read_log", "read_measurements"]

# First bytes of a file -> who reads it; all other files are text.
_READERS: dict[bytes, Reader] = {b"PK\x03\x04": read_npz, b"PAR1": read_parquet}


def read_measurements(
    paths: str | Path | Sequence[str | Path],
    arm: ArmTable | int,
    mapping: DataMap | None = None,
    *,
    skip_bad: bool = False,
    session: int | None = None,
    infer_direction: bool = True,
    excluded: Collection[str] = (),
    left_m: LeftM | None = None,
) -> Measurements:
    """Measurements of one or several files: text (CSV), npz, Parquet, ROS bag, LCM log of the flight process.

    arm: its table, or the number of its joints (then all are revolute and have no names); mapping: names and
    units of the columns; skip_bad: leave malformed rows out and count them; session: of an LCM log, the last
    one with measurements if not named; infer_direction: where a file has no approach directions, take them
    from the order of its measurements; excluded: ids of rows to leave out; left_m: tells readings at rest
    from poses that were approached anew, where the times do not. Several readings of a pose at rest
    become one, but those of a log, whose process approaches replicates anew. BadInput names file, row, column
    and what to do.
    """
    given = [paths] if isinstance(paths, (str, Path)) else list(paths)
    joints, chosen = Joints.of(arm), mapping or DataMap()
    sets = [one_clock(once(_read(Path(path), joints, chosen, skip_bad, session))) for path in given]
    data = joined([with_direction(data) for data in sets] if infer_direction else sets)
    if any(is_log(Path(path)) for path in given):
        return data.without(excluded) if excluded else data
    return one_measurement_a_pose(data, excluded, left_m)


def read_csv(
    path: str | Path,
    n_joints: int,
    mapping: DataMap | None = None,
    *,
    skip_bad: bool = False,
    infer_direction: bool = True,
) -> Measurements:
    """Measurements of a text file for an arm with `n_joints` joints, one a row; else as read_measurements."""
    source = _existing(Path(path))
    joints, chosen = Joints.of(n_joints), mapping or DataMap()
    data = measurements(read_text(str(source), chosen, joints), chosen, joints, skip_bad=skip_bad)
    data = one_clock(once(data))
    return with_direction(data) if infer_direction else data


def _read(path: Path, joints: Joints, mapping: DataMap, skip_bad: bool, session: int | None) -> Measurements:
    _existing(path)
    if is_bag(path):  # ROS has its own names and units
        return measurements(read_bag(str(path), mapping, joints), DataMap(), joints, skip_bad=skip_bad)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder without metadata.yaml, so no ROS 2 bag; name a file")
    if is_log(path):
        return read_log(path, joints.n, session=session)
    reader = _reader(path)
    return measurements(reader(str(path), mapping, joints), mapping, joints, skip_bad=skip_bad)


def _existing(path: Path) -> Path:
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    refuse_stream(path, "measurements are read more than once")
    return path


def _reader(path: Path) -> Reader:
    try:
        with open(path, "rb") as file:
            first = file.read(4)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    return _READERS.get(first, read_text)
