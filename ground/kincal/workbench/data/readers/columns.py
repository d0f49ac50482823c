"""Columns of a file as quantities in SI units: names, units and forms of rotation as the map says."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from kincal_shared.errors import BadInput
from kincal_shared.letters import shown, unseen, without_unseen
from kincal_shared.schema.datamap import COUNT, SCALARS, TEXTS, DataMap, Names, RotationEntry
from kincal_shared.schema.numbers import plain_number
from kincal_shared.schema.suggestions import nearest_name

from ...numerics.types import Array, Mask, array
from .table import Joints, Table

UNIT_TOL = 1e-3  # of the norm of a quaternion as people round it
_DEGREE = math.pi / 180.0
_LENGTHS = {"m": 1.0, "mm": 1e-3}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_QUATERNION = ("qw", "qx", "qy", "qz")
# Our names of the columns of quantities of several, where they are not NAME1, NAME2 ...
_NAMES = {
    "p": ("px", "py", "pz"),
    "g": ("gx", "gy", "gz"),
    "cam": ("cx", "cy", "cz", "cqw", "cqx", "cqy", "cqz"),
    "cov": tuple(f"c{i}{j}" for i in range(1, 7) for j in range(i, 7)),
}
_DASHES = "\u2010\u2011\u2012\u2013\u2014\u2015\u2212\ufe63\uff0d"  # that stand for a minus sign
_MAY_BE_EMPTY = ("replicate",)  # an empty cell says something
# What the unit of a quantity is of, by the end of its name; the others have one unit only.
_KIND = {"m": "length", "rad": "angle", "s": "time"}


@dataclass
class Columns:
    """Quantities of a table, with the rows that cannot be used.

    values: quantity -> (N, k) in SI units, nan in a cell that may be empty; texts: quantity -> N; used: names
    of columns that were read; bad: row -> reason, the first one found.
    """

    table: Table
    mapping: DataMap
    joints: Joints
    values: dict[str, Array] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    bad: dict[int, str] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.table.numbers)

    @property
    def where(self) -> str:
        """File and place of its header, for errors."""
        return ": ".join(part for part in (self.table.source, self.table.where) if part)

    def refuse(self, rows: Mask, reasons: Iterable[str]) -> None:
        """Mark rows (N,) as bad; reasons: one for each of them."""
        for row, reason in zip(np.flatnonzero(rows), reasons, strict=True):
            self.bad.setdefault(int(row), reason)

    # ----------------------------------------------------------------------- which columns

    def plan(self) -> dict[str, tuple[str, ...]]:
        """Quantity -> columns that hold it. BadInput for columns that the map names and the file lacks, for
        a part of a quantity, for readings or positions that are missing."""
        self._refuse_unseen()
        n = self.joints.n
        given = self.mapping.columns
        several = {"q": n, "p": 3, "dir": n, "qdot": n, "g": 3, "cam": 7, "cov": 21}
        plan: dict[str, tuple[str, ...]] = {}
        for key in (*several, *SCALARS, *TEXTS):
            names = getattr(given, key)
            if names is not None:
                plan[key] = self.named(key, names, several.get(key, 1))
            elif key == "p" and self.mapping.targets is not None:
                continue
            elif found := self._standard(key, several.get(key, 1)):
                plan[key] = found
        rotation = self.mapping.rotation
        if rotation is not None and self.mapping.targets is not None:
            raise BadInput(
                f"{self.where}: the map has [rotation] and [targets]", todo="leave one of the two out"
            )
        if rotation is not None:
            plan["rotation"] = self.named("rotation", rotation.columns, COUNT[rotation.form])
        elif self.mapping.targets is not None:
            for number, names in enumerate(self.mapping.targets.columns, 1):
                plan[f"target {number}"] = self.named(f"target {number}", names, 3)
        elif found := self._complete(_QUATERNION):
            plan["rotation"] = found
        self._check_number_of_joints()
        return plan

    def named(self, key: str, names: Names, count: int) -> tuple[str, ...]:
        """Columns as the map names them, all of them there."""
        if isinstance(names, list):
            wanted = tuple(names)
        elif "{}" in names:
            wanted = tuple(names.replace("{}", str(k)) for k in range(1, count + 1))
        else:
            wanted = (names,)
        if len(wanted) != count:
            raise BadInput(
                f"{key} takes {count} columns, the map names {len(wanted)}", self.where,
                f'write a list of {count} names, or one with {{}} for the number: "{key}_{{}}"',
            )  # fmt: skip
        absent = [name for name in wanted if name not in self.table.columns]
        if absent:
            near = nearest_name(absent[0], self.table.columns)
            hint = f"did you mean {near!r}? " if near else ""
            if isinstance(names, str) and (zero := self._from_zero(names, count)):
                hint = f"{{}} counts from 1: write --column {shlex.quote(f'{key}={zero}')}; "
            raise BadInput(
                f"{key}: there is no column {', '.join(map(repr, absent))}", self.where,
                f"{hint}columns are {shown(', '.join(self.table.columns))}",
            )  # fmt: skip
        return wanted

    def _standard(self, key: str, count: int) -> tuple[str, ...]:
        """Columns by KinCal's own names; () if there are none."""
        if count == 1 and key in (*SCALARS, *TEXTS):
            return (key,) if key in self.table.columns else ()
        names = _NAMES.get(key) or tuple(f"{key}{j}" for j in range(1, count + 1))
        if key in ("q", "p"):
            self._require(names)
            return names
        return self._complete(names)

    def _refuse_unseen(self) -> None:
        """BadInput for a column that has our name but for a character that nobody sees: it would pass for
        another column, or for none."""
        numbered = [f"{key}{j}" for key in ("q", "dir", "qdot") for j in range(1, self.joints.n + 1)]
        ours = {*numbered, *SCALARS, *TEXTS, *chain(_QUATERNION, *_NAMES.values())}
        for number, name in enumerate(self.table.columns, 1):
            if (code := unseen(name)) and without_unseen(name) in ours:
                raise BadInput(
                    f"{self.where}: the name of column {number}, {shown(name)}, holds {code}, which is not "
                    "shown",
                    todo=f"write {without_unseen(name)} without it",
                )

    def _require(self, names: Sequence[str]) -> None:
        joints = [f"q{j}" for j in range(1, self.joints.n + 1)]
        given = self.mapping.columns
        needed = [*(joints if given.q is None else []), *(("px", "py", "pz") if given.p is None else [])]
        missing = [name for name in needed if name not in self.table.columns]
        if missing and any(name in missing for name in names):
            hint = "if they have other names, say which with --column or --map"
            if joints[-1] in missing and (zero := self._from_zero("q{}", len(joints))):
                hint = f"columns count from 1: q1..q{len(joints)}; rename them, or write --column q={zero}"
                for key in ("dir", "qdot"):
                    if also := self._from_zero(f"{key}{{}}", len(joints)):
                        hint += f" --column {key}={also}"
            raise BadInput(
                f"{self.where}: column(s) {', '.join(missing)} missing; an arm with {len(joints)} "
                f"joints needs q1..q{len(joints)},px,py,pz",
                todo=f"{hint}; there are {shown(', '.join(self.table.columns))}",
            )

    def _from_zero(self, pattern: str, count: int) -> str:
        """The columns of a pattern with {} for the number, from 0 on, if all of them are there."""
        names = [pattern.replace("{}", str(k)) for k in range(count)]
        return ",".join(names) if all(name in self.table.columns for name in names) else ""

    def _complete(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """The names if all are there, () if none is; BadInput for some of them."""
        there = [name for name in names if name in self.table.columns]
        if there and len(there) < len(names):
            lacking = [name for name in names if name not in self.table.columns]
            zero = self._from_zero(f"{names[0].rstrip('1')}{{}}", len(names))
            raise BadInput(
                f"{self.where}: has {', '.join(there[:4])} but lacks {', '.join(lacking[:4])}; "
                f"give all of {names[0]}..{names[-1]} or none",
                todo=f"columns count from 1: {names[0]}..{names[-1]}; rename them, or write --column "
                f"{names[0].rstrip('1')}={zero}"
                if zero
                else "",
            )
        return tuple(there)

    def _check_number_of_joints(self) -> None:
        extra = next((name for name in ("q0", f"q{self.joints.n + 1}") if name in self.table.columns), "")
        if extra and self.mapping.columns.q is None:
            columns = ",".join(f"q{j}" for j in range(1, self.joints.n + 1))
            raise BadInput(
                f"{self.where}: has column {extra}, but the arm table has {self.joints.n} joints",
                todo="name the arm table of these data with --arm (`kincal arm list` names those that ship); "
                f"if {extra} is no joint of this arm, say which columns are: --column q={columns}",
            )

    # ----------------------------------------------------------------------- numbers

    def read(self, plan: dict[str, tuple[str, ...]]) -> None:
        """All quantities of the plan, in SI units; rotations of any form and targets stay as they are."""
        numeric = {key: names for key, names in plan.items() if key not in TEXTS}
        comma = self._decimal_comma([name for names in numeric.values() for name in names])
        for key, names in numeric.items():
            numbers = np.column_stack([self._numbers(name, comma, key in _MAY_BE_EMPTY) for name in names])
            self.values[key] = numbers * self._scale(key, names)
        for key in plan.keys() & set(TEXTS):
            (name,) = plan[key]
            self.texts[key] = [_text(value) for value in self.table.columns[name]]
        self.used = {name for names in plan.values() for name in names}

    def _decimal_comma(self, names: Sequence[str]) -> bool:
        if self.table.decimal is not None:
            return self.table.decimal == ","
        cells = [self.table.columns[name] for name in names]
        texts = [cell for column in cells if not isinstance(column, np.ndarray) for cell in column]
        comma = next((cell for cell in texts if "," in cell), "")
        point = next((cell for cell in texts if "." in cell), "")
        if comma and point:
            raise BadInput(
                f"{self.where}: has decimal commas ({comma}) and decimal points ({point})",
                todo='say which is meant in the map: [text] decimal = "," or "."',
            )
        return bool(comma)

    def _numbers(self, name: str, comma: bool, may_be_empty: bool) -> Array:
        """(N,) numbers of a column; nan where there is none, and the row bad unless the cell is empty and may
        be."""
        cells = self.table.columns[name]
        if isinstance(cells, np.ndarray):
            found = array(cells)
            empty = np.isnan(found)
        else:
            found = np.array([_number(cell, comma) for cell in cells], dtype=float)
            empty = np.array([not cell.strip() for cell in cells], dtype=bool)
        wrong = ~np.isfinite(found) & ~(empty & may_be_empty)
        self.refuse(wrong, (self._why(name, cells[k], found[k]) for k in np.flatnonzero(wrong)))
        return found

    def _why(self, name: str, cell: object, found: float) -> str:
        text = shown(str(cell).strip()) or "empty"
        number = isinstance(cell, str) and text.lower().lstrip("+-") not in ("nan", "inf", "infinity")
        what = "a number" if number and math.isnan(found) else "a finite number"
        hint = ", with a decimal point" if number and "," in text else ""
        return f"{name} is {text}, {what}{hint} is needed{_odd_letter(str(cell).strip())}"

    def _scale(self, key: str, names: Sequence[str]) -> Array:
        """(k,) factors to SI units. A column that the file calls by our name with a unit is in that unit."""
        units = self.mapping.units
        angle = _DEGREE if units.angle == "deg" else 1.0
        length, time = _LENGTHS[units.length], _TIMES[units.time]
        kind = "length" if key == "p" or key.startswith("target ") else _KIND.get(key.rpartition("_")[2], "")
        if kind and names == (key,):
            return np.ones(1)
        if key in ("q", "qdot"):
            return np.array([length if prismatic else angle for prismatic in self.joints.prismatic])
        if key == "cam":
            return np.array([length] * 3 + [1.0] * 4)
        if key == "cov":
            sigma = np.array([length] * 3 + [angle] * 3)
            return np.outer(sigma, sigma)[np.triu_indices(6)]
        if key == "rotation":
            form = self.mapping.rotation.form if self.mapping.rotation else "wxyz"
            return np.full(len(names), angle if form in ("euler", "rotvec") else 1.0)
        return np.full(len(names), {"length": length, "angle": angle, "time": time}.get(kind, 1.0))

    def good(self) -> Mask:
        """(N,) rows that can be used so far."""
        mask = np.ones(self.n, dtype=bool)
        mask[list(self.bad)] = False
        return mask

    def problems(self) -> Iterator[str]:
        """All malformed rows in the file's order, with their numbers."""
        found = {self.table.numbers[row]: reason for row, reason in self.bad.items()}
        for number, reason in sorted([*self.table.malformed, *found.items()]):
            yield f"{self.table.row} {number}: {reason}"


def _text(value: object) -> str:
    """A name in a file: a number that is whole is written as such."""
    return f"{value:.15g}" if isinstance(value, float) else str(value).strip()


def _odd_letter(text: str) -> str:
    """What to do about a character that looks like a part of a number, or like nothing; empty if there is
    none."""
    if code := unseen(text):
        return f": it holds {code}, which is not shown; take it out"
    if dash := next((char for char in text if char in _DASHES), ""):
        return f": its sign is U+{ord(dash):04X}; write the - of the keyboard"
    return ""


def _number(cell: str, comma: bool) -> float:
    """The number in a cell, nan if it is none."""
    if comma:
        cell = "?" if "." in cell else cell.replace(",", ".")
    try:
        return plain_number(cell)
    except ValueError:
        return math.nan


def quaternions(columns: Columns, entry: RotationEntry | None) -> Array:
    """(N, 4) unit quaternions, scalar part first, of the quantity "rotation"; rows that are no rotation
    become bad."""
    values = columns.values["rotation"]
    form = entry.form if entry else "wxyz"
    if form in ("wxyz", "xyzw"):
        ordered = values if form == "wxyz" else np.roll(values, 1, axis=1)
        return unit(columns, ordered, "qw,qx,qy,qz" if entry is None else ",".join(_list(entry, columns)))
    safe = np.where(np.isfinite(values), values, 0.0)
    if form == "rotvec":
        turn = Rotation.from_rotvec(safe)
    elif form == "euler":
        assert entry is not None and entry.axes is not None
        turn = Rotation.from_euler(entry.axes, safe)
    else:
        turn = _of_matrices(columns, safe.reshape(-1, 3, 3))
    return turn.as_quat(scalar_first=True)


def _list(entry: RotationEntry, columns: Columns) -> tuple[str, ...]:
    return columns.named("rotation", entry.columns, COUNT[entry.form])


def _of_matrices(columns: Columns, matrices: Array) -> Rotation:
    off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = (off > UNIT_TOL) | (np.linalg.det(matrices) < 0.0)
    columns.refuse(wrong, ("rotation matrix is not orthonormal" for _ in range(int(wrong.sum()))))
    return Rotation.from_matrix(np.where(wrong[:, None, None], np.eye(3), matrices))


def unit(columns: Columns, quat: Array, what: str) -> Array:
    """(N, 4) quaternions scaled to norm 1; rows whose norm is another become bad."""
    norm = np.linalg.norm(quat, axis=1)
    wrong = ~(np.abs(norm - 1.0) <= UNIT_TOL)
    columns.refuse(wrong, (f"{what} has norm {norm[k]:.6g}, 1 is needed" for k in np.flatnonzero(wrong)))
    return array(quat / np.where(wrong, 1.0, norm)[:, None])
