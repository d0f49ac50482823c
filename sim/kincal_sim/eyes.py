"""What an exposure becomes: an image, or in the fast mode a detection at once.

An eye is made by eye(scenario, arm, seed) and is a pair (channel, function): the function turns a
world.Frame into a message, while the arm stands where it was at the exposure.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

import kcm

from .arm import Arm
from .camera import Camera, load_config
from .fastcam import FastCamera
from .scenario import Scenario, generator

Eye = tuple[str, Callable]


def pixel_eye(scenario: Scenario, arm: Arm, seed: int) -> Eye:
    """KC_IMAGE: a rendered JPEG."""
    camera = Camera(load_config(arm.spec, optics=scenario.camera), arm.model)
    rng = generator(seed, "camera")

    def expose(frame):
        grey = camera.render(arm.data, frame.T_base_cam, frame.T_base_tool, rng)
        jpeg = camera.encode(grey).jpeg
        m = kcm.image_t()
        m.t_us, m.seq, m.height_px, m.width_px = frame.t_us, frame.seq, *grey.shape
        m.n_bytes, m.jpeg = len(jpeg), jpeg
        return m

    return "KC_IMAGE", expose


def fast_eye(scenario: Scenario, arm: Arm, seed: int) -> Eye:
    """KC_DETECTION without drawing anything: what the tag detector would say."""
    camera = FastCamera(load_config(arm.spec, fast=scenario.fastcam), arm.model)
    rng = generator(seed, "detections")

    def expose(frame):
        fields = camera.detect(arm.data, frame.T_base_cam, frame.T_base_tool, rng)
        m = kcm.detection_t()
        for name, value in fields.items():
            setattr(m, name, value)
        m.t_us, m.seq = frame.t_us, frame.seq
        return m

    return "KC_DETECTION", expose


class Darkroom:
    """Draws frames in a thread of its own, so that drawing does not hold up a real-time simulator.

    It works on its own copy of the arm. Use `eye` as the world's eye: it answers None, and the
    message comes out of finished() when it is drawn.
    """

    def __init__(self, make_eye: Callable[..., Eye]):
        self.make_eye = make_eye
        self._exposed: queue.Queue = queue.Queue()
        self._drawn: queue.Queue = queue.Queue()

    def eye(self, scenario: Scenario, arm: Arm, seed: int) -> Eye:
        threading.Thread(target=self._work, args=(scenario, seed), daemon=True).start()

        def expose(frame):
            self._exposed.put((frame, arm.data.qpos.copy()))

        return "", expose

    def _work(self, scenario: Scenario, seed: int) -> None:
        # Everything is made in this thread: a GL context belongs to the one that made it.
        arm = scenario.build_arm()
        channel, expose = self.make_eye(scenario, arm, seed)
        while True:
            frame, qpos = self._exposed.get()
            arm.set(qpos[: arm.n], *qpos[arm.n :])
            self._drawn.put((channel, expose(frame)))

    def finished(self, now_us: int, moved_us: int) -> list[tuple[str, object]]:
        """Frames drawn since the last call. A scene that has not moved since the exposure (moved_us: last
        time that anything did) looks the same now, so such a frame counts as taken now: a real
        camera would not have needed the time that drawing took."""
        out = []
        while not self._drawn.empty():
            channel, m = self._drawn.get()
            if moved_us < m.t_us:
                m.t_us = now_us
            out.append((channel, m))
        return out
