"""Do drawn frames show the tags that the search space says are not hidden, and only those?

    python tests/bench/occlusion.py [--others 600] [--every 1] [--seed 1] [--pictures DIR]

Every candidate of tables/bin/space.tbl, and as many other postures as asked for: tool poses drawn as the
search draws them, reached, with tags that face the camera inside the image, so that the arm alone decides.
For each tag that would show if nothing hid it:

- verdict: the search's rays (kincal.space) to nine points of the print, links taken sight.margin_m thicker;
- frame, by segments: MuJoCo draws the simulator's arm from its camera with a number per shape; a tag is
  whole if every pixel of its print (white border included) shows its plate;
- frame, by detector: the frame as the simulator's camera takes it (light, shadow, blur, noise), in which
  OpenCV's own 36h11 detector finds the tag with corners within CORNER_PX of the projection, or not.

The margin is there on purpose: with it a tag may be said to be hidden that is whole. So the rays are also
compared like for like: links as they are on both sides, and links thicker on both sides.

Exit status 1 unless
- candidates: the verdict in the table agrees with the frame for at least GATE of the tags;
- the other postures, half of which the search drops because the arm hides the tags: rays and frame agree for
  at least GATE of the tags like for like, both ways;
- where they differ like for like, it is about less than RIM of the print;
- tags said to be in sight and not whole are at most 1 - GATE of those said to be in sight, of either kind;
- the detector finds at least GATE of the tags that candidates are said to show.
"""

import argparse
import os
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "osmesa")
os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
for _folder in ("ground", "sim", "build/py"):
    sys.path.insert(0, str(ROOT / _folder))

from kincal import space, tables  # noqa: E402
from kincal.space import work  # noqa: E402
from kincal_sim.arm import Arm  # noqa: E402
from kincal_sim.camera import Camera, load_config  # noqa: E402
from kincal_sim.pnp import project, tool_corners  # noqa: E402
from kincal_sim.tags import BLACK_CELLS, CELLS  # noqa: E402

BIN = ROOT / "tables" / "bin"
SPACE_TOML = ROOT / "tables" / "src" / "space.toml"
GATE = 0.98
RIM = 0.02  # of a print
CORNER_PX = 2.0
HIDDEN_SHARE = 0.5  # of the other postures: the search says that the arm hides a tag
HIDDEN = "the arm hides the tags"


@dataclass(frozen=True)
class Judged:
    """One tag at one posture."""

    where: str  # "candidate 17" or "other 3"
    tag: int
    verdict: bool  # in sight, as the search says
    thin: bool  # the same with links as thick as they are
    share: float  # of the print's pixels that show
    share_thick: float  # the same with links thicker; candidates: not drawn, the same as share
    found: bool | None  # by the detector; None: not asked

    @property
    def whole(self) -> bool:
        return self.share == 1.0

    @property
    def whole_thick(self) -> bool:
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


class Drawn:
    """The simulator's nominal arm as its camera sees it; grow_m: how much thicker its links may be taken,
    coarse: edge of a pixel in which segments are drawn."""

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
        self.camera.close()
        self.segments.close()

    def pose(self, q, pan: float, tilt: float) -> None:
        self.arm.set(q, pan, tilt)

    def _outline(self, tag, size_m: float) -> np.ndarray:
        T = np.linalg.inv(self.arm.T_base_cam) @ self.arm.T_base_tool
        return project(self.cfg.K, T[:3, :3], T[:3, 3], tool_corners(tag.T_tool_tag, size_m))

    def shares(self, thicker: bool = False) -> list[float]:
        """Share of each print's pixels that show its plate; 0 if none is in the image."""
        data, model = self.arm.data, self.arm.model
        mujoco.mj_camlight(model, data)
        model.geom_size[self.links, 0] += self.grow_m * thicker
        self.segments.update_scene(data, camera="eye")
        model.geom_size[self.links, 0] -= self.grow_m * thicker
        ids, out = self.segments.render()[:, :, 0], []
        for tag in self.cfg.tags:
            outline = (self._outline(tag, tag.size_m * CELLS / BLACK_CELLS) + 0.5) / self.coarse - 0.5
            pixels = ids[inside(outline, ids.shape[1], ids.shape[0])]
            plate = model.geom(f"tag{tag.id}.plate").id
            out.append(float(np.mean(pixels == plate)) if pixels.size else 0.0)
        return out

    def frame(self, rng) -> np.ndarray:
        return self.camera.render(self.arm.data, self.arm.T_base_cam, self.arm.T_base_tool, rng)

    def found(self, frame: np.ndarray) -> set[int]:
        """Tags that the detector finds where they are."""
        corners, ids, _ = self.detector.detectMarkers(frame)
        seen = set()
        for quad, number in zip(corners, [] if ids is None else ids.ravel(), strict=True):
            tag = next((t for t in self.cfg.tags if t.id == number), None)
            if tag is None:
                continue
            want = self._outline(tag, tag.size_m)
            off = np.linalg.norm(quad.reshape(4, 1, 2) - want[None], axis=2).min(axis=0).max()
            if off <= CORNER_PX:
                seen.add(int(number))
        return seen


