"""Tags: their place on the tool, and the printed pattern of 36h11, taken from libapriltag."""

from __future__ import annotations

import ctypes
import ctypes.util
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

# A printed tag is 8x8 cells of black square (border and code) inside one white cell all round.
CELLS = 10
BLACK_CELLS = 8
FAMILY_SIZE = 587
# In the tag frame (x right, y down), the order in which libapriltag reports the corners:
# bottom left, bottom right, top right, top left.
CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


@dataclass(frozen=True)
class Tag:
    """One printed tag: family member, edge of its black square, pose in the tool frame (4x4)."""

    id: int
    size_m: float
    T_tool_tag: np.ndarray

    @cached_property
    def corners_m(self) -> np.ndarray:
        """(4, 3) corners in the tag frame."""
        return corners_m(self.size_m)

    @cached_property
    def in_sight_m(self) -> np.ndarray:
        """(9, 3) points in the tag frame that must all be in sight: corners and middles of the print, white
        border included."""
        ends = (-1.0, 0.0, 1.0)
        ring = np.array([[x, y, 0.0] for x in ends for y in ends])
        return ring * (0.5 * self.size_m) * (CELLS / BLACK_CELLS)

    @cached_property
    def tool_corners_m(self) -> np.ndarray:
        """(4, 3) corners in the tool frame."""
        return self.corners_m @ self.T_tool_tag[:3, :3].T + self.T_tool_tag[:3, 3]


def corners_m(size_m: float) -> np.ndarray:
    """(4, 3) corners of the black square in the tag frame."""
    return np.column_stack([CORNERS * size_m, np.zeros(4)])


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
    """(10, 10) cells of one tag, 0 black and 1 white, white border included. Raises ValueError."""
    if not 0 <= tag_id < FAMILY_SIZE:
        raise ValueError(f"36h11 has members 0..{FAMILY_SIZE - 1}, not {tag_id}")
    return (np.frombuffer(_cells(tag_id), np.uint8).reshape(CELLS, CELLS) > 127).astype(np.float32)
