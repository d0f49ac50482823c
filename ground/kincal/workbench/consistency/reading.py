"""Ways in which an arm table and a measurements file can be misread, each put right by a simple change."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.schema.arm import ArmTable, Frame, other_convention

from ..data.measurements import Measurements
from ..numerics.types import Array, Indices

_QUARTERS = (0.5 * math.pi, -0.5 * math.pi, math.pi)
_DEGREE = math.pi / 180.0
_INCH = 0.0254
_PAST_ROD = 2  # place of the joint, from 0, that is coupled to the one before in most arms that have it
_MOST_EXHAUSTIVE = 7  # joints up to which all orders and signs are tried
LENGTH_CODES = frozenset(("millimetres", "centimetres", "inches"))
"""Codes of findings about lengths: the units that they look like."""
LENGTHS = {1e-3: "millimetres", 1e-2: "centimetres", _INCH: "inches", 1e3: "metres, read as millimetres"}
ANGLES = {_DEGREE: "degrees", 1.0 / _DEGREE: "radians, read as degrees"}
# Mirrored axes of the measurement frame: one reversed, or two exchanged.
_MIRRORS = {
    "x": np.diag([-1.0, 1.0, 1.0]), "y": np.diag([1.0, -1.0, 1.0]), "z": np.diag([1.0, 1.0, -1.0]),
    "x and y": np.eye(3)[[1, 0, 2]], "x and z": np.eye(3)[[2, 1, 0]], "y and z": np.eye(3)[[0, 2, 1]],
    "any": np.diag([-1.0, 1.0, 1.0]),
}  # fmt: skip
# All orders of Euler angles: about the axes as they turn (capitals), and about fixed ones.
_EULER = tuple(
    "".join(axes)
    for letters in ("ZYX", "zyx")
    for axes in product(letters, repeat=3)
    if axes[0] != axes[1] != axes[2]
)

Pair = tuple[ArmTable, Measurements]
T = TypeVar("T")


@dataclass(frozen=True)
class Reading:
    """How the files are understood; the defaults are "as given".

    joints: joints of this shipped arm instead of the table's; convention: the table's numbers in the other
    DH convention; order: (n,) which column is the reading of each joint; sign: (n,) factor of each reading;
    offset: (n,) added to each reading [rad]; coupled: joints (from 0) to whose reading that of the joint
    before is added (factor 1) or from which it is taken (-1); sliding: joints (from 0) that slide where the
    table says they turn, or the other way round; twisted: joints (from 0) whose alpha has the other sign;
    angle, length: factors of readings and positions; quaternion: order of their columns, "xyzw" or "wxyz",
    empty as read; euler: axes of the Euler angles, empty as read; euler_angle: factor of these angles;
    mirror: axes of the measurement frame that are reversed or exchanged, of the positions alone
    ("positions: x") or of the orientations too ("poses: any"); turned_back: orientations are inverted;
    inverse: poses are; shift: rows by which readings are late; free: base and tool frame are unknown,
    whatever the table says; scalar_last: frames of the table ("base", "tool") whose quaternions are x, y, z,
    w.
    """

    order: tuple[int, ...]
    sign: tuple[int, ...]
    offset: tuple[float, ...]
    joints: str = ""
    convention: bool = False
    coupled: frozenset[tuple[int, int]] = frozenset()
    sliding: frozenset[int] = frozenset()
    twisted: frozenset[int] = frozenset()
    angle: float = 1.0
    length: float = 1.0
    quaternion: str = ""
    euler: str = ""
    euler_angle: float = 1.0
    mirror: str = ""
    turned_back: bool = False
    inverse: bool = False
    shift: int = 0
    free: bool = False
    scalar_last: frozenset[str] = frozenset()

    @classmethod
    def as_given(cls, n: int) -> Reading:
        """The files as they are, for an arm with n joints."""
        return cls(tuple(range(n)), (1,) * n, (0.0,) * n)

    def of(
        self, arm: ArmTable, data: Measurements, shipped: Sequence[ArmTable], rows: Indices | None = None
    ) -> Pair:
        """Arm and measurements as this reading understands them; rows: only these poses."""
        return self._arm(arm, shipped), self._data(data, np.arange(data.n) if rows is None else rows)

    def _arm(self, arm: ArmTable, shipped: Sequence[ArmTable]) -> ArmTable:
        if self.joints:
            (other,) = (one for one in shipped if one.source == self.joints)
            arm = replace(arm, joints=other.joints, first_link=other.first_link)
        if self.convention:
            arm = other_convention(arm)
        joints = [
            replace(joint, prismatic=not joint.prismatic) if j in self.sliding else joint
            for j, joint in enumerate(arm.joints)
        ]
        joints = [
            replace(joint, alpha_rad=-joint.alpha_rad) if j in self.twisted else joint
            for j, joint in enumerate(joints)
        ]
        arm = replace(arm, joints=tuple(joints), base=self._frame(arm, "base"), tool=self._frame(arm, "tool"))
        # another arm has other frames, and a base frame in modified DH holds the first link
        unknown = self.free or bool(self.joints) or self.convention
        return replace(arm, base=_free(arm.base), tool=_free(arm.tool)) if unknown else arm

    def _frame(self, arm: ArmTable, name: str) -> Frame:
        """Base or tool frame, its quaternion taken as x, y, z, w if this reading says so."""
        frame = arm.base if name == "base" else arm.tool
        if name not in self.scalar_last:
            return frame
        return replace(frame, quat_wxyz=np.roll(frame.quat_wxyz, 1))

    def joint_values(self, data: Measurements, rows: Indices) -> Array:
        """(N, n) joint readings of some poses, as this reading understands them."""
        found: Array = joint_values([self], data, rows)[0]
        return found

    @property
    def of_the_rest(self) -> tuple[object, ...]:
        """What this reading says of arm and poses alone: all but the joint readings."""
        return (self.joints, self.convention, self.sliding, self.twisted, self.length, self.quaternion,
                self.euler, self.euler_angle, self.mirror, self.turned_back, self.inverse, self.free,
                self.scalar_last)  # fmt: skip

    def _data(self, data: Measurements, rows: Indices) -> Measurements:
        q = self.joint_values(data, rows)
        data = data.take(rows)
        p_m, quat = data.p_m * self.length, data.quat_wxyz
        if quat is not None and self.quaternion:
            quat = np.roll(quat, 1 if self.quaternion == "xyzw" else -1, axis=1)
        if data.euler_rad is not None and (self.euler or self.euler_angle != 1.0):
            axes = self.euler or data.orientation.partition("-")[2]
            turns = Rotation.from_euler(axes, data.euler_rad * self.euler_angle)
            quat = turns.as_quat(scalar_first=True)
        if self.mirror:
            p_m, quat = _mirrored(self.mirror, p_m, quat)
        if quat is not None and self.turned_back:
            quat = _turned_back(quat)
        if quat is not None and self.inverse:
            back = Pose(p_m, matrix_of_wxyz(quat)).inverse
            p_m, quat = back.p_m, back.quat_wxyz
        return replace(data, q=q, p_m=p_m, quat_wxyz=quat, cov=None, whole=None)


def joint_values(readings: Sequence[Reading], data: Measurements, rows: Indices) -> Array:
    """(K, N, n) joint readings of some poses, as each of K readings understands them."""
    shift = np.array([reading.shift for reading in readings])
    order, sign, offset = (
        np.array([getattr(reading, name) for reading in readings])[:, None]
        for name in ("order", "sign", "offset")
    )
    angle = np.array([reading.angle for reading in readings])[:, None, None]
    late = data.q[(rows - shift[:, None]) % data.n]
    q: Array = np.take_along_axis(late, order, axis=2) * sign * angle + offset
    coupled = [(k, j, factor) for k, reading in enumerate(readings) for j, factor in reading.coupled]
    if coupled:
        of, to, factor = np.array(coupled).T
        q[of, :, to] += factor[:, None] * q[of, :, to - 1]
    return q


def joint_matrix(reading: Reading) -> Array:
    """(n, n) from readings to what the joints do, as its couplings have them."""
    out = np.eye(len(reading.sign))
    for to, factor in reading.coupled:
        out[to, to - 1] = factor
    return out


def _free(frame: Frame) -> Frame:
    return replace(frame, estimate=True)


def _turned_back(quat_wxyz: Array) -> Array:
    """(N, 4) the inverse rotations."""
    inverse: Array = quat_wxyz * [1.0, -1.0, -1.0, -1.0]
    return inverse


def _mirrored(how: str, p_m: Array, quat_wxyz: Array | None) -> tuple[Array, Array | None]:
    """Positions (N, 3), or poses, seen in a mirror."""
    what, _, axes = how.partition(": ")
    mirror = _MIRRORS[axes]
    if quat_wxyz is not None and what == "poses":
        turns = Rotation.from_matrix(mirror @ matrix_of_wxyz(quat_wxyz) @ mirror)
        quat_wxyz = turns.as_quat(scalar_first=True)
    return p_m @ mirror, quat_wxyz


def motions(now: Reading, shipped: Sequence[ArmTable]) -> Iterator[Reading]:
    """Readings one simple change away that alter how the arm moves, the likelier mistakes first."""
    yield replace(now, convention=not now.convention)
    yield from (replace(now, angle=factor) for factor in ANGLES)
    yield from (replace(now, order=order) for order in _orders(now.order))
    yield from (replace(now, sign=sign) for sign in _signs(now.sign))
    yield from (replace(now, coupled=now.coupled ^ {one}) for one in _couplings(len(now.sign)))
    yield from (replace(now, shift=rows) for rows in (1, -1))
    for j in range(len(now.sign)):
        yield replace(now, sliding=now.sliding ^ {j})
        yield replace(now, twisted=now.twisted ^ {j})
        yield from (replace(now, offset=_at(now.offset, j, turn)) for turn in _QUARTERS)
    yield from (replace(now, joints=arm.source) for arm in shipped)


def _signs(sign: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """One joint the other way round, then all, then any others."""
    for j in range(len(sign)):
        yield _at(sign, j, -sign[j])
    yield tuple(-s for s in sign)
    if len(sign) <= _MOST_EXHAUSTIVE:
        yield from product((1, -1), repeat=len(sign))


def two_offsets(now: Reading) -> Iterator[Reading]:
    """Quarter turns at two joints, of which one alone may explain no more than none."""
    pairs = combinations(range(len(now.sign)), 2)
    for (i, j), (one, other) in product(pairs, product(_QUARTERS, repeat=2)):
        yield replace(now, offset=_at(_at(now.offset, i, one), j, other))


def _couplings(n: int) -> Iterator[tuple[int, int]]:
    """Joint 3 first: where a rod moves it past joint 2, its motor reads the sum of both."""
    for j in sorted(range(1, n), key=lambda j: j != _PAST_ROD):
        yield from ((j, factor) for factor in (1, -1))


def all_orders(n: int) -> list[tuple[int, ...]]:
    """The columns of n joints in any order; none for an arm with many joints."""
    return list(permutations(range(n))) if n <= _MOST_EXHAUSTIVE else []


def _orders(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Two columns exchanged; all of them in reverse, or moved by one."""
    n = len(order)
    for i, j in combinations(range(n), 2):
        yield _at(_at(order, i, order[j]), j, order[i])
    yield order[::-1]
    yield (*order[1:], order[0])
    yield (order[-1], *order[:-1])


