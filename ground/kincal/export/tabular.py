"""The corrected DH table as an arm table (TOML), which --arm takes again, and as CSV."""

from __future__ import annotations

import json
from collections.abc import Iterable

from kincal.rotations import Pose
from kincal_shared.schema.arm import ArmTable, Joint

from .calibrated import CalibratedArm
from .dh import DhTable, FoundFrame

_CSV_HEADER = "place,parameter,unit,nominal,correction,corrected,sigma,state"
_SHIFTS_AND_TURNS = (("x", "m"), ("y", "m"), ("z", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad"))


def arm_toml(arm: CalibratedArm, table: DhTable) -> str:
    """The corrected arm table, standard DH, frames as found."""
    given = arm.arm
    lines = [
        f"# {_comment(given.name)}, calibrated. Made by `kincal model export --format dh`.",
        *(f"# not contained: {_comment(str(one))}" for one in table.left_out),
        f"name = {_text(given.name)}",
        'convention = "standard"',
        f"gravity_m_s2 = {_numbers(given.gravity_m_s2)}",
        *_frame("base", table.base.pose),
        *_frame("tool", table.tool.pose),
    ]
    for number, joint in enumerate(given.joints, 1):
        lines += _joint(joint, table.of_joint(number))
    return "\n".join([*lines, *_sensor(given), *_provenance(arm, table)]) + "\n"


def _frame(name: str, pose: Pose) -> list[str]:
    return ["", f"[{name}]", f"xyz_m = {_numbers(pose.p_m)}", f"quat_wxyz = {_numbers(pose.quat_wxyz)}"]


def _joint(joint: Joint, dh: dict[str, float]) -> list[str]:
    unit = "m" if joint.prismatic else "rad"
    texts = {"name": joint.name, "link": joint.link}
    numbers = {"mass_kg": joint.mass_kg, "gear_ratio": joint.gear_ratio}
    return [
        "",
        "[[joint]]",
        *(f"{key} = {_text(text)}" for key, text in texts.items() if text),
        f'type = "{"prismatic" if joint.prismatic else "revolute"}"',
        *(f"{key} = {float(dh[key])!r}" for key in ("a_m", "alpha_rad", "d_m", "phi_rad")),
        f"q_min_{unit} = {float(joint.q_min)!r}",
        f"q_max_{unit} = {float(joint.q_max)!r}",
        *(f"{key} = {float(value)!r}" for key, value in numbers.items() if value is not None),
        *([] if joint.com_m is None else [f"com_m = {_numbers(joint.com_m)}"]),
    ]


def _sensor(arm: ArmTable) -> list[str]:
    lines = ["", "[sensor]", f"mount = {_text(arm.mount)}"]
    if arm.camera is not None:
        values = {key: value for key, value in vars(arm.camera).items() if value is not None}
        lines += [f"{key} = {float(value)!r}" for key, value in values.items()]
    if arm.target_points_m is not None:
        lines += ["", "[target]", f"points_m = {_points(arm.target_points_m)}"]
        if arm.target_second_m is not None:
            lines += [f"second_points_m = {_points(arm.target_second_m)}"]
    return lines


def _provenance(arm: CalibratedArm, table: DhTable) -> list[str]:
    entries = {
        **arm.arm.provenance,
        "calibrated_with": arm.sources,
        "not_contained": "; ".join(map(str, table.left_out)) or "nothing",
    }
    return ["", "[provenance]", *(f"{_text(key)} = {_text(value)}" for key, value in entries.items())]


def dh_csv(arm: CalibratedArm, table: DhTable) -> str:
    """One line for each DH parameter and each component of the frames; sigma empty where nothing was
    estimated. Of a frame, sigma is that of its shift and turn along and about its own axes."""
    rows = [
        f"joint {p.joint},{p.name},{p.unit},{p.nominal!r},{p.correction!r},{p.corrected!r},"
        f"{'' if p.state == 'not estimated' else repr(p.sigma)},{p.state}"
        for p in table.parameters
    ]
    frames = [row for frame in (table.base, table.tool) for row in _frame_rows(frame)]
    notes = [f"# {_comment(arm.sources)}", *(f"# not contained: {_comment(str(o))}" for o in table.left_out)]
    return "\n".join([*notes, _CSV_HEADER, *rows, *frames]) + "\n"


def _frame_rows(frame: FoundFrame) -> list[str]:
    from kincal.rotations import rotvec_of_matrix

    values = [*map(float, frame.pose.p_m), *map(float, rotvec_of_matrix(frame.pose.R))]
    state = "not estimated" if frame.sigma is None else "estimated"
    sigmas = [""] * 6 if frame.sigma is None else [repr(float(s)) for s in frame.sigma]
    rows = zip(_SHIFTS_AND_TURNS, values, sigmas, strict=True)
    return [f"{frame.name},{name},{unit},,,{value!r},{sigma},{state}" for (name, unit), value, sigma in rows]


def _numbers(values: Iterable[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"


def _points(rows: Iterable[Iterable[float]]) -> str:
    return f"[{', '.join(map(_numbers, rows))}]"


def _text(text: str) -> str:
    """A TOML string: JSON's escapes are TOML's."""
    return json.dumps(text, ensure_ascii=False)


def _comment(text: str) -> str:
    return " ".join(text.split())
