"""What a camera sees of a target of many points: as the arm table states it, or as it is assumed.

A pose that was computed from many points (a board) depends on faults of camera and target through all
points that were seen. Where arm table and data do not say which these are, several typical cameras and
boards compete; each assumption is a pair of constants of the effects that need it (METHOD.md 13.1).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from kincal.rotations import Pose, matrix_of_wxyz
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from ..numerics.types import Array

# Fields of view of typical cameras, width x height [deg]: a depth camera's colour image first, then a
# wide one and a 4:3 webcam.
FIELDS_DEG = ((70.0, 44.0), (84.0, 58.0), (58.0, 45.0))
# Half the width of an assumed board, over half that of the image at the median distance.
FILLS = (0.7, 0.4, 1.0)
_POINTS_ACROSS = 7  # of an assumed board
_MOST_OBLIQUE = 0.5  # cosine between the viewing directions' mean and the normal of z = 0
_SAME = 1e-9

Constants = tuple[tuple[str, float], ...]
SIGHT_CONSTANTS = ("field_deg", "fill")
"""Constants of an effect that assume something of camera and target."""


def sight_constants(constants: Constants) -> Constants:
    """Those of an effect's constants that assume something of camera and target."""
    return tuple(c for c in constants if c[0] in SIGHT_CONSTANTS)


@dataclass(frozen=True)
class Assumption:
    """What is assumed of camera and target; None: the arm table states it.

    field_deg: width and height of the image; fill: size of a square board, see FILLS.
    """

    field_deg: tuple[float, float] | None
    fill: float | None

    @property
    def constants(self) -> Constants:
        """The same as named constants of an effect; empty if nothing is assumed."""
        field = (("field_deg", self.field_deg[0]),) if self.field_deg else ()
        return field + ((("fill", self.fill),) if self.fill else ())

    def meant_by(self, known: Constants) -> bool:
        """Whether constants that are known from an earlier fit name this assumption, or none."""
        values = dict(known)
        return all(abs(values.get(name, x) - x) < _SAME for name, x in self.constants)


@dataclass(frozen=True)
class Sight:
    """A camera and the points it looks at.

    points_m: (m, 3) in the target's frame; second_m: those of poses with tag = 1, None if they are the same;
    low, high: (2,) borders of the image, normalised; focal:
    (2,) what a unit of normalised image position along u and v weighs (pixels, or 1).
    """

    points_m: Array
    low: Array
    high: Array
    focal: Array
    second_m: Array | None = None


def sees_points(arm: ArmTable, data: Measurements | None) -> bool:
    """Whether poses come from a camera and a target of many points, so far as that can be known: a camera
    on the flange, or a camera with its pose and `points_m`. Orientations are needed."""
    if arm.mount == "tool":
        return data is None or (
            data.quat_wxyz is not None and not data.has("cam") and _target_known(arm, data)
        )
    if arm.target_points_m is None:
        return False
    return data is None or (data.quat_wxyz is not None and data.has("cam"))


def _target_known(arm: ArmTable, data: Measurements) -> bool:
    """The target's place is stated, or follows from where the camera looked."""
    return arm.target_points_m is not None or _centre(_all_of(data)) is not None


def assumptions(arm: ArmTable) -> tuple[Assumption, ...]:
    """Everything that is assumed in turn where the arm table is silent, the most typical first."""
    fields = FIELDS_DEG if arm.camera is None else (None,)
    fills = FILLS if arm.target_points_m is None else (None,)
    return tuple(Assumption(field, fill) for fill, field in itertools.product(fills, fields))


def sights(arm: ArmTable, data: Measurements) -> tuple[Sight, ...]:
    """The sight of every assumption, in their order. What is assumed of the target follows from where the
    camera looked in all poses of the set that `data` were taken from."""
    found = _centre(_all_of(data)) if arm.target_points_m is None else None
    return tuple(_sight(arm, found, assumption) for assumption in assumptions(arm))


def _all_of(data: Measurements) -> Measurements:
    return data if data.whole is None else data.whole


