"""Messages of flight as plain values for the browser: names, degrees, millimetres, and limits as words.

"limit" is "ok", "near" or "beyond": the browser shows it as colour and shape."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from kincal.flight import event_name, event_text, library, status_name
from kincal.link import crc_text, names, unsigned32
from kincal_shared.keys import other_than

if TYPE_CHECKING:
    from kincal.link.messages import (
        Ack,
        ArmState,
        Detection,
        Event,
        Hk,
        Image,
        PantiltState,
        Progress,
        Proposal,
    )

Plain = dict[str, Any]
NEAR_SHARE = 0.05  # of the range of a joint: so close to a limit is "near"
_WORKING = "Flight works by itself."
# state -> what goes on, and whether somebody is waited for
_DOES = {
    "IDLE": ("No calibration runs.", "nobody"),
    "MOVE": ("The arm moves along a verified path to the candidate.", "flight"),
    "AIM": ("The pan-tilt unit turns to the tool.", "flight"),
    "SETTLE": ("Arm and pan-tilt unit come to rest.", "flight"),
    "OBSERVE": ("A frame is requested.", "camera"),
    "SERVO": ("A servo step is under way.", "flight"),
    "SEARCH": ("Tags are not in view: a frame is requested at a search position.", "camera"),
    "MEASURE": ("Several frames are taken at rest.", "camera"),
    "UPDATE": ("The estimate is updated with the newest pose.", "flight"),
    "REVIEW": ("A correction is proposed and waits for a decision.", "operator"),
    "ARMED": ("An approval is armed and waits for its second step, GO.", "operator"),
    "SAFE": ("Aborted: the arm is held. START begins a new calibration.", "operator"),
    "SEED": ("No tags: the arm moves to the seed.", "flight"),
    "RETREAT": ("Tags lost: the arm returns to where they were detected last.", "flight"),
    "WITHDRAW": ("Every joint moves back to one side, to approach from there.", "flight"),
    "APPROACH": ("Every joint approaches from the same side.", "flight"),
    "REST": ("Arm at rest again before measuring.", "flight"),
    "TURN": ("The pan-tilt unit turns to the next search position.", "flight"),
    "REFINE": ("The estimate is tried from a second start.", "flight"),
    "LEARN": ("Outliers and model mismatch are looked for.", "flight"),
    "REPORT": ("The uncertainty is predicted and progress reported.", "flight"),
    "SELECT": ("The next candidate is chosen.", "flight"),
    "PROPOSE": ("The verdict is formed and the correction proposed.", "flight"),
    "STORE": ("A change is being stored.", "flight"),
}


CHECKED = 3
"""Of hk_t.staged_state."""


def finite(value: float) -> float | None:
    """The number, or None where JSON has no word for it."""
    return value if math.isfinite(value) else None


def _rounded(values: Iterable[float], digits: int = 6) -> list[float | None]:
    return [None if not math.isfinite(v) else round(v, digits) for v in values]


def crc(value: int) -> str:
    """Eight hex digits; empty for none."""
    return crc_text(value) if value else ""


def kinds() -> dict[int, str]:
    """Number -> name of the table kinds."""
    return {number: name for name, number in library("flight").enum("kc_tbl_kind_t", "KC_TBL_").items()}


def housekeeping(m: Hk) -> Plain:
    """KC_HK."""
    state = names.state_name(m.state)
    text, waits_for = _DOES.get(state, (_WORKING, "flight"))
    proposal = crc(m.proposal_crc)
    if state == "IDLE" and proposal:
        text, waits_for = "A correction waits for a decision.", "operator"
    kind = kinds()
    return {
        "state": state,
        "text": text,
        "waits_for": waits_for,
        "session": m.session,
        "poses": m.n_poses,
        "poses_goal": m.n_poses_goal,
        "candidate": m.candidate,
        "servo_steps": m.servo_steps,
        "measured": m.n_meas,
        "rejected": m.n_rejected,
        "commands_accepted": m.n_cmd_ok,
        "commands_refused": m.n_cmd_refused,
        "events": m.n_events,
        "events_dropped": m.n_events_dropped,
        "tx_errors": m.n_tx_errors,
        "rx_errors": m.n_rx_errors,
        "tables": {kind[i]: crc(m.table_crc[i]) for i in kind if i < len(m.table_crc) and i > 0},
        "staged": kind.get(m.staged_kind, "") if m.staged_kind else "",
        "staged_bytes": m.staged_bytes,
        "staged_checked": m.staged_state == CHECKED,
        "boot_count": m.boot_count,
        "proposal": proposal,
        "proposal_verdict": names.verdict_name(m.proposal_verdict) if proposal and m.proposal_verdict else "",
        "approval_left_s": round(m.approval_left_us * 1e-6, 1),
        "armed_key": m.armed_key,
        "two_holders": bool(m.go_by_other_key),
        "go_by": other_than(m.armed_key) if m.armed_key and m.go_by_other_key else "",
        "energy_j": finite(round(m.energy_j, 1)) if math.isfinite(m.energy_j) else None,
        "monitor": _monitor(m),
    }


def _monitor(m: Hk) -> Plain:
    """The miscalibration monitor in a sentence."""
    if m.mon_state == 0:
        return {"limit": "ok", "text": "quiet"}
    if m.mon_state == 1 and m.mon_joint:
        text = (
            f"joint {m.mon_joint} reads wrong by {math.degrees(m.mon_bias):.3f} ± "
            f"{math.degrees(m.mon_sigma):.3f}° (false alarm probability at most {m.mon_p:.2g})"
        )
        return {"limit": "near", "text": text}
    if m.mon_state == 3:
        sure = ", ".join(f"{j} ({p:.0%})" for j, p in enumerate(m.mon_chance, 1) if p >= 0.01)
        return {"limit": "near", "text": f"joints read wrong together; probability of each: {sure}"}
    return {"limit": "near", "text": f"unexplained residuals, {m.mon_n_obs} observations"}


def arm_state(m: ArmState, joints: Sequence[Mapping[str, Any]] = ()) -> Plain:
    """KC_ARM_STATE; joints: name, unit, q_min and q_max of each, in its unit (from the ARM table)."""
    rows = []
    for j in range(m.n_joints):
        about = joints[j] if j < len(joints) else _unknown(j)
        scale = 180.0 / math.pi if about["unit"] == "deg" else 1e3
        value = m.q_rad[j] * scale
        rows.append(
            {
                "name": about["name"],
                "unit": about["unit"],
                "value": None if not math.isfinite(value) else round(value, 3),
                "target": finite(round(m.q_cmd_rad[j] * scale, 3)),
                "rate": finite(round(m.dq_rad_s[j] * scale, 3)),
                "min": about["min"],
                "max": about["max"],
                "limit": joint_limit(value, about["min"], about["max"]),
                "fault": bool(m.fault_mask >> j & 1),
            }
        )
    return {"joints": rows, "moving": bool(m.moving), "faults": m.fault_mask != 0, "temp_c": finite(m.temp_c)}


def _unknown(j: int) -> Mapping[str, Any]:
    """A joint of which there is no table."""
    return {"name": f"J{j + 1}", "unit": "deg", "min": None, "max": None}


def joint_limit(value: float, low: float | None, high: float | None) -> str:
    """Where a joint stands against its limits."""
    if low is None or high is None:
        return "ok"
    if not math.isfinite(value) or value < low or value > high:
        return "beyond"
    near = NEAR_SHARE * (high - low)
    return "near" if value < low + near or value > high - near else "ok"


def pantilt(m: PantiltState) -> Plain:
    """KC_PANTILT_STATE."""
    return {
        "pan_deg": finite(round(math.degrees(m.pan_rad), 3)),
        "tilt_deg": finite(round(math.degrees(m.tilt_rad), 3)),
        "moving": bool(m.moving),
    }


def detection(m: Detection) -> Plain:
    """KC_DETECTION: tags with their corners [px]."""
    n = m.n_tags
    return {
        "tags": [
            {
                "id": m.tag_id[k],
                "corners_px": [_rounded(m.corner_px[8 * k + 2 * c : 8 * k + 2 * c + 2], 2) for c in range(4)],
            }
            for k in range(n)
        ],
        "seq": m.seq,
        "rms_px": finite(round(m.rms_px, 3)),
        "range_m": finite(round(m.range_m, 3)),
        "incidence_deg": finite(round(math.degrees(m.incid_rad), 1)),
        "tool_px": _rounded((m.u_px, m.v_px), 1) if n else None,
    }


def frame(m: Image) -> Plain:
    """KC_IMAGE without the image itself, which is asked for by `key`: its number, or in a recording that of
    the frame in the file."""
    return {"seq": m.seq, "key": getattr(m, "key", m.seq), "size_px": [m.width_px, m.height_px]}


def pose(m: Progress) -> Plain:
    """KC_PROGRESS: a line of the calibration."""
    return {
        "t_us": m.t_us,
        "session": m.session,
        "pose": m.pose,
        "goal": m.n_goal,
        "candidate": m.candidate,
        "servo_steps": m.servo_steps,
        "res_mm": finite(m.res_pos_m * 1e3),
        "res_mrad": finite(m.res_rot_rad * 1e3),
        "fit_mm": finite(m.fit_pos_m * 1e3),
        "pred_mm": finite(m.pred_pos_m * 1e3),
        "pred_mrad": finite(m.pred_rot_rad * 1e3),
        "rank": m.rank,
        "free": m.n_free,
    }


def proposal(m: Proposal) -> Plain:
    """KC_PROPOSAL: a line of the inbox."""
    return {
        "t_us": m.t_us,
        "crc": crc_text(m.crc),
        "session": m.session,
        "verdict": names.verdict_name(m.verdict),
        "poses": m.n_poses,
        "ended": names.ended_text(m.ended, m.verdict),
        "outliers": m.n_outliers,
        "before_mm": finite(m.before_pos_m * 1e3),
        "fit_mm": finite(m.fit_pos_m * 1e3),
        "p_fit": finite(m.p_fit),
        "replaces": crc_text(m.crc_kin_before),
    }


def event(m: Event) -> Plain:
    """KC_EVENT, a row of the log; name, cause and action are looked up by the browser in `dictionary`."""
    return {
        "kind": "event",
        "t_us": m.t_us,
        "severity": names.severity_name(m.severity),
        "name": event_name(m.id) or f"event {m.id}",
        "text": event_text(m.id, m.index, m.got, m.want),
    }


def ack(m: Ack) -> Plain:
    """KC_ACK, a row of the log."""
    command = _opcodes().get(m.opcode, f"command {m.opcode}")
    source = {1: "executive", 2: "ground"}.get(m.source, f"source {m.source}")
    accepted = m.status == 0
    reason = event_name(m.event_id) if m.event_id else ""
    text = f"{command} of {source} (number {m.seq}) " + (
        "accepted" if accepted else f"refused: {status_name(m.status)}" + (f", {reason}" if reason else "")
    )
    return {
        "kind": "ack",
        "t_us": m.t_us,
        "severity": "info" if accepted else "error",
        "name": "ACCEPTED" if accepted else "REFUSED",
        "text": text,
        "about": reason,
    }


def _opcodes() -> dict[int, str]:
    return {number: name for name, number in library("flight").enum("kc_opcode_t", "KC_CMD_").items()}


def table_mismatch(hk: Plain, mine: Mapping[str, int]) -> list[str]:
    """Tables of this console that are not those in force on board, in words; mine: kind -> CRC."""
    return [
        f"{kind}: on board {hk['tables'][kind]}, in this console {unsigned32(value):08x}"
        for kind, value in mine.items()
        if hk["tables"].get(kind) and hk["tables"][kind] != f"{unsigned32(value):08x}"
    ]
