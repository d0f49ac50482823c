"""Corner noise, pose and covariance of the tag detector once more, in numpy: the test's own reference.

Poses are (R, p) of a tag or of the tool in the camera frame; px (4, 2) the corners of a tag in libapriltag's
order.
"""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from kincal_sim.vision import pnp

EDGE_PX, ALIGNED_PX, WEIGHT = 0.0225, 0.075, 10.0  # detector.yml
ALONG, ACROSS, SIGMAS = 30, 8, 4.0


def turn(w):
    """Rotation by a rotation vector."""
    return cv2.Rodrigues(np.asarray(w, float))[0]


def vector(R):
    """Rotation vector."""
    return cv2.Rodrigues(R)[0].ravel()


def project(K, R, p, points) -> np.ndarray:
    """(..., k, 2) pixels of the points at one pose or many."""
    seen = points @ np.swapaxes(R, -1, -2) + p[..., None, :]
    return seen[..., :2] / seen[..., 2:] * np.diag(K)[:2] + K[:2, 2]


def jacobian(K, R, p, points) -> np.ndarray:
    """(..., 2k, 6) d pixels / d (position, rotation vector), camera frame, rotation error on the left."""
    r = points @ np.swapaxes(R, -1, -2)
    x, y, z = np.moveaxis(r + p[..., None, :], -1, 0)
    D, cross = np.zeros((*z.shape, 2, 3)), np.zeros((*z.shape, 3, 3))
    D[..., 0, 0], D[..., 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    D[..., 1, 1], D[..., 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -r[..., 2], r[..., 1], -r[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    return np.concatenate([D, -D @ cross], axis=-1).reshape(*z.shape[:-1], -1, 6)


def corner_covariance(px) -> np.ndarray:
    """(8, 8): corners are intersections of lines fitted to the edges; each line has an offset and a slope."""
    along = np.roll(px, -1, axis=0) - px
    length = np.linalg.norm(along, axis=1)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
    variance = EDGE_PX**2 + ALIGNED_PX**2 / (1.0 + np.abs(along).min(axis=1) ** 4)
    V = np.zeros((8, 8))
    for k in range(4):
        # line k moves corner k by its offset there, and the next corner by that at its other end
        start, end = np.zeros(8), np.zeros(8)
        start[2 * k : 2 * k + 2] = np.linalg.solve([normal[k - 1], normal[k]], [0.0, 1.0])
        n = (k + 1) % 4
        end[2 * n : 2 * n + 2] = np.linalg.solve([normal[k], normal[n]], [1.0, 0.0])
        middle, slope = start + end, start - end
        V += variance[k] * (np.outer(middle, middle) + 3.0 * np.outer(slope, slope))
    return V


def fit(K, R, p, points, px, information):
    """The likeliest pose from a start nearby: R, p, chi-square, information of the pose."""
    for _ in range(20):
        r = (px - project(K, R, p, points)).ravel()
        J = jacobian(K, R, p, points)
        H = J.T @ information @ J
        step = np.linalg.solve(H, J.T @ information @ r)
        if np.abs(step).max() < 1e-12:
            break
        R, p = turn(step[3:]) @ R, p + step[:3]
    return R, p, float(r @ information @ r), H


def covariance(chi2, n_corners, H) -> np.ndarray:
    """First order."""
    return np.linalg.inv(H) * (WEIGHT + chi2) / (WEIGHT + 2 * n_corners - 6.0)


def average(K, tag, px, first, second):
    """Mean pose of the tool and covariance over the tilts about two fits (R, p of the tool) of one tag."""
    information = np.linalg.inv(corner_covariance(px))
    points = pnp.tool_corners(np.eye(4), tag.size_m)
    Rt, pt = tag.T_tool_tag[:3, :3], tag.T_tool_tag[:3, 3]
    between = vector(second[0] @ first[0].T)
    R0 = turn(0.5 * between) @ first[0]
    centre = 0.5 * (first[0] @ pt + first[1] + second[0] @ pt + second[1])
    line = centre / np.linalg.norm(centre)
    some = np.cross(line, [0.0, 1.0, 0.0])
    flat = between - line * (line @ between) if np.linalg.norm(between) > 0.01 else some
    u = flat / np.linalg.norm(flat)
    v = np.cross(line, u)
    J = jacobian(K, R0 @ Rt, centre, points)
    C = np.linalg.inv(J.T @ information @ J)[3:, 3:]
    reach = 0.5 * np.linalg.norm(between) + SIGMAS * np.sqrt(u @ C @ u), SIGMAS * np.sqrt(v @ C @ v)
    tilts = (np.linspace(-x, x, 2 * n + 1) for x, n in zip(reach, (ALONG, ACROSS), strict=True))
    a, b = (x.reshape(-1, 1) for x in np.meshgrid(*tilts))
    leaning = Rotation.from_rotvec(a * u + b * v).as_matrix() @ R0 @ Rt
    R, p, chi2s, infos = _at_tilts(K, leaning, np.tile(centre, (len(a), 1)), line, points, px, information)
    R = R @ Rt.T
    poses = np.hstack([p - R @ pt, Rotation.from_matrix(R @ R0.T).as_rotvec()])
    logs = -0.5 * (WEIGHT + 4.0) * np.log1p(chi2s / WEIGHT) - 0.5 * np.linalg.slogdet(infos)[1]
    w = np.exp(logs - logs.max())
    w /= w.sum()
    mean = w @ poses
    R = turn(mean[3:]) @ R0
    D = np.zeros((6, 4))
    D[:3, :3] = np.eye(3)
    D[:, 3] = [*np.cross(line, -R @ pt), *line]
    within = np.linalg.inv(np.einsum("n,nij->ij", w, infos)) * (WEIGHT + w @ chi2s) / (WEIGHT + 4.0)
    off = poses - mean
    return R, mean[:3], D @ within @ D.T + (off * w[:, None]).T @ off


def _at_tilts(K, R, p, line, points, px, information):
    """Positions and turns about the line of sight, each fitted at its tilt of a tag."""
    for step in range(3):
        r = (px - project(K, R, p, points)).reshape(len(R), -1)
        J = jacobian(K, R, p, points)
        A = np.dstack([J[..., :3], J[..., 3:] @ line])
        weighed = np.swapaxes(A, 1, 2) @ information
        H = weighed @ A
        if step < 2:
            d = np.linalg.solve(H, weighed @ r[..., None])[..., 0]
            R, p = Rotation.from_rotvec(d[:, 3:] * line).as_matrix() @ R, p + d[:, :3]
    return R, p, np.einsum("ni,ij,nj->n", r, information, r), H