class Verdicts:
    """What the search says about a posture."""

    def __init__(self):
        self.desc = space.read_description(SPACE_TOML)
        self.checks = space.Checks(
            self.desc, tables.load(BIN / "arm.tbl")[1], tables.load(BIN / "camera.tbl")[1]
        )

    def view(self, q) -> tuple[float, float, int]:
        """Head angles, and the tags that show if nothing hides them."""
        look = self.checks.looks(*self.checks.poses(q))
        _, seen = self.checks.view_problems(self.checks.poses(q)[0], look)
        return look.pan[0], look.tilt[0], int(seen[0])

    def in_sight(self, q, thick: bool) -> int:
        look = self.checks.looks(*self.checks.poses(q))
        every_tag = (1 << len(self.checks.sizes)) - 1
        return (self.checks.thick if thick else self.checks.nominal).seen(q, look.eye[0], every_tag)

    def others(self, n: int, seed: int) -> list[np.ndarray]:
        """Postures that the search would have looked at: half of them dropped because the arm hides the
        tags, the other half not."""
        checks = space.Checks(
            self.desc.model_copy(update={"seed": 10_000 + seed}), self.checks.arm, self.checks.camera.camera
        )
        want = {True: round(n * HIDDEN_SHARE), False: n - round(n * HIDDEN_SHARE)}
        got: dict[bool, list] = {True: [], False: []}
        for block in range(10_000):
            for s in work.examine(checks, block, 50, self.desc.tool.box_min_m, self.desc.tool.box_max_m):
                if s.q is not None and self.view(s.q)[2]:
                    got[s.reason == HIDDEN].append(s.q)
            if all(len(got[k]) >= want[k] for k in got):
                return got[True][: want[True]] + got[False][: want[False]]
        raise ArithmeticError("too few postures whose tags the arm hides")


def candidates(every: int = 1) -> list[tuple[int, np.ndarray, int]]:
    """Number, joints and tags of every so manyth candidate of the table."""
    table = tables.load(BIN / "space.tbl")[1]
    n = len(space.read_description(SPACE_TOML).joints.margin_rad)
    return [
        (i, np.array(list(c.q_seed)[:n]), int(c.tags))
        for i, c in enumerate(table.cand[0 : table.n_cand])
        if i % every == 0
    ]


def judge(drawn: Drawn, says: Verdicts, where: str, q, stated: int | None, detect, pictures) -> list[Judged]:
    """Every tag of a posture that would show if nothing hid it. stated: tags by the table."""
    pan, tilt, view = says.view(q)
    thick = says.in_sight(q, True) if stated is None else stated
    thin = says.in_sight(q, False)
    drawn.pose(q, pan, tilt)
    shares = drawn.shares()
    thicker = drawn.shares(True) if stated is None else shares
    frame = drawn.frame(detect) if detect is not None else None
    found = drawn.found(frame) if frame is not None else set()
    out = []
    for k, tag in enumerate(drawn.cfg.tags):
        if not view >> k & 1:
            continue
        seen = None if frame is None else tag.id in found
        said = bool(thick >> k & 1), bool(thin >> k & 1)
        j = Judged(where, tag.id, *said, shares[k], thicker[k], seen)
        out.append(j)
        if pictures is not None and j.verdict != j.whole:
            full = frame if frame is not None else drawn.frame(np.random.default_rng(1))
            pictures.mkdir(parents=True, exist_ok=True)
            u, v = drawn._outline(tag, tag.size_m).mean(axis=0).astype(int)
            part = full[max(v - 150, 0) : v + 150, max(u - 200, 0) : u + 200]
            cv2.imwrite(str(pictures / f"{where.replace(' ', '-')}-tag{tag.id}-{shares[k]:.3f}.png"), part)
    return out


