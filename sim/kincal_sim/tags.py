"""The printed pattern of 36h11 tags, taken from libapriltag so that no copy of it lives here."""

from __future__ import annotations

import ctypes
import ctypes.util
from functools import lru_cache

import numpy as np

# A printed tag is 8x8 cells of black square (border and code) inside one white cell all round.
CELLS = 10
BLACK_CELLS = 8
# In the tag frame (x right, y down), the order in which libapriltag reports the corners:
# bottom left, bottom right, top right, top left.
CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


class _ImageU8(ctypes.Structure):
    _fields_ = [
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
        ("stride", ctypes.c_int32),
        ("buf", ctypes.POINTER(ctypes.c_uint8)),
    ]


def _load(name: str) -> ctypes.CDLL:
    found = ctypes.util.find_library(name)
    if found is None:
        raise RuntimeError(f"lib{name} was not found; install the package libapriltag-dev")
    return ctypes.CDLL(found)


@lru_cache(maxsize=1)
def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    lib, utils = _load("apriltag"), _load("apriltag-utils")
    lib.tag36h11_create.restype = ctypes.c_void_p
    lib.tag36h11_destroy.argtypes = [ctypes.c_void_p]
    lib.apriltag_to_image.argtypes = [ctypes.c_void_p, ctypes.c_uint32]
    lib.apriltag_to_image.restype = ctypes.POINTER(_ImageU8)
    utils.image_u8_destroy.argtypes = [ctypes.POINTER(_ImageU8)]
    return lib, utils


@lru_cache(maxsize=64)
def _cells(tag_id: int) -> bytes:
    lib, utils = _libraries()
    family = lib.tag36h11_create()
    try:
        image = lib.apriltag_to_image(family, tag_id)
        try:
            im = image.contents
            pixels = np.ctypeslib.as_array(im.buf, (im.height, im.stride))[:, : im.width]
            if pixels.shape != (CELLS, CELLS):
                raise RuntimeError(f"libapriltag drew tag {tag_id} with {pixels.shape} cells")
            return pixels.tobytes()
        finally:
            utils.image_u8_destroy(image)
    finally:
        lib.tag36h11_destroy(family)


def bitmap(tag_id: int) -> np.ndarray:
    """Cells of one tag as 10x10 array of 0 (black) and 1 (white), white border included."""
    if not 0 <= tag_id < 587:
        raise ValueError(f"36h11 has members 0..586, not {tag_id}")
    return (np.frombuffer(_cells(tag_id), np.uint8).reshape(CELLS, CELLS) > 127).astype(np.float32)
