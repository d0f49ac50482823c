"""Messages of flight software before this one: what a log, or an older flight, still holds.

A message type changes by fields at its end, and nothing else: then the bytes of the former type are the first
part of today's. An LCM packet begins with the fingerprint of its type; a former one is known here with how
the fields that it lacks are filled. Each is a row, found in `git log fsw/msg`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kincal.flight import library

if TYPE_CHECKING:
    from .messages import Hk, LcmMessage, Meas, Proposal

_FINGERPRINT_BYTES = 8
_BOUND_BYTES = 1 + 4 + 3 * 8  # ended, n_checked, confidence and bounds of a proposal

_HK_BYTES = (
    8 * 8 + 2 * 4 + 4
)  # of housekeeping: probability of each joint, holders, table before the one in force


@dataclass(frozen=True)
class Former:
    """A former type. type: its name, which is today's; more_bytes: by how much today's message is longer;
    fill: gives the fields that it lacks their values."""

    type: str
    more_bytes: int
    fill: Callable[[Any], None]


def _with_an_exact_camera(p: Proposal) -> None:
    """Errors of the camera chain were not stated: predicted errors are those of the noise, in each frame."""
    p.frame = library("flight").constant("KC_RIGHT_IN_LANDER")
    p.pred_noise_pos_m = p.pred_camera_pos_m = p.pred_lander_pos_m = p.pred_pos_m
    p.pred_noise_rot_rad = p.pred_camera_rot_rad = p.pred_lander_rot_rad = p.pred_rot_rad
    _with_no_bound(p)


def _with_no_bound(p: Proposal) -> None:
    """Why the calibration ended was not said, and a bound not stated: confidence 0, the predicted error."""
    p.bound_pos_m, p.bound_rot_rad = p.pred_pos_m, p.pred_rot_rad


def _with_a_verdict_unknown(_hk: Hk) -> None:
    """The verdict of what waits was not kept, nor the time left of an approval: zeros say so."""


def _at_its_pose(m: Meas) -> None:
    """One observation a pose."""
    m.observation = m.pose


def _without_two_holders(_hk: Hk) -> None:
    """The monitor gave no probability, one key gave both steps of an approval, and the table for a rollback
    was not named: zeros say so."""


FORMER = {
    bytes.fromhex("3f21d63a11cc6583"): Former("meas_t", 2 * 4, _at_its_pose),
    bytes.fromhex("049802873f024b41"): Former("proposal_t", 1 + 6 * 8 + _BOUND_BYTES, _with_an_exact_camera),
    bytes.fromhex("df12965a365c8720"): Former("proposal_t", _BOUND_BYTES, _with_no_bound),
    bytes.fromhex("dbe6b2f24599f62e"): Former("hk_t", 4 + 8 + _HK_BYTES, _with_a_verdict_unknown),
    bytes.fromhex("049edd800f911cd3"): Former("hk_t", _HK_BYTES, _without_two_holders),
}
"""By fingerprint."""


def decode(today: Any, data: bytes) -> LcmMessage:
    """Message of the type `today` (a class of lcm-gen), from bytes of it or of a former type of that name.
    ValueError if they are neither."""
    former = FORMER.get(bytes(data[:_FINGERPRINT_BYTES]))
    message: LcmMessage
    if former is None or former.type != today.__name__:
        message = today.decode(data)
        return message
    fingerprint: bytes = today._get_packed_fingerprint()  # noqa: SLF001 lcm-gen offers nothing else
    message = today.decode(fingerprint + data[_FINGERPRINT_BYTES:] + bytes(former.more_bytes))
    former.fill(message)
    return message