WAYS = {
    "verdict used, frame": lambda j: (j.verdict, j.whole),
    "links as they are, both": lambda j: (j.thin, j.whole),
    "links thicker, both": lambda j: (j.verdict, j.whole_thick),
}


def agreement(judged: list[Judged], way: str) -> float:
    """Share of tags for which rays and frame say the same."""
    return float(np.mean([a == b for a, b in map(WAYS[way], judged)]))


def too_bold(judged: list[Judged]) -> float:
    """Share of tags said to be in sight that are not whole in the frame."""
    return float(np.mean([not j.whole for j in judged if j.verdict]))


def line(judged: list[Judged], way: str) -> str:
    n = Counter(map(WAYS[way], judged))
    return (
        f"  {way:<24} {100 * agreement(judged, way):6.2f} %: in sight by both {n[True, True]}, "
        f"hidden by both {n[False, False]}, only rays see it {n[True, False]}, "
        f"only the frame shows it {n[False, True]}"
    )


def rims(judged: list[Judged]) -> bool:
    """Rays and frame differ, like for like, about rims only."""
    shown = [j.share for j in judged if j.thin != j.whole]
    shown += [j.share_thick for j in judged if j.verdict != j.whole_thick]
    return min(shown, default=1.0) > 1.0 - RIM


def gates(ours: list[Judged], other: list[Judged]) -> dict[str, bool]:
    used, *like = WAYS
    found = [j.found for j in ours if j.verdict]
    return {
        "candidates: the verdict agrees with the frame": agreement(ours, used) >= GATE,
        "others: rays and frame agree like for like": all(agreement(other, way) >= GATE for way in like),
        "others: where they differ it is about a rim": rims(other),
        "said to be in sight: whole": max(too_bold(ours), too_bold(other)) <= 1.0 - GATE,
        "candidates: the detector finds what is in sight": sum(found) >= GATE * len(found),
    }


def main(argv: list[str] | None = None) -> int:
    p = argparse.ArgumentParser(prog="occlusion.py", description=__doc__.split("\n")[0])
    p.add_argument("--others", type=int, default=600, help="postures beside the candidates")
    p.add_argument("--every", type=int, default=1, help="only every so manyth candidate")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--pictures", type=Path, default=None, help="folder for what does not agree")
    o = p.parse_args(argv)
    says, rng = Verdicts(), np.random.default_rng(o.seed)
    drawn = Drawn(says.desc.sight.margin_m)
    ours = [
        j
        for i, q, stated in candidates(o.every)
        for j in judge(drawn, says, f"candidate {i}", q, stated, rng, o.pictures)
    ]
    other = [
        j
        for i, q in enumerate(says.others(o.others, o.seed))
        for j in judge(drawn, says, f"other {i}", q, None, rng, o.pictures)
    ]
    drawn.close()
    for name, judged in (("candidates", ours), ("others", other)):
        print(f"{name}: {len(judged)} tags that would show if nothing hid them")
        ways = list(WAYS)[:-1] if judged is ours else WAYS
        print("\n".join(line(judged, way) for way in ways))
        for what, some in (
            ("in sight", [j for j in judged if j.verdict]),
            ("hidden", [j for j in judged if not j.verdict]),
        ):
            print(f"  detector finds {sum(j.found for j in some)} of {len(some)} said to be {what}")
        for j in judged:
            if j.verdict and not j.whole:
                print(f"    {j.where} tag {j.tag}: said to be in sight, shows {j.share:.4f}, found {j.found}")
    held = gates(ours, other)
    for name, good in held.items():
        print(f"{'ok  ' if good else 'FAIL'} {name}")
    return 0 if all(held.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
