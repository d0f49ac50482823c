"""A misreading of the files as a finding that people understand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from kincal_shared.schema.arm import ArmTable

from .findings import Finding
from .reading import ANGLES, LENGTH_CODES, LENGTHS, Reading

Sentence = tuple[str, str, str]  # code, why, fix
_RODS = {(2, 1), (2, -1)}  # couplings of joint 3
READINGS = "the joint readings look like"


def misread(reading: Reading, kind: str, gain: float, arm: ArmTable, shipped: Sequence[ArmTable]) -> Finding:
    """The finding for one kind of change (a field of Reading) of the reading that explains the data."""
    code, why, fix = _SENTENCES[kind](reading, arm, shipped)
    size = f"{gain:.0f} times" if math.isfinite(gain) else "far"
    return Finding(code, f"{why}: the arm then explains the poses {size} better", fix, gain)


def wrong_sums(stated: str, gain: float) -> Finding:
    """The finding for sums of readings that no joint has."""
    return Finding(
        "coupled",
        f"readings contain no other joint's, but the map says so: without that the arm explains the poses "
        f"{f'{gain:.0f} times' if math.isfinite(gain) else 'far'} better",
        f"take {stated} out of the map file (--map)",
        gain,
    )


def signs(reading: Reading) -> str:
    """Which joints count the other way round, in words: joint 2; joints 1, 3."""
    return _numbers(np.flatnonzero(np.array(reading.sign) < 0))


def _joints(reading: Reading, _arm: ArmTable, shipped: Sequence[ArmTable]) -> Sentence:
    alike = [one for one in shipped if one.source == reading.joints]
    name = f"{reading.joints} ({alike[0].name})" if alike else reading.joints
    return ("wrong_arm", f"the data look like those of the arm {name} that ships with KinCal",
            f"use --arm {reading.joints}, or correct the arm table")  # fmt: skip


def _convention(_reading: Reading, arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    now, other = ("standard", "modified") if arm.first_link is None else ("modified", "standard")
    return ("convention", f"the DH parameters look {other}, the arm table says {now}",
            f'write convention = "{other}" into the arm table')  # fmt: skip


def _order(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    moved = [(j, k) for j, k in enumerate(reading.order) if j != k]
    if len(moved) == 2:
        (i, _), (j, _) = moved
        why = f"the readings of joints {i + 1} and {j + 1} seem exchanged"
    else:
        why = "the readings are in another order: " + ", ".join(
            f"column q{k + 1} is joint {j + 1}" for j, k in moved
        )
    columns = ",".join(f"q{k + 1}" for k in reading.order)
    return "joint_order", why, f"name the columns in the order of the joints: --column q={columns}"


def _sign(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    names = signs(reading)
    return ("sign", f"{names} {'counts' if ' ' not in names[6:] else 'count'} the other way round",
            f"change the sign of these readings, or turn the axes in the arm table ({names})")  # fmt: skip


def _offset(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    turned = [(j, turn) for j, turn in enumerate(reading.offset) if turn]
    listed = ", ".join(f"joint {j + 1}: {math.degrees(turn):+.0f} deg" for j, turn in turned)
    values = ", ".join(f"joint[{j + 1}].phi_rad += {turn:.6g}" for j, turn in turned)
    return "offset", f"zeros of joints are a quarter turn or more off ({listed})", f"arm table: {values}"


def _coupled(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    pairs = [(j + 1, "+" if factor > 0 else "-") for j, factor in sorted(reading.coupled)]
    listed = ", ".join(f"readings of joint {j} contain joint {j - 1}" for j, _ in pairs)
    sums = ", ".join(f'q{j} = "q{j} {sign} q{j - 1}"' for j, sign in pairs)
    whose = " (as FANUC controllers and arms with a parallelogram state them)"
    return (
        "coupled",
        f"{listed}{whose if reading.coupled & _RODS else ''}",
        f"write into the map file (--map): [readings] {sums}",
    )


def _sliding(reading: Reading, arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    kind = {True: "revolute", False: "prismatic"}
    listed = ", ".join(
        f"joint {j + 1} seems {kind[arm.joints[j].prismatic]}" for j in sorted(reading.sliding)
    )
    return "joint_type", listed, "correct `type` in the arm table"


def _twisted(reading: Reading, arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    # in modified DH alpha stands with the joint after it
    numbers = np.array(sorted(reading.twisted)) + (0 if arm.first_link is None else 1)
    keys = ", ".join(f"joint[{j + 1}].alpha_rad" for j in numbers)
    return ("alpha_sign", f"alpha of {_numbers(numbers)} seems to have the other sign (the axis after it "
            "points the other way)", f"change the sign of {keys} in the arm table")  # fmt: skip


def _angle(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    unit = ANGLES[reading.angle]
    if unit == "degrees":
        fix = "add --units deg, or multiply by pi/180: q1..qN are radians"
    else:
        fix = "leave --units deg out"
    return "degrees", f"{READINGS} {unit}", fix


def _length(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    unit = LENGTHS[reading.length]
    if unit == "millimetres":
        fix = "add --units mm, or write metres"
    else:
        fix = "leave --units mm out" if reading.length > 1.0 else "convert them to metres"
    return unit if unit in LENGTH_CODES else "millimetres", f"the measured positions look like {unit}", fix


def _quaternion(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    return ("quaternion_order", f"the quaternions look like {', '.join(reading.quaternion)}",
            f"say so: --rotation {reading.quaternion}=A,B,C,D with the same four columns in the order in "
            "which they were read (qw,qx,qy,qz if nothing was said)")  # fmt: skip


def _scalar_last(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    names = " and ".join(f"[{name}]" for name in sorted(reading.scalar_last))
    return ("quaternion_order", f"quat_wxyz of {names} in the arm table looks like x, y, z, w",
            "write the scalar part first: [1.0, 0.0, 0.0, 0.0] is no rotation")  # fmt: skip


def _euler(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    kind = "the axes as they turn" if reading.euler.isupper() else "fixed axes"
    return ("euler_order", f"the Euler angles look like {reading.euler}, about {kind}",
            f"say so: --rotation euler-{reading.euler}=A,B,C with the same three columns in the same "
            "order")  # fmt: skip


def _euler_angle(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    return ("degrees", f"the Euler angles look like {ANGLES[reading.euler_angle]}",
            "write joint readings and Euler angles in one unit, and name it: --units deg or rad")  # fmt: skip


def _mirror(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    what, _, axes = reading.mirror.partition(": ")
    if axes == "any":
        how = "one axis is reversed, or two are exchanged"
        fix = "change the sign of one of px, py, pz, or exchange two of them"
    elif " and " in axes:
        one, other = axes.split(" and ")
        how, fix = f"{axes} are exchanged", f"exchange p{one} and p{other}"
    else:
        how, fix = f"{axes} is reversed", f"change the sign of p{axes}"
    too = ", and mirror the orientations in the same way" if what == "poses" else ""
    return "mirrored", f"the measured {what} are those of a left-handed frame ({how})", f"{fix}{too}"


def _turned_back(_reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    return ("inverse_rotation", "the orientations look inverted (base seen from the tool)",
            "negate qx, qy, qz, or transpose the matrices")  # fmt: skip


def _inverse(_reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    return ("inverse_pose", "the poses look inverted (base seen from the tool)",
            "write the pose of the tool in the measurement frame; of an eye-in-hand camera, its pose in the "
            "target's frame")  # fmt: skip


def _shift(reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    late = "before" if reading.shift > 0 else "after"
    return ("row_shift", f"each measured pose belongs to the readings of the row {late} it",
            "move the readings or the poses by one row")  # fmt: skip


def _free(_reading: Reading, _arm: ArmTable, _shipped: Sequence[ArmTable]) -> Sentence:
    return ("frames", "the base or tool frame of the arm table is not the one of these data",
            "correct [base] and [tool], or write estimate = true")  # fmt: skip


def _numbers(places: np.ndarray) -> str:
    """joint 2; joints 1, 3."""
    return f"joint{'s' if len(places) > 1 else ''} {', '.join(str(int(j) + 1) for j in places)}"


_SENTENCES: dict[str, Callable[[Reading, ArmTable, Sequence[ArmTable]], Sentence]] = {
    "joints": _joints,
    "convention": _convention,
    "order": _order,
    "sign": _sign,
    "offset": _offset,
    "coupled": _coupled,
    "sliding": _sliding,
    "twisted": _twisted,
    "angle": _angle,
    "length": _length,
    "quaternion": _quaternion,
    "euler": _euler,
    "euler_angle": _euler_angle,
    "mirror": _mirror,
    "turned_back": _turned_back,
    "inverse": _inverse,
    "shift": _shift,
    "free": _free,
    "scalar_last": _scalar_last,
}
