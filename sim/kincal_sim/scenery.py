"""Looks of the landing site: textures and light for the MuJoCo scene. No physics.

`ASSETS` goes into <asset>, `LIGHTS` into <worldbody>, `VISUAL` into <mujoco>; use the materials
`ice`, `deck`, `metal`, `dark` and `white`. `paint(model)` then fills the ice and deck textures.
"""

from __future__ import annotations

import cv2
import mujoco
import numpy as np

VISUAL = """
<visual>
  <headlight ambient="0.10 0.10 0.11" diffuse="0.06 0.06 0.06" specular="0 0 0"/>
  <map znear="0.01" zfar="60" shadowclip="2.5" shadowscale="0.6"/>
  <quality shadowsize="4096" offsamples="4"/>
  <global offwidth="1920" offheight="1080"/>
</visual>
"""

ASSETS = """
<texture name="sky" type="skybox" builtin="flat" rgb1="0.005 0.005 0.012" mark="random"
         markrgb="0.9 0.9 1" random="0.0006" width="512" height="3072"/>
<texture name="ice" type="2d" builtin="flat" rgb1="0.6 0.62 0.66" width="1024" height="1024"/>
<texture name="deck" type="2d" builtin="flat" rgb1="0.4 0.36 0.25" width="512" height="512"/>
<material name="ice" texture="ice" texrepeat="0.16 0.16" texuniform="true" specular="0.1" shininess="0.2"/>
<material name="deck" texture="deck" texrepeat="0.7 0.7" texuniform="true" specular="0.2" shininess="0.3"/>
<material name="metal" rgba="0.62 0.63 0.66 1" specular="0.35" shininess="0.4"/>
<material name="dark" rgba="0.16 0.16 0.18 1" specular="0.3" shininess="0.4"/>
<material name="white" rgba="0.85 0.85 0.82 1" specular="0.05" shininess="0.1"/>
"""

# The sun stands low behind the camera's left shoulder; Jupiter and the deck fill the shadows a little.
LIGHTS = """
<light name="sun" type="directional" dir="0.62 -0.38 -0.69" pos="-2.5 1.5 2.8" castshadow="true"
       diffuse="0.68 0.67 0.64" specular="0.3 0.3 0.3" ambient="0 0 0"/>
<light name="fill" type="directional" dir="-0.5 0.6 -0.6" castshadow="false"
       diffuse="0.10 0.10 0.12" specular="0 0 0" ambient="0.05 0.05 0.06"/>
"""


def _rough(rng: np.random.Generator, n: int) -> np.ndarray:
    """Smooth noise of many sizes, 0..1, that repeats at its edges."""
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.fftfreq(n)[None, :])
    f[0, 0] = 1.0
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) / f**1.25).real
    return (field - field.min()) / (field.max() - field.min())


def _ice(n: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    base = 140.0 + 70.0 * _rough(rng, n)
    # Cracks: the zero lines of smooth noise, one dark bluish band beside each ridge.
    ridge = np.abs(_rough(rng, n) - 0.5)
    crack = np.exp(-((ridge / 0.006) ** 2))
    grey = base * (1.0 - 0.45 * crack)
    tint = np.array([0.95, 0.98, 1.04]) - 0.03 * crack[..., None]
    return np.clip(grey[..., None] * tint, 0, 255).astype(np.uint8)


def _deck(n: int) -> np.ndarray:
    """Golden blanket panels with seams and rivets."""
    rng = np.random.default_rng(8)
    grey = 0.55 + 0.25 * _rough(rng, n)
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


def paint(model: mujoco.MjModel) -> None:
    """Fill the textures `ice` and `deck` of a model, if it has them; before a Camera is made."""
    for name, make in (("ice", _ice), ("deck", _deck)):
        i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXTURE, name)
        if i < 0:
            continue
        n, channels, start = model.tex_width[i], model.tex_nchannel[i], model.tex_adr[i]
        image = make(int(n))[..., :channels]
        model.tex_data[start : start + image.size] = image.ravel()
