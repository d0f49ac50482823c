"""A fitted model as JSON: every number with its unit, the covariance, and what the numbers mean."""

from __future__ import annotations

from typing import Any

from kincal.rotations import Pose
from kincal_shared.schema.arm import ArmTable

from .calibrated import CalibratedArm, FittedTerm, component_name, frame_name, term_text
from .dh import DhTable

Json = dict[str, Any]

FORMAT = "kincal-model/1"
_FORMULA = (
    "T(q) = base E0 L1(q1) E1 ... Ln(qn) En tool Etool; L = Rz(phi + q) Tz(d) Tx(a) Rx(alpha), of a "
    "prismatic joint Rz(phi) Tz(d + q) Tx(a) Rx(alpha); E = Tx Rx Ty Ry Rz Tz of the twist at that frame; "
    "twist component += coefficient x gain x basis"
)


def document(arm: CalibratedArm, table: DhTable) -> Json:
    """The whole model as plain values."""
    found_base, found_tool = arm.found_frames()
    return {
        "format": FORMAT,
        "formula": _FORMULA,
        "arm": _arm(arm.arm),
        "fit": arm.record.model_dump(mode="json", exclude={"covariance"}),
        "frames": {
            "base": _pose(arm.base),
            "tool": _pose(arm.tool),
            "base_found": _pose(found_base),
            "tool_found": _pose(found_tool),
        },
        "dh": [{**vars(p), "corrected": p.corrected} for p in table.parameters],
        "dh_frames": {"base": _pose(table.base.pose), "tool": _pose(table.tool.pose)},
        "dh_left_out": [vars(one) for one in table.left_out],
        "coefficients": [
            {
                "name": c.name,
                "group": c.group,
                "unit": c.unit,
                "value": c.value,
                "std_err": c.std_err,
                "prior_sigma": c.prior_sigma,
                "identifiable": c.identifiable,
            }
            for c in arm.coefficients
        ],
        "covariance": arm.covariance.tolist(),
        "terms": [_term(term) for term in arm.terms],
    }


def _arm(arm: ArmTable) -> Json:
    keys = ("name", "link", "a_m", "alpha_rad", "d_m", "phi_rad", "q_min", "q_max", "mass_kg", "com_m")
    return {
        "name": arm.name,
        "convention": "standard",
        "gravity_m_s2": [float(x) for x in arm.gravity_m_s2],
        "joints": [
            {"type": "prismatic" if j.prismatic else "revolute", **{key: getattr(j, key) for key in keys}}
            for j in arm.joints
        ],
    }


def _pose(pose: Pose) -> Json:
    return {"xyz_m": pose.p_m.tolist(), "quat_wxyz": pose.quat_wxyz.tolist()}


def _term(term: FittedTerm) -> Json:
    return {
        "coefficient": term.coefficient.name,
        "at": frame_name(term.frame),
        "component": component_name(term.comp),
        "factor": term.factor,
        "basis": term_text(term),
    }
