"""Frames drawn by the simulator's camera about the tags only (Camera.tags_radiance), compressed, and given to
the tag detector, for benches that fly in process."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import cv2

import kcm
from kincal.flight import library
from kincal.run.inprocess import Tick
from kincal_sim.randomness import generator
from kincal_sim.scenario import Scenario
from kincal_sim.vision.camera import Camera, TagsRadiance, load_config
from kincal_sim.vision.imagers import Imager, fast_imager
from kincal_sim.world import World

ROOT = Path(__file__).resolve().parents[2]
TAGDET = ROOT / "build" / "kincal-tagdet"
CONFIG = ROOT / "sim" / "models" / "detector.yml"
MEASURED_IN = tuple(library("flight").constant(f"KC_ST_{name}") for name in ("OBSERVE", "MEASURE"))
"""States of flight whose frames are measured: the one in which OBSERVE finds the tags is the first."""
JPEG_QUALITY = 75  # what whole frames of this scene end up with


class Detector:
    """The tag detector as one process: a JPEG in, the fields of a detection out."""

    def __init__(self, folder: Path):
        self._image = folder / "frame.jpg"
        command = [str(TAGDET), "--config", str(CONFIG), "--image", "-"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def detect(self, jpeg: bytes) -> dict:
        """What the detector prints about an image."""
        self._image.write_bytes(jpeg)
        print(self._image, file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()


class DrawnImager:
    """Draws a frame, compresses it and has it detected: with `every` each one, else those that are measured;
    others are of fast mode. It has to be told the state of flight (`see`).

    A scene that rests is drawn once; each frame has noise, compression and detection of its own."""

    def __init__(self, detector: Detector, every: bool = False):
        self.detector, self.every = detector, every
        self.n_drawn = 0
        self._state = 0
        self._camera: Camera | None = None
        self._scene: tuple[bytes, TagsRadiance | None] = (b"", None)

    def see(self, tick: Tick) -> None:
        """Take in a tick."""
        self._state = tick.state

    def world(self, scenario: Scenario, seed: int) -> World:
        """For kincal.run.inprocess.Setup."""
        return World(scenario, seed, self.make)

    def make(self, scenario: Scenario, arm, seed: int) -> Imager:
        """As the functions of kincal_sim.vision.imagers."""
        config = load_config(arm.spec, optics=scenario.optics.changes())
        if self._camera is not None:
            self._camera.close()  # of the run before: it holds a GL context
        self._camera = camera = Camera(config, arm.model)
        rng, fast = generator(seed, "camera"), fast_imager(scenario, arm, seed)

        def expose(exposure):
            if not self.every and self._state not in MEASURED_IN:
                return fast.expose(exposure)
            self.n_drawn += 1
            key = exposure.T_base_cam.tobytes() + exposure.T_base_tool.tobytes()
            if self._scene[0] != key:
                self._scene = key, camera.tags_radiance(arm.data, exposure.T_base_cam, exposure.T_base_tool)
            image = camera.expose_tags(self._scene[1], rng)
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            return message(self.detector.detect(jpeg.tobytes()), exposure)

        return Imager("KC_DETECTION", expose)


def message(fields: dict, exposure) -> kcm.detection_t:
    """A detection as the detector would publish it."""
    m = kcm.detection_t()
    for name in (set(m.__slots__) & set(fields)) - {"t_us", "seq"}:
        setattr(m, name, fields[name])
    m.t_us, m.seq = exposure.t_us, exposure.seq
    return m
