"""What an exposure becomes: a rendered image, or in the fast mode a modelled detection at once.

An imager is made by one of the functions below from (scenario, arm, seed). It works on the arm where that
stands at the exposure.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import kcm

from ..mechanics.arm import Arm
from ..randomness import generator
from ..scenario import Scenario
from ..truth import build_plant
from .camera import Camera, load_config
from .detection_model import DetectionModel

Message = Any  # a message class that lcm-gen made


@dataclass(frozen=True)
class Exposure:
    """One exposure: time, number of the frame, camera and tool in the base frame (4x4)."""

    t_us: int
    seq: int
    T_base_cam: np.ndarray
    T_base_tool: np.ndarray


@dataclass(frozen=True)
class Imager:
    """channel: where its messages go; expose(exposure): the message, or None if that comes later;
    settings: of the detection model, as it uses them."""

    channel: str
    expose: Callable[[Exposure], Message | None]
    settings: dict = field(default_factory=dict)


MakeImager = Callable[[Scenario, Arm, int], Imager]


def pixel_imager(scenario: Scenario, arm: Arm, seed: int) -> Imager:
    """KC_IMAGE: a rendered JPEG."""
    camera = Camera(load_config(arm.spec, optics=scenario.optics.changes()), arm.model)
    rng = generator(seed, "camera")

    def expose(exposure: Exposure) -> kcm.image_t:
        grey = camera.render(arm.data, exposure.T_base_cam, exposure.T_base_tool, rng)
        jpeg = camera.encode(grey).data
        m = kcm.image_t()
        m.t_us, m.seq = exposure.t_us, exposure.seq
        m.height_px, m.width_px = grey.shape
        m.n_bytes, m.jpeg = len(jpeg), jpeg
        return m

    return Imager("KC_IMAGE", expose)


def fast_imager(scenario: Scenario, arm: Arm, seed: int) -> Imager:
    """KC_DETECTION without an image: what the tag detector would report."""
    config = load_config(arm.spec, detection=scenario.detection.changes())
    model = DetectionModel(config, arm.model)
    rng = generator(seed, "detections")

    def expose(exposure: Exposure) -> kcm.detection_t:
        fields = model.detect(arm.data, exposure.T_base_cam, exposure.T_base_tool, rng)
        m = kcm.detection_t.__new__(kcm.detection_t)
        for name, value in fields.items():
            setattr(m, name, value)
        m.t_us, m.seq = exposure.t_us, exposure.seq
        return m

    return Imager("KC_DETECTION", expose, config.detection)


class BackgroundImager:
    """Renders in a thread of its own, so that rendering does not hold up a real-time simulator.

    It has a copy of the arm. Give `imager` to the world: it answers None, and completed() gives the message
    when it is ready.
    """

    def __init__(self, make_imager: MakeImager):
        self.make_imager = make_imager
        self._exposed: queue.Queue = queue.Queue()
        self._rendered: queue.Queue = queue.Queue()

    def imager(self, scenario: Scenario, arm: Arm, seed: int) -> Imager:
        """Start the thread; the imager that hands exposures to it."""
        threading.Thread(target=self._work, args=(scenario, seed), daemon=True).start()
        return Imager("", lambda exposure: self._exposed.put((exposure, arm.data.qpos.copy())))

    def _work(self, scenario: Scenario, seed: int) -> None:
        # Everything is made in this thread: a GL context belongs to the thread that made it.
        arm = build_plant(scenario).arm(scenario.env.payload_kg)
        imager = self.make_imager(scenario, arm, seed)
        while True:
            exposure, qpos = self._exposed.get()
            arm.set(qpos[: arm.n], *qpos[arm.n :])
            self._rendered.put((imager.channel, imager.expose(exposure)))

    def completed(self, now_us: int, last_motion_us: int) -> list[tuple[str, Message]]:
        """(channel, message) of the frames that were finished since the last call.

        A scene that has not moved since the exposure looks the same now, so such a frame counts as taken
        now: a real camera would not have needed the time that rendering took.
        """
        out = []
        while not self._rendered.empty():
            channel, m = self._rendered.get()
            if last_motion_us < m.t_us:
                m.t_us = now_us
            out.append((channel, m))
        return out
