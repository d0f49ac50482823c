"""Do rendered frames show the tags that the search space says are not hidden, and only those?

    python tests/bench/occlusion.py [--others 600] [--every 1] [--seed 1] [--pictures DIR]

Every candidate of tables/bin/space.tbl, and as many other postures as asked for: tool poses sampled as the
search samples them, reached, with tags that face the camera inside the image, so that the arm alone
decides. For each tag that would show if nothing hid it:

- verdict: the search's rays (kincal.space) to nine points of the print, links taken sight.margin_m thicker;
- frame, by segments: MuJoCo renders the simulator's arm from its camera with a number per shape; a tag is
  whole if every pixel of its print (white border included) shows its plate;
- frame, by detector: the frame as the simulator's camera takes it (light, shadow, blur, noise), in which
  OpenCV's own 36h11 detector finds the tag with corners within CORNER_PX of the projection, or not.

The margin is there on purpose: with it a tag may be said to be hidden that is whole. So the rays are also
compared like for like: links as they are on both sides, and links thicker on both sides.

Exit status 1 unless
- candidates, and the other postures, half of which the search rejects because the arm hides the tags: rays
  and frame agree for at least AGREEMENT_MIN of the tags like for like, both ways; of candidates the verdict
  in the table counts;
- where they differ like for like, it is about less than RIM of the print;
- tags said to be in sight and not whole are at most 1 - AGREEMENT_MIN of those said to be in sight, of
  either kind;
- the detector finds at least AGREEMENT_MIN of the tags that candidates are said to show.
"""

import argparse
import os
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from mujoco.osmesa import GLContext  # noqa: E402
from mujoco.rendering.classic import gl_context  # noqa: E402

gl_context.GLContext = GLContext  # MuJoCo may have been loaded without one (kincal_sim)
ROOT = Path(__file__).resolve().parents[2]

from kincal import space  # noqa: E402
from kincal.space.samples import Box, examine  # noqa: E402
from kincal_sim.mechanics.arm import Arm  # noqa: E402
from kincal_sim.vision.camera import Camera, load_config  # noqa: E402
from kincal_sim.vision.pnp import project, tool_corners  # noqa: E402
from kincal_sim.vision.tags import BLACK_CELLS, CELLS  # noqa: E402

BIN = ROOT / "tables" / "bin"
SPACE_TOML = ROOT / "tables" / "src" / "space.toml"
AGREEMENT_MIN = 0.98
RIM = 0.02  # of a print
CORNER_PX = 2.0
HIDDEN_SHARE = 0.5  # of the other postures: the search says that the arm hides a tag
MAX_BLOCKS = 10_000


@dataclass(frozen=True)
class TagVerdict:
    """One tag at one posture."""

    where: str  # "candidate 17" or "other 3"
    tag: int
    verdict: bool  # in sight, as the search says
    thin: bool  # the same with links as thick as they are
    share: float  # of the print's pixels that show
    share_thick: float  # the same with links thicker
    detected: bool | None  # by the detector; None: not asked

    @property
    def whole(self) -> bool:
        """Whether all of the print shows."""
        return self.share == 1.0

    @property
    def whole_thick(self) -> bool:
        """The same with links thicker."""
        return self.share_thick == 1.0


