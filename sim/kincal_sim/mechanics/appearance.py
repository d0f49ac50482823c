"""Appearance of the landing site: textures, materials and light of the MuJoCo scene. No physics.

`add_to(root, world)` adds them to MJCF under construction; `fill_textures(model)` fills the textures of the
compiled model, before a Camera is made.
"""

from __future__ import annotations

from functools import cache
from xml.etree import ElementTree as ET

import cv2
import mujoco
import numpy as np

# The extent sets how far the shadow map reaches: the lander and what the arm can touch.
STATISTIC = '<statistic extent="1.3" center="0.2 0 0.2"/>'
# No multisampling: it doubles the time of a frame, tags are drawn separately and the lens softens the rest.
VISUAL = """
<visual>
  <headlight ambient="0 0 0" diffuse="0.36 0.36 0.35" specular="0.1 0.1 0.1"/>
  <map znear="0.01" zfar="60" shadowclip="1.6" shadowscale="0.6"/>
  <quality shadowsize="2048" offsamples="0"/>
</visual>
"""

ASSETS = """
<asset>
  <texture name="sky" type="skybox" builtin="flat" rgb1="0.005 0.005 0.012" mark="random"
           markrgb="0.9 0.9 1" random="0.0006" width="512" height="3072"/>
  <texture name="ice" type="2d" builtin="flat" rgb1="0.6 0.62 0.66" width="1024" height="1024"/>
  <texture name="deck" type="2d" builtin="flat" rgb1="0.4 0.36 0.25" width="512" height="512"/>
  <material name="ice" texture="ice" texrepeat="0.3 0.3" texuniform="true" specular="0.05" shininess="0.1"/>
  <material name="deck" texture="deck" texrepeat="1.4 1.4" texuniform="true" specular="0.2" shininess="0.3"/>
  <material name="arm" rgba="0.78 0.79 0.81 1" specular="0.3" shininess="0.4"/>
  <material name="joint" rgba="0.25 0.26 0.29 1" specular="0.3" shininess="0.4"/>
  <material name="scoop" rgba="0.55 0.56 0.58 1" specular="0.4" shininess="0.5"/>
  <material name="plate" rgba="0.9 0.9 0.89 1" specular="0.02" shininess="0.1"/>
  <material name="mast" rgba="0.35 0.36 0.40 1" specular="0.3" shininess="0.4"/>
</asset>
"""

# The sun stands high behind the camera's left shoulder. A lamp beside the lens and the bright ice fill
# the shadows to half of the full light, so that a tag can be detected with a shadow's edge on it.
LIGHTS = """
<worldbody>
  <light name="sun" type="directional" dir="0.29 -0.5 -0.82" pos="-0.4 0.9 1.7" castshadow="true"
         diffuse="0.42 0.42 0.41" specular="0.3 0.3 0.3" ambient="0 0 0"/>
  <light name="bounce" type="directional" dir="0.2 0.1 0.9" castshadow="false"
         diffuse="0.12 0.12 0.13" specular="0 0 0" ambient="0.14 0.14 0.15"/>
</worldbody>
"""


def add_to(root: ET.Element, world: ET.Element, pictures: bool = True) -> None:
    """Add visual settings, materials and lights to a model: <mujoco> and its <worldbody>. pictures: whether
    any will be taken; textures take nine tenths of the time of MuJoCo's compiler."""
    root.append(ET.fromstring(STATISTIC))
    root.append(ET.fromstring(VISUAL))
    root.append(ET.fromstring(ASSETS) if pictures else _without_textures(ET.fromstring(ASSETS)))
    world.extend(ET.fromstring(LIGHTS))


def _without_textures(assets: ET.Element) -> ET.Element:
    for texture in assets.findall("texture"):
        assets.remove(texture)
    for material in assets.iterfind("material[@texture]"):
        del material.attrib["texture"]
    return assets


def _fractal_noise(rng: np.random.Generator, n: int, exponent: float) -> np.ndarray:
    """(n, n) noise in 0..1 whose amplitudes fall with frequency^exponent; it repeats at its edges."""
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.fftfreq(n)[None, :])
    f[0, 0] = 1.0
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) / f**exponent).real
    return (field - field.min()) / (field.max() - field.min())


@cache  # a process that flies many cases fills the textures of each
def _ice(n: int) -> np.ndarray:
    """(n, n, 3) cracked ice."""
    rng = np.random.default_rng(7)
    base = 165.0 + 75.0 * _fractal_noise(rng, n, 1.25)
    # Cracks run along the level lines of smoother noise.
    crack = np.zeros((n, n))
    for _ in range(3):
        crack = np.maximum(crack, np.exp(-(((_fractal_noise(rng, n, 1.9) - 0.5) / 0.0035) ** 2)))
    grey = base * (1.0 - 0.4 * crack)
    tint = np.array([0.95, 0.98, 1.04]) - 0.03 * crack[..., None]
    return np.clip(grey[..., None] * tint, 0, 255).astype(np.uint8)


@cache
def _deck(n: int) -> np.ndarray:
    """(n, n, 3) golden blanket panels with seams and rivets."""
    rng = np.random.default_rng(8)
    grey = 0.55 + 0.25 * _fractal_noise(rng, n, 1.25)
    image = (grey[..., None] * np.array([205.0, 170.0, 95.0])).astype(np.uint8)
    image = np.ascontiguousarray(image)
    for k in range(0, n + 1, n // 2):
        cv2.line(image, (k, 0), (k, n), (45, 40, 35), 4)
        cv2.line(image, (0, k), (n, k), (45, 40, 35), 4)
    for x in range(n // 16, n, n // 8):
        for y in (12, n // 2 - 14, n // 2 + 14, n - 14):
            cv2.circle(image, (x, y), 4, (110, 105, 100), -1)
            cv2.circle(image, (y, x), 4, (110, 105, 100), -1)
    return image


def fill_textures(model: mujoco.MjModel) -> None:
    """Fill the textures `ice` and `deck` of a model, if it has them."""
    for name, make in (("ice", _ice), ("deck", _deck)):
        i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXTURE, name)
        if i < 0:
            continue
        n, channels, start = model.tex_width[i], model.tex_nchannel[i], model.tex_adr[i]
        image = make(int(n))[..., :channels]
        model.tex_data[start : start + image.size] = image.ravel()