def _at(values: tuple[T, ...], place: int, value: T) -> tuple[T, ...]:
    return (*values[:place], value, *values[place + 1 :])


def poses(now: Reading, arm: ArmTable, data: Measurements) -> Iterator[Reading]:
    """Readings one simple change away that alter what was measured, all but the order of Euler angles."""
    yield from (replace(now, length=factor) for factor in LENGTHS)
    if data.quat_wxyz is not None:
        if data.orientation in ("", "wxyz", "xyzw"):
            yield replace(now, quaternion="wxyz" if data.orientation == "xyzw" else "xyzw")
        if data.euler_rad is not None:
            yield from (replace(now, euler_angle=factor) for factor in ANGLES)
        yield replace(now, turned_back=True)
        yield replace(now, inverse=True)
    yield from mirrors(now, arm, data)


def mirrors(now: Reading, arm: ArmTable, data: Measurements) -> Iterator[Reading]:
    """Readings in which axes of the measurement frame are mirrored. In an unknown base frame all mirrors are
    the same but for a rotation, unless orientations that are right say which it is."""
    named = [axes for axes in _MIRRORS if axes != "any"]
    which = ["any"] if arm.base.estimate or now.free else named
    if data.quat_wxyz is None:
        yield from (replace(now, mirror=f"positions: {axes}") for axes in which)
        return
    yield from (replace(now, mirror=f"positions: {axes}") for axes in named)
    yield from (replace(now, mirror=f"poses: {axes}") for axes in which)


def euler_orders(now: Reading, data: Measurements) -> Iterator[Reading]:
    """Readings in which the Euler angles are about other axes; none for orientations in another form."""
    if data.euler_rad is not None:
        said = data.orientation.partition("-")[2]
        yield from (replace(now, euler=axes) for axes in _EULER if axes != said)


def frames(now: Reading, arm: ArmTable) -> Iterator[Reading]:
    """Readings one simple change away that alter what is known of the frames."""
    known = [name for name, frame in (("base", arm.base), ("tool", arm.tool)) if not frame.estimate]
    if known and not now.free:
        yield from (replace(now, scalar_last=frozenset({name})) for name in known)
        yield replace(now, scalar_last=frozenset(known))
    if known:
        yield replace(now, free=True)