def inside(outline: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels whose centres lie in a convex outline."""
    lo = np.clip(np.floor(outline.min(axis=0)), 0, [width, height]).astype(int)
    hi = np.clip(np.ceil(outline.max(axis=0)) + 1, 0, [width, height]).astype(int)
    v, u = np.mgrid[lo[1] : hi[1], lo[0] : hi[0]]
    edge = np.roll(outline, -1, axis=0) - outline
    turn = np.sign(edge[0, 0] * edge[1, 1] - edge[0, 1] * edge[1, 0])
    left = [turn * (e[0] * (v - p[1]) - e[1] * (u - p[0])) > 0.0 for p, e in zip(outline, edge, strict=True)]
    rows, columns = np.nonzero(np.all(left, axis=0))
    return rows + lo[1], columns + lo[0]


class RenderedArm:
    """The simulator's nominal arm as its camera sees it; grow_m: how much thicker its links may be taken,
    coarse: edge of a pixel in which segments are rendered."""

    def __init__(self, grow_m: float, coarse: int = 1):
        self.grow_m, self.coarse = grow_m, coarse
        self.arm = Arm()
        self.cfg = load_config(self.arm.spec)
        self.arm.model.vis.global_.offwidth = self.cfg.width_px
        self.arm.model.vis.global_.offheight = self.cfg.height_px
        self.camera = Camera(self.cfg, self.arm.model)
        self.segments = mujoco.Renderer(
            self.arm.model, self.cfg.height_px // coarse, self.cfg.width_px // coarse
        )
        self.segments.enable_segmentation_rendering()
        self.detector = cv2.aruco.ArucoDetector(
            cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        )

        model = self.arm.model
        self.links = [
            i
            for i in range(model.ngeom)
            if model.geom(i).name.startswith("link") or model.geom(i).name == "stem"
        ]

    def close(self) -> None:
        """Free the renderers."""
        self.camera.close()
        self.segments.close()

    def pose(self, q, pan: float, tilt: float) -> None:
        """Move arm and pan-tilt unit [rad]."""
        self.arm.set(q, pan, tilt)

    def outline(self, tag, size_m: float) -> np.ndarray:
        """Corners of a tag of that size in the image [px]."""
        T = np.linalg.inv(self.arm.T_base_cam) @ self.arm.T_base_tool
        return project(self.cfg.K, T[:3, :3], T[:3, 3], tool_corners(tag.T_tool_tag, size_m))

    def shares(self, thicker: bool = False) -> list[float]:
        """Share of each print's pixels that show its plate; 0 if none is in the image."""
        data, model = self.arm.data, self.arm.model
        mujoco.mj_camlight(model, data)
        model.geom_size[self.links, 0] += self.grow_m * thicker
        self.segments.update_scene(data, camera="mast")
        model.geom_size[self.links, 0] -= self.grow_m * thicker
        ids, out = self.segments.render()[:, :, 0], []
        for tag in self.cfg.tags:
            outline = (self.outline(tag, tag.size_m * CELLS / BLACK_CELLS) + 0.5) / self.coarse - 0.5
            pixels = ids[inside(outline, ids.shape[1], ids.shape[0])]
            plate = model.geom(f"tag{tag.id}.plate").id
            out.append(float(np.mean(pixels == plate)) if pixels.size else 0.0)
        return out

    def frame(self, rng) -> np.ndarray:
        """What the simulator's camera takes."""
        return self.camera.render(self.arm.data, self.arm.T_base_cam, self.arm.T_base_tool, rng)

    def detected(self, frame: np.ndarray) -> set[int]:
        """Ids of the tags that the detector finds where they are."""
        corners, ids, _ = self.detector.detectMarkers(frame)
        seen = set()
        for quad, number in zip(corners, [] if ids is None else ids.ravel(), strict=True):
            tag = next((t for t in self.cfg.tags if t.id == number), None)
            if tag is None:
                continue
            want = self.outline(tag, tag.size_m)
            off = np.linalg.norm(quad.reshape(4, 1, 2) - want[None], axis=2).min(axis=0).max()
            if off <= CORNER_PX:
                seen.add(int(number))
        return seen


class SearchVerdicts:
    """What the search says about a posture."""

    def __init__(self):
        self.desc, self.tables = space.read_description(SPACE_TOML), space.TablesFolder(BIN)
        self.checks = space.Checks.load(self.desc, self.tables)

    def view(self, q) -> tuple[float, float, int]:
        """Pan-tilt angles [rad], and the tags that show if nothing hides them."""
        poses = self.checks.kinematics.poses(q)
        views = self.checks.view.aim(poses)
        _, seen = self.checks.view.problems(poses.p_m, views)
        return views.pan_rad[0], views.tilt_rad[0], int(seen[0])

    def in_sight(self, q, thick: bool) -> int:
        """Tags that the arm does not hide, with links thicker or as they are."""
        eye_m = self.checks.view.aim(self.checks.kinematics.poses(q)).camera.p_m[0]
        clearance = self.checks.clearance
        every_tag = (1 << self.checks.view.n_tags) - 1
        return (clearance.thick if thick else clearance.nominal).visible_tags(q, eye_m, every_tag)

    def others(self, n: int, seed: int) -> list[np.ndarray]:
        """Postures that the search would have examined: half of them rejected because the arm hides the tags,
        the other half not."""
        desc = self.desc.model_copy(update={"seed": 10_000 + seed})
        checks = space.Checks.load(desc, self.tables)
        box = Box(desc.tool.box_min_m, desc.tool.box_max_m)
        want = {True: round(n * HIDDEN_SHARE), False: n - round(n * HIDDEN_SHARE)}
        got: dict[bool, list] = {True: [], False: []}
        for block in range(MAX_BLOCKS):
            for s in examine(checks, block, 50, box):
                if s.q_rad is not None and self.view(s.q_rad)[2]:
                    got[s.rejection == space.Reason.HIDDEN_TAGS].append(s.q_rad)
            if all(len(got[k]) >= want[k] for k in got):
                return got[True][: want[True]] + got[False][: want[False]]
        raise ArithmeticError("too few postures whose tags the arm hides")


def candidates(every: int = 1) -> list[tuple[int, np.ndarray, int]]:
    """Index, joints and tags of every n-th pose of the table, local initial poses included."""
    table = space.TablesFolder(BIN).space
    return [(i, table.q_rad[i], int(table.tags[i])) for i in range(0, len(table.q_rad), every)]


def compare(
    arm: RenderedArm, search: SearchVerdicts, where: str, q, stated: int | None, detect, pictures
) -> list[TagVerdict]:
    """Every tag of a posture that would show if nothing hid it. stated: tags by the table; detect: random
    numbers of the camera (None: the detector is not asked); pictures: folder for what does not agree."""
    pan, tilt, view = search.view(q)
    thick = search.in_sight(q, True) if stated is None else stated
    thin = search.in_sight(q, False)
    arm.pose(q, pan, tilt)
    shares = arm.shares()
    thicker = arm.shares(True)
    frame = arm.frame(detect) if detect is not None else None
    found = arm.detected(frame) if frame is not None else set()
    out = []
    for k, tag in ((k, tag) for k, tag in enumerate(arm.cfg.tags) if view >> k & 1):
        seen = None if frame is None else tag.id in found
        said = bool(thick >> k & 1), bool(thin >> k & 1)
        out.append(TagVerdict(where, tag.id, *said, shares[k], thicker[k], seen))
        if pictures is not None and out[-1].verdict != out[-1].whole:
            _save(pictures, arm, out[-1], tag, frame)
    return out


def _save(folder: Path, arm: RenderedArm, verdict: TagVerdict, tag, frame) -> None:
    """The part of a frame with a tag that rays and frame do not agree about."""
    full = frame if frame is not None else arm.frame(np.random.default_rng(1))
    folder.mkdir(parents=True, exist_ok=True)
    u, v = arm.outline(tag, tag.size_m).mean(axis=0).astype(int)
    part = full[max(v - 150, 0) : v + 150, max(u - 200, 0) : u + 200]
    name = f"{verdict.where.replace(' ', '-')}-tag{tag.id}-{verdict.share:.3f}.png"
    cv2.imwrite(str(folder / name), part)


COMPARISONS = {
    "verdict used, frame": lambda v: (v.verdict, v.whole),
    "links as they are, both": lambda v: (v.thin, v.whole),
    "links thicker, both": lambda v: (v.verdict, v.whole_thick),
}


def agreement(verdicts: list[TagVerdict], how: str) -> float:
    """Share of tags for which rays and frame say the same."""
    return float(np.mean([a == b for a, b in map(COMPARISONS[how], verdicts)]))


def overstated(verdicts: list[TagVerdict]) -> float:
    """Share of tags said to be in sight that are not whole in the frame."""
    return float(np.mean([not v.whole for v in verdicts if v.verdict]))


def line(verdicts: list[TagVerdict], how: str) -> str:
    """One comparison as text."""
    n = Counter(map(COMPARISONS[how], verdicts))
    return (
        f"  {how:<24} {100 * agreement(verdicts, how):6.2f} %: in sight by both {n[True, True]}, "
        f"hidden by both {n[False, False]}, only rays see it {n[True, False]}, "
        f"only the frame shows it {n[False, True]}"
    )


def only_rims(verdicts: list[TagVerdict]) -> bool:
    """Rays and frame differ, like for like, about rims only."""
    shown = [v.share for v in verdicts if v.thin != v.whole]
    shown += [v.share_thick for v in verdicts if v.verdict != v.whole_thick]
    return min(shown, default=1.0) > 1.0 - RIM


def criteria(ours: list[TagVerdict], other: list[TagVerdict]) -> dict[str, bool]:
    """What has to hold, for candidates and for other postures."""
    _, *like = COMPARISONS
    found = [v.detected for v in ours if v.verdict]
    return {
        "rays and frame agree like for like": all(
            agreement(some, how) >= AGREEMENT_MIN for some in (ours, other) for how in like
        ),
        "where they differ it is about a rim": only_rims([*ours, *other]),
        "said to be in sight: whole": max(overstated(ours), overstated(other)) <= 1.0 - AGREEMENT_MIN,
        "candidates: the detector finds what is in sight": sum(found) >= AGREEMENT_MIN * len(found),
    }


def report(name: str, verdicts: list[TagVerdict]) -> list[str]:
    """Everything about candidates or other postures, as lines."""
    lines = [f"{name}: {len(verdicts)} tags that would show if nothing hid them"]
    lines += [line(verdicts, how) for how in COMPARISONS]
    for what, shown in (("in sight", True), ("hidden", False)):
        some = [v for v in verdicts if v.verdict is shown]
        lines.append(f"  detector finds {sum(v.detected for v in some)} of {len(some)} said to be {what}")
    for v in verdicts:
        if v.verdict and not v.whole:
            shows = f"shows {v.share:.4f}, detected {v.detected}"
            lines.append(f"    {v.where} tag {v.tag}: said to be in sight, {shows}")
    return lines


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = argparse.ArgumentParser(prog="occlusion.py", description=__doc__.split("\n")[0])
    p.add_argument("--others", type=int, default=600, help="postures beside the candidates")
    p.add_argument("--every", type=int, default=1, help="only every n-th candidate")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--pictures", type=Path, default=None, help="folder for what does not agree")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 if all criteria are met."""
    o = options(argv)
    search, rng = SearchVerdicts(), np.random.default_rng(o.seed)
    arm = RenderedArm(search.desc.sight.margin_m)
    ours = [
        v
        for i, q, stated in candidates(o.every)
        for v in compare(arm, search, f"candidate {i}", q, stated, rng, o.pictures)
    ]
    other = [
        v
        for i, q in enumerate(search.others(o.others, o.seed))
        for v in compare(arm, search, f"other {i}", q, None, rng, o.pictures)
    ]
    arm.close()
    print("\n".join(report("candidates", ours) + report("others", other)))
    met = criteria(ours, other)
    for name, good in met.items():
        print(f"{'ok  ' if good else 'FAIL'} {name}")
    return 0 if all(met.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
