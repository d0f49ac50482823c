"""A fitted arm as URDF: a serial chain whose fixed transforms hold everything that is constant in the model.

T = base E_0 Rz(phi_1) | Rz(q_1) | Tz(d_1) Tx(a_1) Rx(alpha_1) E_1 Rz(phi_2) | Rz(q_2) | ...: what stands
between two motions is the origin of the next joint, whose axis is z.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import escape, quoteattr

from kincal.flight import FRAME_TOOL
from kincal.rotations import Floats, Pose
from kincal_shared.schema.arm import Joint

from .calibrated import CalibratedArm, screw, twist_pose
from .leftout import LeftOut, left_out

_NO_LIMITS = 'effort="1000" velocity="1"'


def urdf_left_out(arm: CalibratedArm) -> tuple[LeftOut, ...]:
    """Effects of the model that a URDF cannot carry: all that is not a constant transform of the arm."""
    return left_out(arm, [term for term in arm.terms if not term.constant or term.on_sensor])


def urdf(arm: CalibratedArm) -> str:
    """The URDF: base link (the measurement frame), a link for each joint, the tool (the measured frame)."""
    names, links, origins = _joint_names(arm), _link_names(arm), _origins(arm)
    body = [f"  <link name={quoteattr(name)}/>" for name in links]
    for k, joint in enumerate(arm.arm.joints):
        body += _joint(joint, names[k], links[k], links[k + 1], origins[k])
    body += _fixed(names[-1], links[-2], links[-1], origins[-1])
    head = [
        '<?xml version="1.0" encoding="utf-8"?>',
        _comment(arm),
        f"<robot name={quoteattr(arm.arm.name)}>",
    ]
    return "\n".join([*head, *body, "</robot>"]) + "\n"


def _origins(arm: CalibratedArm) -> list[Pose]:
    """n origins of the moving joints, each in the link before, then that of the tool."""
    pose, out = arm.base @ twist_pose(arm.constant_twist(0)), []
    for number, joint in enumerate(arm.arm.joints, 1):
        out.append(pose @ screw(2, joint.d_m if joint.prismatic else 0.0, joint.phi_rad))
        rest = screw(2, 0.0 if joint.prismatic else joint.d_m, 0.0) @ screw(0, joint.a_m, joint.alpha_rad)
        pose = rest @ twist_pose(arm.constant_twist(number))
    return [*out, pose @ arm.tool @ twist_pose(arm.constant_twist(FRAME_TOOL))]


def _joint_names(arm: CalibratedArm) -> list[str]:
    """Names of the moving joints as the arm table has them, then that of the tool's fixed joint."""
    given = [joint.name or f"joint_{k}" for k, joint in enumerate(arm.arm.joints, 1)]
    return _different([*given, "tool_joint"])


def _link_names(arm: CalibratedArm) -> list[str]:
    """n + 2 links: those of the URDF that the arm table came from, if it did."""
    base = arm.arm.provenance.get("base_link", "base_link")
    tip = arm.arm.provenance.get("tip_link", "tool")
    inner = [joint.link or f"link_{k}" for k, joint in enumerate(arm.arm.joints, 1)]
    return _different([base, *(f"{name}_of_joint" if name in (base, tip) else name for name in inner), tip])


def _different(names: list[str]) -> list[str]:
    """The names, numbered where two are the same: a URDF needs each to be its own."""
    out: list[str] = []
    for name in names:
        free = (f"{name}_{k}" if k else name for k in range(len(names) + 1))
        out.append(next(one for one in free if one not in out))
    return out


def _joint(joint: Joint, name: str, parent: str, child: str, origin: Pose) -> list[str]:
    kind = "prismatic" if joint.prismatic else "revolute"
    return [
        f"  <joint name={quoteattr(name)} type={quoteattr(kind)}>",
        f"    <parent link={quoteattr(parent)}/>",
        f"    <child link={quoteattr(child)}/>",
        f"    {_origin(origin)}",
        '    <axis xyz="0 0 1"/>',
        f'    <limit lower="{float(joint.q_min)!r}" upper="{float(joint.q_max)!r}" {_NO_LIMITS}/>',
        "  </joint>",
    ]


def _fixed(name: str, parent: str, child: str, origin: Pose) -> list[str]:
    return [
        f'  <joint name={quoteattr(name)} type="fixed">',
        f"    <parent link={quoteattr(parent)}/>",
        f"    <child link={quoteattr(child)}/>",
        f"    {_origin(origin)}",
        "  </joint>",
    ]


def _origin(pose: Pose) -> str:
    xyz = " ".join(repr(float(x)) for x in pose.p_m)
    rpy = " ".join(repr(x) for x in roll_pitch_yaw(pose.R))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def roll_pitch_yaw(R: Floats) -> tuple[float, float, float]:
    """Angles of R = Rz(yaw) Ry(pitch) Rx(roll) [rad]. Roll is found after yaw was taken out, so that the
    product is R to rounding also where pitch is 90 degrees and the two are not unique."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw


def _comment(arm: CalibratedArm) -> str:
    lines = [f"{arm.arm.name}, calibrated. Made by kincal model export.", arm.sources]
    lines += [
        "Effort and velocity limits are placeholders: the arm table has none. z of a link is its joint axis."
    ]
    lines += [f"not contained: {one}" for one in urdf_left_out(arm)]
    text = "\n  ".join(escape(" ".join(line.split())).replace("--", "- -") for line in lines)
    return f"<!--\n  {text}\n-->"
