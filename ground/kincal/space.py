"""Search spaces: candidate poses that the arm reaches, the camera sees and the limits allow.

First version: reachable, in view, inside limits, and clear of deck and mast by the centre line of the
nominal arm. It does not yet prove freedom from collision with the full shapes of the arm, nor inflate by
the configured error bounds; what was checked is written into every candidate (`why`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from kincal import core, tables
from kincal.errors import KincalError
from kincal.geometry import (
    ArmChain,
    Camera,
    R_to_quat,
    quat_to_R,
    rotation_angle,
    segment_distance,
    with_dh_errors,
)
from kincal.results import Scene

# Bits of kc_cand_t.why: what was checked and found good.
WHY = {
    1: "joints inside their limits with margin",
    2: "tool inside the position box",
    4: "distance to the camera inside its range",
    8: "enough tags inside the image with margin, head aimed at the tool",
    16: "incidence of those tags below the limit",
    32: "head angles inside their limits with margin",
    64: "centre line of the arm clear of deck and mast",
    128: "straight segment from the hub clear of deck and mast",
    256: "line of sight to those tags clear of the arm",
}
WHY_ALL = sum(WHY)
FAULTY_INCID_MAX_RAD = 1.2  # a tag still decodes, though its pose is poor
CAND_MAX, HUB_MAX = 1024, 16


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Joints(_Strict):
    margin_rad: list[float]
    hubs_rad: list[list[float]] = pydantic.Field(min_length=1, max_length=HUB_MAX)
    servo_leash_rad: float = pydantic.Field(gt=0)


class Tool(_Strict):
    box_min_m: tuple[float, float, float]
    box_max_m: tuple[float, float, float]


class View(_Strict):
    range_min_m: float
    range_max_m: float
    tags_min: int = pydantic.Field(ge=1, le=4)
    incid_max_rad: float = pydantic.Field(gt=0, lt=1.5)
    image_margin_px: float = pydantic.Field(ge=0)
    head_margin_rad: float = pydantic.Field(ge=0)


class Clear(_Strict):
    floor_m: float
    mast_radius_m: float
    step_rad: float = pydantic.Field(gt=0, le=0.2)
    direct_max_rad: float = pydantic.Field(ge=0)


class Robust(_Strict):
    """Faults that a prior pose should survive: so many draws of so many DH errors at full size each."""

    draws: int = pydantic.Field(ge=1, le=200)
    faults: int = pydantic.Field(ge=1)
    phi_rad: float
    alpha_rad: float
    a_m: float
    d_m: float


class Spread(_Strict):
    position_m: float = pydantic.Field(gt=0)
    rotation_rad: float = pydantic.Field(gt=0)


class Body(_Strict):
    """A capsule of the arm that may stand in the line of sight, in a DH frame."""

    frame: int = pydantic.Field(ge=0, le=7)
    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    radius_m: float = pydantic.Field(gt=0)


class Sight(_Strict):
    margin_m: float = pydantic.Field(ge=0)
    border: float = pydantic.Field(ge=1)  # printed size of a tag over its black square
    body: list[Body]


class Description(_Strict):
    """space.toml"""

    kind: str
    title: str = ""
    provenance: dict[str, str] = {}
    seed: int
    candidates: int = pydantic.Field(ge=1, le=CAND_MAX)
    pool: int = pydantic.Field(ge=1)
    samples_max: int = pydantic.Field(ge=1)
    priors: int = pydantic.Field(ge=0, le=16)
    joints: Joints
    tool: Tool
    view: View
    clear: Clear
    sight: Sight
    robust: Robust
    spread: Spread


@dataclass
class Built:
    """A finished search space."""

    image: tables.Image
    struct: Any
    n_samples: int
    rejected: dict[str, int]  # why samples were dropped


def read_description(path: Path) -> Description:
    doc = tables.read_toml(path)
    try:
        desc = Description.model_validate(doc)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        raise KincalError(
            f"{'.'.join(map(str, first['loc']))}: {first['msg']}",
            str(path),
            "see tables/src/space.toml for a complete description",
        ) from None
    if desc.kind != "space":
        raise KincalError(f"this is a {desc.kind!r} source, not a search space", str(path))
    return desc


class Search:
    """Checks of one description against one arm and one camera."""

    def __init__(self, desc: Description, arm: Any, camera: Any) -> None:
        self.desc = desc
        self.chain = ArmChain(arm)
        self.camera = Camera(camera)
        n = self.chain.n
        if len(desc.joints.margin_rad) != n or any(len(h) != n for h in desc.joints.hubs_rad):
            raise KincalError(f"the arm has {n} joints; margins and hubs must have as many", "joints")
        margin = np.array(desc.joints.margin_rad)
        self.lo, self.hi = self.chain.q_min + margin, self.chain.q_max - margin
        if np.any(self.lo >= self.hi):
            raise KincalError("margins leave a joint no room", "joints.margin_rad")
        self.mast = np.array(list(camera.mast_xyz_m))
        # The tool as seen with the tags shifted to the image rim: a cheap way to ask for a margin is a
        # camera with a smaller image.
        self._tight = core.ffi.new("kc_camera_t *", camera[0])
        m = desc.view.image_margin_px
        self._tight.width_px = int(camera.width_px - 2 * m)
        self._tight.height_px = int(camera.height_px - 2 * m)
        self._tight.cx_px = camera.cx_px - m
        self._tight.cy_px = camera.cy_px - m
        self.tight = Camera(self._tight)
        self.sizes = [float(t.size_m) for t in camera.tag[0 : int(camera.n_tags)]]

    def look(self, p: np.ndarray, R: np.ndarray) -> tuple[float, float, bool, np.ndarray, np.ndarray]:
        """Head angles that centre the tool, whether they are allowed, and the tool in the camera frame."""
        pan, tilt, reach = self.camera.aim(p)
        c, m = self.camera.camera, self.desc.view.head_margin_rad
        inside = (
            reach
            and c.pan_min_rad + m <= pan <= c.pan_max_rad - m
            and c.tilt_min_rad + m <= tilt <= c.tilt_max_rad - m
        )
        p_cam, R_cam = self.camera.pose(pan, tilt)
        return pan, tilt, inside, R_cam.T @ (p - p_cam), R_cam.T @ R

    def problem(self, q: np.ndarray) -> str:
        """First check that joints q fail, or an empty string."""
        p, R = self.chain.fk(q)
        t, v = self.desc.tool, self.desc.view
        if np.any(p < t.box_min_m) or np.any(p > t.box_max_m):
            return "outside the position box"
        pan, tilt, inside, p_cam, R_cam = self.look(p, R)
        if not v.range_min_m <= np.linalg.norm(p_cam) <= v.range_max_m:
            return "too near to or far from the camera"
        if not inside:
            return "head limits"
        if np.sum(self.camera.incidence(p_cam, R_cam) <= v.incid_max_rad) < v.tags_min:
            return "tags too oblique or facing away"
        seen = self.tight.visible(p_cam, R_cam, v.incid_max_rad)
        if seen.bit_count() < v.tags_min:
            return "too few tags in the image"
        if (seen & self.sight(q, p, R, pan, tilt)).bit_count() < v.tags_min:
            return "the arm hides the tags"
        if not self.clear(q):
            return "too close to deck or mast"
        return ""

    def sight(self, q: np.ndarray, p: np.ndarray, R: np.ndarray, pan: float, tilt: float) -> int:
        """Bit set of tags with no capsule of the arm between the camera and nine points of the print."""
        eye, _ = self.camera.pose(pan, tilt)
        frames = self.chain.frames(q)
        bodies = self.desc.sight.body
        start = np.array([frames[b.frame][0] + frames[b.frame][1] @ b.start_m for b in bodies])
        end = np.array([frames[b.frame][0] + frames[b.frame][1] @ b.end_m for b in bodies])
        room = np.array([b.radius_m for b in bodies]) + self.desc.sight.margin_m
        out = 0
        for i, ((xyz, R_tag), size) in enumerate(zip(self.camera.tags, self.sizes, strict=True)):
            half = 0.5 * self.desc.sight.border * size
            points = np.array(
                [p + R @ (xyz + R_tag @ [x * half, y * half, 0.0]) for x in (-1, 0, 1) for y in (-1, 0, 1)]
            )
            if np.all(segment_distance(np.broadcast_to(eye, points.shape), points, start, end) > room):
                out |= 1 << i
        return out

    def seen(self, q: np.ndarray, pan: float, tilt: float) -> bool:
        """A tag is in the image and not hidden, wherever the tool may be."""
        p, R = self.chain.fk(q)
        p_cam, R_cam = self.camera.pose(pan, tilt)
        mask = self.camera.visible(R_cam.T @ (p - p_cam), R_cam.T @ R, FAULTY_INCID_MAX_RAD)
        return bool(mask and mask & self.sight(q, p, R, pan, tilt))

    def clear(self, q: np.ndarray) -> bool:
        """Centre line of the arm above the deck and away from the mast."""
        points = self.chain.points(q)[2:]  # the base column stands on the deck by design
        steps = np.linspace(0.0, 1.0, 5)[:, None, None]
        line = (points[:-1] * (1.0 - steps) + points[1:] * steps).reshape(-1, 3)
        if np.min(line[:, 2]) < self.desc.clear.floor_m:
            return False
        low = line[line[:, 2] < self.mast[2] + 0.15]
        if len(low) == 0:
            return True
        return bool(np.min(np.hypot(*(low[:, :2] - self.mast[:2]).T)) > self.desc.clear.mast_radius_m)

    def segment_clear(self, a: np.ndarray, b: np.ndarray) -> bool:
        """The same along the straight joint-space segment, both ends included."""
        n = max(int(np.ceil(np.max(np.abs(b - a)) / self.desc.clear.step_rad)), 1)
        return all(self.clear(a + (b - a) * s) for s in np.linspace(0.0, 1.0, n + 1))

    def sample(self, tick: Callable[[int, int], None]) -> tuple[np.ndarray, dict[str, int], int]:
        """Feasible joint vectors, reasons of the others, and how many were tried."""
        d = self.desc
        rng = np.random.default_rng(d.seed)
        good: list[np.ndarray] = []
        rejected: dict[str, int] = {}
        tried = 0
        while len(good) < d.pool and tried < d.samples_max:
            q = rng.uniform(self.lo, self.hi)
            tried += 1
            reason = self.problem(q)
            if reason:
                rejected[reason] = rejected.get(reason, 0) + 1
            else:
                good.append(q)
            if tried % 500 == 0:
                tick(tried, len(good))
        tick(tried, len(good))
        return np.array(good).reshape(-1, self.chain.n), rejected, tried

    def distances(self, p: np.ndarray, R: np.ndarray, i: int) -> np.ndarray:
        """From pose i to all others, in units of the spread."""
        dp = np.linalg.norm(p - p[i], axis=1) / self.desc.spread.position_m
        M = np.einsum("nji,jk->nik", R, R[i])
        v = 0.5 * np.linalg.norm(
            np.stack([M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]]), axis=0
        )
        dr = np.arctan2(v, 0.5 * (np.trace(M, axis1=1, axis2=2) - 1.0)) / self.desc.spread.rotation_rad
        return np.hypot(dp, dr)

    def spread(self, p: np.ndarray, R: np.ndarray, n: int, first: int) -> list[int]:
        """Farthest-point selection: each next pose is the one farthest from those chosen."""
        chosen = [first]
        nearest = self.distances(p, R, first)
        while len(chosen) < min(n, len(p)):
            i = int(np.argmax(nearest))
            chosen.append(i)
            nearest = np.minimum(nearest, self.distances(p, R, i))
        return chosen


def build(
    desc: Description, tables_dir: Path, tick: Callable[[str, int, int], None] = lambda *_a: None
) -> Built:
    """Search, choose, connect. `tick(phase, done, of)` for a progress display."""
    arm_image, arm = tables.load(_need(tables_dir / "arm.tbl"))
    _, camera = tables.load(_need(tables_dir / "camera.tbl"))
    search = Search(desc, arm, camera)
    hubs = [np.array(h) for h in desc.joints.hubs_rad]
    for h, q in enumerate(hubs):
        if not search.clear(q) or np.any(q < search.chain.q_min) or np.any(q > search.chain.q_max):
            raise KincalError(
                f"hub {h} is outside the limits or too close to deck or mast", "joints.hubs_rad"
            )
    q, rejected, tried = search.sample(lambda t, g: tick(f"{t} samples", g, desc.pool))
    q, hub = _connect_to_hubs(search, q, hubs, rejected, tick)
    if len(q) < max(desc.priors, 1):
        worst = max(rejected, key=lambda k: rejected[k]) if rejected else "no samples"
        raise KincalError(
            f"only {len(q)} of {tried} samples are feasible; most fail: {worst}",
            desc.title,
            "widen the box, the view or the margins in the description",
        )
    poses = [search.chain.fk(x) for x in q]
    p, R = np.array([a for a, _ in poses]), np.array([b for _, b in poses])
    middle = int(np.argmin(np.linalg.norm(p - p.mean(axis=0), axis=1)))
    keep = search.spread(p, R, desc.candidates, middle)
    q, hub, p, R = q[keep], hub[keep], p[keep], R[keep]
    space = core.ffi.new("kc_space_t *")
    _fill(space, search, q, hub, p, R, hubs)
    for i, c in enumerate(_priors(search, q, p, R, tick)):
        space.prior[i] = c
    space.n_prior = desc.priors
    space.servo_leash = desc.joints.servo_leash_rad
    space.arm_crc = arm_image.crc
    _edges(space, search, q, tick)
    image = tables.encode("space", space)
    tables.decode(image.data, desc.title)
    return Built(image, space, tried, rejected)


def _need(path: Path) -> Path:
    if not path.is_file():
        raise KincalError(
            "a search space needs the built arm and camera tables",
            str(path),
            "run `kincal table build tables/src tables/bin` or give --tables DIR",
        )
    return path


def _connect_to_hubs(
    search: Search,
    q: np.ndarray,
    hubs: list[np.ndarray],
    rejected: dict[str, int],
    tick: Callable[[str, int, int], None],
) -> tuple[np.ndarray, np.ndarray]:
    """Keep what has a clear straight segment to a hub, nearest hub first."""
    keep, hub = [], []
    for i, x in enumerate(q):
        order = sorted(range(len(hubs)), key=lambda h: (float(np.max(np.abs(x - hubs[h]))), h))
        found = next((h for h in order if search.segment_clear(hubs[h], x)), None)
        if found is None:
            rejected["no clear segment to a hub"] = rejected.get("no clear segment to a hub", 0) + 1
        else:
            keep.append(i)
            hub.append(found)
        if i % 20 == 0 or i + 1 == len(q):
            tick("segments to hubs", i + 1, len(q))
    return q[keep], np.array(hub, dtype=int)


def _fill(
    space: Any,
    search: Search,
    q: np.ndarray,
    hub: np.ndarray,
    p: np.ndarray,
    R: np.ndarray,
    hubs: list[np.ndarray],
) -> None:
    space.n_cand, space.n_hub, space.n_joints = len(q), len(hubs), search.chain.n
    for h, x in enumerate(hubs):
        space.hub_q[h][0 : len(x)] = [float(v) for v in x]
        space.hub_edge[h] = sum(1 << k for k, y in enumerate(hubs) if k != h and search.segment_clear(x, y))
    for i in range(len(q)):
        c = space.cand[i]
        pan, tilt, _inside, p_cam, R_cam = search.look(p[i], R[i])
        c.p_m[0:3] = [float(v) for v in p[i]]
        c.q_wxyz[0:4] = [float(v) for v in R_to_quat(R[i])]
        c.q_seed[0 : search.chain.n] = [float(v) for v in q[i]]
        c.pan_rad, c.tilt_rad = pan, tilt
        c.tags = search.tight.visible(p_cam, R_cam, search.desc.view.incid_max_rad) & search.sight(
            q[i], p[i], R[i], pan, tilt
        )
        c.hub, c.why = int(hub[i]), WHY_ALL


def _priors(
    search: Search, q: np.ndarray, p: np.ndarray, R: np.ndarray, tick: Callable[[str, int, int], None]
) -> list[int]:
    """Starting poses, when nothing is known about the faults yet: among the tenth that shows a tag under most
    of the faults drawn, spread far apart."""
    faulty = _faulty_arms(search)
    score = np.zeros(len(p))
    for i in range(len(p)):
        pan, tilt, *_ = search.look(p[i], R[i])
        score[i] = sum(arm.seen(q[i], pan, tilt) for arm in faulty)
        if i % 20 == 0 or i + 1 == len(p):
            tick("faults at candidates", i + 1, len(p))
    best = np.argsort(-score, kind="stable")[: max(len(p) // 10, search.desc.priors)]
    centre = int(np.argmin(np.linalg.norm(p[best] - p[best].mean(axis=0), axis=1)))
    return [int(best[k]) for k in search.spread(p[best], R[best], search.desc.priors, centre)]


def _faulty_arms(search: Search) -> list[Search]:
    """The same search on arms with drawn DH errors."""
    r, rng, out = search.desc.robust, np.random.default_rng([search.desc.seed, 1]), []
    sizes = {name: getattr(r, name) for name in ("phi_rad", "alpha_rad", "a_m", "d_m")}
    names = [f"J{j + 1}.{name}" for j in range(search.chain.n) for name in sizes]
    for _ in range(r.draws):
        chosen = rng.choice(len(names), r.faults, replace=False)
        errors = {names[k]: float(rng.choice([-1.0, 1.0])) * sizes[names[k].split(".")[1]] for k in chosen}
        out.append(Search(search.desc, with_dh_errors(search.chain.arm, errors), search.camera.camera))
    return out


def _edges(space: Any, search: Search, q: np.ndarray, tick: Callable[[str, int, int], None]) -> None:
    """Direct segments between near candidates; everything else goes over hubs."""
    limit = search.desc.clear.direct_max_rad
    for i in range(len(q)):
        near = np.flatnonzero(np.max(np.abs(q[:i] - q[i]), axis=1) <= limit) if i else []
        for j in near:
            if search.segment_clear(q[i], q[int(j)]):
                bit = i * (i - 1) // 2 + int(j)
                space.edge[bit // 8] |= 1 << bit % 8
        if i % 20 == 0 or i + 1 == len(q):
            tick("direct segments", i + 1, len(q))


# --------------------------------------------------------------------------- looking at one


@dataclass(frozen=True)
class Numbers:
    """What `space show` prints."""

    candidates: int
    hubs: int
    priors: tuple[int, ...]
    direct_edges: int
    arm_crc: int
    leash_rad: float
    box_min_m: tuple[float, ...]
    box_max_m: tuple[float, ...]
    range_m: tuple[float, float]
    incid_deg: tuple[float, float]
    nearest_m: float  # median distance to the nearest other candidate
    spin_rad: float  # widest rotation between two candidates
    two_tags: int  # candidates that show more than one tag
    unchecked: int  # candidates that lack a check of the list above
    arm_fits: bool  # built for the arm table it is shown with


def describe(space: Any, arm_image: tables.Image, camera: Any) -> tuple[Numbers, np.ndarray, np.ndarray]:
    """Numbers, and incidence [deg] and range [m] per candidate."""
    n = int(space.n_cand)
    cands = space.cand[0:n]
    p = np.array([list(c.p_m) for c in cands])
    R = [quat_to_R(list(c.q_wxyz)) for c in cands]
    cam = Camera(camera)
    incid, rng = [], []
    for i, c in enumerate(cands):
        p_cam, R_cam = cam.pose(c.pan_rad, c.tilt_rad)
        seen = R_cam.T @ (p[i] - p_cam)
        rng.append(float(np.linalg.norm(seen)))
        angles = cam.incidence(seen, R_cam.T @ R[i])
        incid.append(float(np.degrees(max(a for k, a in enumerate(angles) if c.tags >> k & 1))))
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.diag(np.full(n, np.inf))
    widest = max((rotation_angle(R[0].T @ r) for r in R), default=0.0)
    edges = sum(b.bit_count() for b in core.ffi.buffer(space.edge)[:])
    numbers = Numbers(
        n,
        int(space.n_hub),
        tuple(space.prior[0 : space.n_prior]),
        edges,
        int(space.arm_crc),
        float(space.servo_leash),
        tuple(p.min(axis=0)),
        tuple(p.max(axis=0)),
        (min(rng), max(rng)),
        (min(incid), max(incid)),
        float(np.median(gaps.min(axis=1))),
        widest,
        sum(c.tags.bit_count() > 1 for c in cands),
        sum(c.why != WHY_ALL for c in cands),
        int(space.arm_crc) == arm_image.crc,
    )
    return numbers, np.array(incid), np.array(rng)


def scene(
    space: Any,
    arm: Any,
    camera: Any,
    q_poses: np.ndarray | None = None,
    points: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Scene:
    """Geometry of a picture; the poses are the priors unless joint vectors are given."""
    cands = space.cand[0 : int(space.n_cand)]
    chain, cam = ArmChain(arm), Camera(camera)
    if q_poses is None:
        q_poses = np.array([list(cands[i].q_seed)[: chain.n] for i in space.prior[0 : space.n_prior]])
    bones = np.array([(points or chain.points)(q) for q in q_poses])
    target = bones[-1][-1] if len(bones) else np.array(list(cands[0].p_m))
    pan, tilt, _ = cam.aim(target)
    eye, corners = cam.frustum(pan, tilt, 0.6)
    mast = np.array(list(camera.mast_xyz_m))
    return Scene(
        np.array([list(c.p_m) for c in cands]), bones, np.array([mast * [1, 1, 0], mast]), eye, corners
    )
