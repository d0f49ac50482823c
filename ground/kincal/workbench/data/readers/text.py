"""Text files: columns between commas, semicolons, tabs or blanks; comment lines begin with #."""

from __future__ import annotations

import csv
from pathlib import Path

from kincal_shared.errors import BadInput
from kincal_shared.letters import shown
from kincal_shared.schema.datamap import DataMap
from kincal_shared.schema.errors import utf8_text

from .table import Joints, Table

_SEPARATORS = (",", ";", "\t")
_LONGEST = 100_000  # characters of a line, less than the module csv takes in one value


def read_text(path: str, mapping: DataMap, joints: Joints) -> Table:
    """The rows of a text file. BadInput if there are none, or a column has the name of another."""
    lines, long = _not_too_long(path, _lines(path, joints.n))
    separator = mapping.text.separator or _separator(lines[0][1])
    rows = [(number, _cells(line, separator)) for number, line in lines]
    if mapping.text.header:
        (at, header), rows = rows[0], rows[1:]
        where = f"line {at}"
    else:
        header, where = [str(k) for k in range(1, len(rows[0][1]) + 1)], "without a header"
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise BadInput(f"{path}: {where}: column {shown(', '.join(doubled))} appears twice in the header")
    good = [(number, cells) for number, cells in rows if len(cells) == len(header)]
    return Table(
        source=path,
        where=where,
        row="line",
        numbers=[number for number, _ in good],
        columns={name: [cells[k] for _, cells in good] for k, name in enumerate(header)},
        malformed=(
            *long,
            *(
                (number, f"has {len(cells)} values, the header names {len(header)}")
                for number, cells in rows
                if len(cells) != len(header)
            ),
        ),
        # Between commas a decimal comma cannot stand.
        decimal=mapping.text.decimal or ("." if separator == "," else None),
    )


def _lines(path: str, n_joints: int) -> list[tuple[int, str]]:
    """(number, text) of each line that is neither empty nor a comment; the first is the header."""
    try:
        text = utf8_text(Path(path))
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    found = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not found:
        raise BadInput(f"{path}: is empty; a header row with q1..q{n_joints},px,py,pz is needed")
    return found


def _not_too_long(
    path: str, lines: list[tuple[int, str]]
) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """The lines that can be taken apart, and (number, reason) of the others. BadInput if the first is one of
    these."""
    long = [
        (number, f"has {len(line)} characters, up to {_LONGEST} are read")
        for number, line in lines
        if len(line) > _LONGEST
    ]
    if long and long[0][0] == lines[0][0]:
        raise BadInput(f"{path}: line {long[0][0]}: {long[0][1]}", todo="name a file with a header row")
    return [(number, line) for number, line in lines if len(line) <= _LONGEST], long


def _separator(header: str) -> str:
    """The separator that makes most columns of the header; blanks only if no other makes two."""
    count = {separator: len(_cells(header, separator)) for separator in _SEPARATORS}
    best = max(count, key=lambda separator: count[separator])
    return best if count[best] > 1 or " " not in header.strip() else " "


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = line.strip()
    row = next(csv.reader([line], delimiter=separator, skipinitialspace=separator == " "))
    return [cell.strip() for cell in row]
