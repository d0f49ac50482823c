"""Camera and tags as they really are, and what PnP with the nominal numbers makes of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from ..transforms import rot, trans, transform
from ..vision import tags

_EXACT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-15)


@dataclass(frozen=True)
class Optics:
    """Lens, sensor and tags.

    radial: k1, k2; decentring: p1, p2 (as OpenCV has them); grown_px: how far blooming moves every edge of a
    tag outward; tag_offsets: extra 4x4 motion of a tag on its mount, by id.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    tag_size_m: float
    radial: tuple[float, float] = (0.0, 0.0)
    decentring: tuple[float, float] = (0.0, 0.0)
    grown_px: float = 0.0
    tag_offsets: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def K(self) -> np.ndarray:
        """3x3 intrinsics [px]."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


def nominal(spec: dict) -> Optics:
    """The optics of the table."""
    cam = spec["camera"]
    return Optics(cam["fx_px"], cam["fy_px"], cam["cx_px"], cam["cy_px"], spec["tag"][0]["size_m"])


def nominal_tag_pose(spec: dict, tag: int) -> np.ndarray:
    """T_tool_tag (4x4) of the table."""
    row = spec["tag"][tag]
    return trans(*row["xyz_m"]) @ rot("y", row["rot_y_rad"])


def image(optics: Optics, T_cam_tag: np.ndarray) -> np.ndarray:
    """(4, 2) corners of a tag in pixels, through the true lens."""
    lens = np.array([*optics.radial, *optics.decentring, 0.0])
    rvec = cv2.Rodrigues(T_cam_tag[:3, :3])[0]
    corners = tags.corners_m(optics.tag_size_m)
    px, _ = cv2.projectPoints(corners, rvec, T_cam_tag[:3, 3], optics.K, lens)
    px = px.reshape(4, 2)
    return _grown(px, optics.grown_px) if optics.grown_px else px


def _grown(px: np.ndarray, by_px: float) -> np.ndarray:
    """Every edge of the quadrilateral moved outward; the corners are where the edges meet."""
    centre = px.mean(axis=0)
    edges = [_moved_edge(a, b, centre, by_px) for a, b in zip(px, np.roll(px, -1, axis=0), strict=True)]
    return np.array(
        [
            np.linalg.solve(np.array([one[:2], two[:2]]), np.array([one[2], two[2]]))
            for one, two in zip(np.roll(edges, 1, axis=0), edges, strict=True)
        ]
    )


def _moved_edge(a: np.ndarray, b: np.ndarray, centre: np.ndarray, by_px: float) -> np.ndarray:
    """Line n . x = c through a and b, moved away from the centre: (n_x, n_y, c)."""
    normal = np.array([b[1] - a[1], a[0] - b[0]])
    normal /= np.linalg.norm(normal)
    normal *= np.sign(normal @ (a - centre))
    return np.array([*normal, normal @ a + by_px])


def solve_pnp(table: Optics, px: np.ndarray, start: np.ndarray) -> np.ndarray:
    """T_cam_tag (4x4) that PnP finds for corners (4, 2) with the numbers of the table.

    start: near the truth; the mirrored solution is an outlier's business, not an effect's.
    """
    rvec, tvec = cv2.Rodrigues(start[:3, :3])[0], start[:3, 3].reshape(3, 1).copy()
    corners = tags.corners_m(table.tag_size_m)
    rvec, tvec = cv2.solvePnPRefineLM(corners, px, table.K, None, rvec, tvec, criteria=_EXACT)
    return transform(tvec.ravel(), cv2.Rodrigues(rvec)[0])


def incidence_rad(T_cam_tag: np.ndarray) -> float:
    """Angle between the ray to the tag and its normal; 0 = seen from the front."""
    ray = T_cam_tag[:3, 3] / np.linalg.norm(T_cam_tag[:3, 3])
    return float(np.arccos(np.clip(T_cam_tag[:3, 2] @ ray, -1.0, 1.0)))
