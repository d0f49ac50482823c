"""Why a tool pose or a posture is not taken into a search space."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """Kinds of rejection, in the order in which a sample meets them. A rejection is the kind, or the kind, a
    colon and the detail (`with_detail`)."""

    OUTSIDE_BOX = "outside the position box"
    RANGE = "too close to or too far from the camera"
    PANTILT = "pan-tilt limits"
    OBLIQUE = "tags too oblique or facing away"
    FEW_TAGS = "too few tags in the image"
    SMALL_TAGS = "tags too small in the image"
    UNREACHED = "not reached inside the joint margins"
    JOINT_LIMITS = "joint limits"
    CONTACT_NOMINAL = "too close (nominal arm)"
    HIDDEN_TAGS = "tags hidden by the arm"
    SERVO_REACH = "out of the servo's reach"
    CONTACT_ERRORS = "too close (arm with errors)"
    SERVO_BOUND = "contact inside the servo bound"
    NO_SEGMENT = "no clear segment to a hub"

    def with_detail(self, detail: str) -> str:
        """The kind with its detail, e.g. the pair of shapes that touch."""
        return f"{self}: {detail}"


def kind_of(rejection: str) -> Reason:
    """Kind of a rejection, with or without detail. ValueError if it is none."""
    return Reason(rejection.partition(": ")[0])