def _sight(arm: ArmTable, found: tuple[Array, float] | None, assumed: Assumption) -> Sight:
    low, high, focal = _image(arm, assumed)
    points = arm.target_points_m
    if points is None:
        assert found is not None and assumed.fill is not None  # sees_points said so
        centre, distance = found
        points = centre + _board(assumed.fill * distance * float(high[0] - low[0]) / 2.0)
    return Sight(points, low, high, focal, arm.target_second_m)


def _image(arm: ArmTable, assumed: Assumption) -> tuple[Array, Array, Array]:
    """Borders of the image, normalised, and focal lengths."""
    if assumed.field_deg is not None:
        half = np.tan(np.radians(assumed.field_deg) / 2.0)
        return -half, half, np.ones(2)
    camera = arm.camera
    assert camera is not None  # nothing is assumed of it
    focal = np.array([camera.fx_px, camera.fy_px])
    middle = np.array([camera.cx_px, camera.cy_px])
    size = np.array([camera.width_px or 2.0 * middle[0], camera.height_px or 2.0 * middle[1]])
    return -middle / focal, (size - middle) / focal, focal


def _board(half_m: float) -> Array:
    """(m, 3) points of a square board about its centre."""
    across = np.linspace(-half_m, half_m, _POINTS_ACROSS)
    return np.array([(x, y, 0.0) for x in across for y in across])


def _centre(data: Measurements) -> tuple[Array, float] | None:
    """Where the optical axes meet the target's plane z = 0 (medians), and from how far [m]; None where the
    camera did not look at that plane."""
    assert data.quat_wxyz is not None
    axis = matrix_of_wxyz(data.quat_wxyz)[:, :, 2]
    if abs(float(axis[:, 2].mean())) < _MOST_OBLIQUE:
        return None
    towards = np.abs(axis[:, 2]) > 0.1
    distance = -data.p_m[towards, 2] / axis[towards, 2]
    if np.median(distance) <= 0.0:
        return None
    points = data.p_m[towards] + distance[:, None] * axis[towards]
    x, y = np.median(points[:, :2], axis=0)
    return np.array([x, y, 0.0]), float(np.median(distance))


def in_words(arm: ArmTable, data: Measurements) -> str:
    """What is assumed of camera and target, and how to state it; empty where nothing is."""
    if not sees_points(arm, data):
        return ""
    assumed = assumptions(arm)[0]
    parts = [
        *(_target_in_words(data) if assumed.fill else ()),
        *(_camera_in_words() if assumed.field_deg else ()),
    ]
    if not parts:
        return ""
    return (
        "camera effects act on all points of the target. The arm table does not give these, so several "
        f"assumptions are tried: {', seen by '.join(parts)}. To give them: {' and '.join(_keys(assumed))}"
    )


def _target_in_words(data: Measurements) -> tuple[str]:
    found = _centre(_all_of(data))
    assert found is not None  # sees_points said so
    (x, y, _), distance = found
    sizes = ", ".join(f"{fill:g}" for fill in sorted(FILLS))
    where = f"at ({x:.3f}, {y:.3f}, 0) m in its frame, where the camera looked, {distance:.2f} m away"
    return (f"a square board {where}, {sizes} times as wide as the image there",)


def _camera_in_words() -> tuple[str]:
    fields = ", ".join(f"{width:.0f} x {height:.0f}" for width, height in FIELDS_DEG)
    return (f"a camera with a field of view of {fields} degrees",)


def _keys(assumed: Assumption) -> list[str]:
    target = ["[target] points_m"] if assumed.fill else []
    return target + (["[sensor] fx_px .. height_px"] if assumed.field_deg else [])


def camera_poses(arm: ArmTable, data: Measurements) -> Pose | None:
    """(N,) poses of a camera that stands in the world; None for one on the flange."""
    if arm.mount == "tool":
        return None
    assert data.cam_p_m is not None and data.cam_quat_wxyz is not None
    return Pose(data.cam_p_m, matrix_of_wxyz(data.cam_quat_wxyz))
