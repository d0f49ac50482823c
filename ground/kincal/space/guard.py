"""What the guard on board knows of arm and surroundings: shapes and keep-out volumes as the SPACE table has
them. Flight knows capsules only, so a box on the arm becomes a bundle of capsules that it lies in."""

from __future__ import annotations

import itertools
import re
from typing import Any

import numpy as np

from kincal import core
from kincal.errors import KincalError
from kincal.geometry import quat_to_R

from .description import Description, KeepOut, Shape

TOO_FAT_M = 0.012  # so much may the capsules of a box stand out beyond it; the ground proves 10 mm or more
KINDS = {"below": 0, "box": 1, "capsule": 2, "sphere": 3}
Capsule = tuple[np.ndarray, np.ndarray, float]


def strips(centre: np.ndarray, half: np.ndarray) -> list[Capsule]:
    """Capsules along the longest side that contain the box, as few as stand out by TOO_FAT_M at most. Those
    of k x m strips of half sizes b, c end before the box does, by e; the corners are on the hemispheres when
    the radius is |(b, c, e)|."""
    order = np.argsort(-half, kind="stable")
    length, axes = half[order[0]], order[1:]
    best: list[Capsule] = []
    for k, m in sorted(((k, m) for k in range(1, 9) for m in range(1, 9)), key=lambda n: (n[0] * n[1], n)):
        b, c = half[axes[0]] / k, half[axes[1]] / m
        e = min(length, 0.5 * (b + c))
        radius = float(np.sqrt(b * b + c * c + e * e))
        best = []
        for i in range(k):
            for j in range(m):
                at = centre.copy()
                at[axes[0]] += b * (2 * i + 1 - k)
                at[axes[1]] += c * (2 * j + 1 - m)
                along = np.zeros(3)
                along[order[0]] = length - e
                best.append((at - along, at + along, radius))
        if max(radius - e, radius - b, radius - c) <= TOO_FAT_M:
            break
    return best


def capsules(s: Shape) -> list[Capsule]:
    if s.radius_m is not None:
        return [(np.array(s.start_m), np.array(s.end_m), s.radius_m)]
    return strips(np.array(s.centre_m), np.array(s.half_m))


def fill(space: Any, desc: Description, camera: Any) -> None:
    """Bodies and volumes into a kc_space_t; needs nothing else of it."""
    of: dict[str, list[int]] = {}
    n = 0
    for s in desc.shape:
        xyz, R = np.zeros(3), np.eye(3)
        if s.tag is not None:
            tag = camera.tag[s.tag]
            xyz, R = np.array(list(tag.xyz_m)), quat_to_R(list(tag.quat_wxyz))
        for a, b, radius in capsules(s):
            if n >= core.lib.KC_BODY_MAX:
                raise KincalError(f"{s.name!r} is more than {n} capsules on board", "shape")
            body = space.body[n]
            body.frame, body.radius_m = s.joint, radius
            body.start_m, body.end_m = (xyz + R @ a).tolist(), (xyz + R @ b).tolist()
            of.setdefault(s.name, []).append(n)
            n += 1
    space.n_body = n
    _apart(space, desc, of)
    if len(desc.keep_out) > core.lib.KC_VOLUME_MAX:
        raise KincalError(f"{len(desc.keep_out)} volumes, room for {core.lib.KC_VOLUME_MAX}", "keep_out")
    for i, k in enumerate(desc.keep_out):
        _volume(space.volume[i], k)
        spared = [name for name in of if any(re.fullmatch(x, name) for x in k.except_)]
        space.volume[i].spared = sum(1 << b for name in spared for b in of[name])
    space.n_volume = len(desc.keep_out)


def _apart(space: Any, desc: Description, of: dict[str, list[int]]) -> None:
    """Which bodies must not meet: all but those of one shape, those that touch by design, and those that
    cannot move against each other."""
    fine = {frozenset(pair) for pair in desc.touching}
    for a, b in itertools.combinations(of, 2):
        if frozenset((a, b)) in fine:
            continue
        for i, k in itertools.product(of[a], of[b]):
            if space.body[i].frame != space.body[k].frame:
                space.body[max(i, k)].apart |= 1 << min(i, k)


def _volume(v: Any, k: KeepOut) -> None:
    v.kind, v.p_m, v.radius_m = KINDS[k.kind], list(k.centre_m), k.radius_m or 0.0
    v.size_m = list(k.half_m or k.end_m or (0.0, 0.0, 0.0))
