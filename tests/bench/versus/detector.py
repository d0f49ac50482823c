"""Detector process against libapriltag alone: the same rendered frames, the same settings, one thread.

Both are processes that read names of JPEG files and answer each with a line. KinCal's also solves for the
pose with its covariance. Taken is processor time of the process, as the kernel counts it."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np

from kincal.space import SpaceTable
from kincal_sim.mechanics.arm import Arm
from kincal_sim.vision import camera

from .build import OUT, ROOT, bare_apriltag
from .measure import OURS, Growth, Ratio, Timed, compared, growth

CONFIG = ROOT / "sim" / "models" / "detector.yml"
FRAMES = 12
BARE = "libapriltag alone"
PIXEL_CENTRE = 0.5  # libapriltag has pixel centres at half coordinates
SCALES = (4, 3, 2, 1)


@cache
def frames() -> list[Path]:
    """Frames of candidate poses, as flight asks for them: rendered once, then kept in build."""
    folder = OUT / "frames"
    made = [folder / f"{k:02d}.jpg" for k in range(FRAMES)]
    if all(path.exists() for path in made):
        return made
    folder.mkdir(parents=True, exist_ok=True)
    arm, cfg, rng = Arm(), camera.load_config(), np.random.default_rng(3)
    cam = camera.Camera(cfg, arm.model)
    _, table = SpaceTable.load(ROOT / "tables" / "bin" / "space.tbl")
    q = table.q_rad[: table.n_candidates]
    for path, posture in zip(made, q[:: max(1, len(q) // FRAMES)], strict=False):
        arm.set(posture)
        arm.set(posture, *camera.aim(arm.spec, arm.T_base_tool[:3, 3]))
        frame = cam.encode(cam.render(arm.data, arm.T_base_cam, arm.T_base_tool, rng))
        path.write_bytes(frame.data)
    cam.close()
    return made


def settings(scale: int = 1) -> Path:
    """The detector's configuration with one thread, for frames with so many times fewer rows."""
    text = re.sub(r"threads: \d+", "threads: 1", CONFIG.read_text())
    for name in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"):
        value = float(re.search(rf"^{name}: ([\d.]+)", text, re.MULTILINE)[1])
        less = (value + 0.5) / scale - 0.5 if name[0] == "c" else value / scale
        text = re.sub(rf"^{name}: .*", f"{name}: {less:g}", text, flags=re.MULTILINE)
    path = OUT / f"detector-{scale}.yml"
    path.write_text(text)
    return path


def smaller(scale: int) -> list[Path]:
    """The frames with so many times fewer rows and columns."""
    out = []
    for path in frames() if scale > 1 else ():
        made = path.with_name(f"{path.stem}-{scale}.png")
        if not made.exists():
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            size = (image.shape[1] // scale, image.shape[0] // scale)
            cv2.imwrite(str(made), cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        out.append(made)
    return out or frames()


class Process:
    """A process that is asked with names of images."""

    def __init__(self, *command: object) -> None:
        self._run = subprocess.Popen(
            [str(part) for part in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._on_cpu = Path(f"/proc/{self._run.pid}/schedstat")

    def __enter__(self) -> Process:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _value: BaseException | None, _tb: TracebackType | None
    ) -> None:
        assert self._run.stdin is not None
        self._run.stdin.close()
        self._run.wait()

    def ask(self, path: Path) -> dict[str, Any]:
        """Its answer about an image."""
        assert self._run.stdin is not None
        assert self._run.stdout is not None
        self._run.stdin.write(f"{path}\n")
        self._run.stdin.flush()
        found: dict[str, Any] = json.loads(self._run.stdout.readline())
        return found

    def seconds(self, paths: list[Path]) -> float:
        """Processor seconds an image."""
        begun = self._cpu_ns()
        for path in paths:
            self.ask(path)
        return 1e-9 * (self._cpu_ns() - begun) / len(paths)

    def _cpu_ns(self) -> int:
        return int(self._on_cpu.read_text().split()[0])


def both(scale: int = 1) -> tuple[Process, Process]:
    """Ours and theirs."""
    config = settings(scale)
    return (
        Process(ROOT / "build" / "kincal-tagdet", "--config", config, "--image", "-"),
        Process(bare_apriltag(), config),
    )


def off_px(ours: dict[str, Any], theirs: dict[str, Any]) -> float:
    """Largest difference of the corners of the tags that ours reports."""
    corners = {tag["id"]: np.array(tag["corner_px"]) - PIXEL_CENTRE for tag in theirs["tags"]}
    found = [
        np.abs(np.array(ours["corner_px"][8 * k : 8 * k + 8]) - corners[ours["tag_id"][k]]).max()
        for k in range(ours["n_tags"])
    ]
    return float(max(found, default=0.0))


def _calls(ours: Process, theirs: Process, paths: list[Path]) -> dict[str, Timed]:
    return {OURS: lambda: ours.seconds(paths), BARE: lambda: theirs.seconds(paths)}


def ratios(rounds: int) -> Iterator[Ratio]:
    """All frames in every round."""
    ours, theirs = both()
    with ours, theirs:
        off = max(off_px(ours.ask(path), theirs.ask(path)) for path in frames())
        calls = _calls(ours, theirs, frames())
        yield from compared("detector", "1920 x 1080", calls, {BARE: off}, "corner [px]", rounds)


def by_pixels(rounds: int) -> Growth:
    """By size of the image."""
    running: list[Process] = []

    def calls_of(pixels: int) -> dict[str, Timed]:
        scale = next(s for s in SCALES if 1920 * 1080 // s**2 == pixels)
        ours, theirs = both(scale)
        running.extend((ours, theirs))
        return _calls(ours, theirs, smaller(scale))

    sizes = tuple(1920 * 1080 // scale**2 for scale in SCALES)
    try:
        return growth("detector", "pixels", sizes, calls_of, rounds)
    finally:
        for process in running:
            process.__exit__(None, None, None)
