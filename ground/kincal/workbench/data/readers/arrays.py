"""Files that hold numbers as such: npz of numpy, Parquet."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.datamap import DataMap

from ...numerics.types import array
from .table import Column, Joints, Table

MOST_BYTES = 1 << 28
"""Of a file, unpacked: two million poses with 16 numbers each. A few MB can unpack to gigabytes."""
_BYTES_OF_A_NUMBER = 8
# What zipfile, zlib and numpy raise for a file that is no npz.
_BROKEN = (OSError, ValueError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile)
# Names of the columns of an array of several columns, where they are not NAME1, NAME2 ...
_PARTS = {
    "p": ("px", "py", "pz"),
    "quat_wxyz": ("qw", "qx", "qy", "qz"),
    "g": ("gx", "gy", "gz"),
    "cam": ("cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz"),
}


def read_npz(path: str, _mapping: DataMap, _joints: Joints) -> Table:
    """The arrays of an npz file whose first dimension is that of most; those of one value are left out."""
    try:
        with zipfile.ZipFile(path) as archive:
            _refuse_large(path, sum(_bytes_of(archive, member) for member in archive.infolist()))
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    except _BROKEN as error:
        raise BadInput("cannot be read as npz", path, str(error)) from None
    return _table(path, {name: values for name, values in found.items() if values.ndim > 0})


def _bytes_of(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Memory that a member of an npz needs: what its header says, or its size where that is more. ValueError
    if it is no array."""
    of: Any = np.lib.format  # it has no types
    with archive.open(member) as file:
        version = of.read_magic(file)
        shape, _, kind = (of.read_array_header_1_0 if version == (1, 0) else of.read_array_header_2_0)(file)
    return max(int(math.prod(shape)) * int(kind.itemsize), member.file_size)


def _refuse_large(path: str, size: int) -> None:
    if size > MOST_BYTES:
        raise BadInput(
            f"unpacked it needs {size / 2**20:.0f} MiB, up to {MOST_BYTES / 2**20:.0f} MiB are read",
            path,
            "keep the arrays that are measurements, or fewer poses",
        )


def read_parquet(path: str, _mapping: DataMap, _joints: Joints) -> Table:
    """The columns of a Parquet file; a column of lists is an array of several columns. Times with a date
    become seconds."""
    installation.require("data", "reading Parquet")
    import pyarrow
    from pyarrow import parquet

    try:
        about = parquet.read_metadata(path)
        _refuse_large(path, _BYTES_OF_A_NUMBER * about.num_rows * about.num_columns)
        table = parquet.read_table(path)
    except (OSError, pyarrow.ArrowException) as error:
        raise BadInput("cannot be read as Parquet", path, str(error)) from None
    return _table(path, {name: _column(path, name, table.column(name)) for name in table.column_names})


def _column(path: str, name: str, values: Any) -> NDArray[Any]:
    import pyarrow

    kind = values.type
    if pyarrow.types.is_timestamp(kind):
        return array(values.cast(pyarrow.timestamp("ns")).cast("int64").to_numpy()) * 1e-9
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return np.array(["" if text is None else text for text in values.to_pylist()])
    try:
        return np.array(values.to_pylist(), dtype=float)  # None becomes nan
    except (TypeError, ValueError):
        raise BadInput(
            f"column {name!r} holds {kind}, numbers or lists of one length are needed", path
        ) from None


def _table(path: str, arrays: dict[str, NDArray[Any]]) -> Table:
    if not arrays:
        raise BadInput("holds no array", path)
    n = len(next(iter(arrays.values())))
    for name, values in arrays.items():
        if len(values) != n:
            sizes = ", ".join(f"{key}: {len(rows)}" for key, rows in arrays.items())
            raise BadInput(f"{name!r} has {len(values)} rows, others have {n}", path, f"rows are {sizes}")
    columns: dict[str, Column] = {}
    for name, values in arrays.items():
        for part, column in _parts(name, values):
            if part in columns:
                raise BadInput(f"column {part!r} appears twice", path)
            columns[part] = column
    return Table(source=path, where="", row="row", numbers=range(1, n + 1), columns=columns)


def _parts(name: str, values: NDArray[Any]) -> Iterator[tuple[str, Column]]:
    """Columns of an array (N, ...), row by row. What is no real number (complex ones, dates) becomes texts:
    who needs it as a number refuses it by row."""
    if values.dtype.kind in "fiub":
        rows = np.asarray(values, dtype=float).reshape(len(values), -1)
        columns: list[Column] = list(rows.T)
    else:
        rows = values.reshape(len(values), -1)
        columns = [[_text(value) for value in column] for column in rows.T]
    if values.ndim == 1:
        yield name, columns[0]
        return
    names = _PARTS.get(name, ())
    if len(names) != len(columns):
        names = tuple(f"{name}{k}" for k in range(1, len(columns) + 1))
    yield from zip(names, columns, strict=True)


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
