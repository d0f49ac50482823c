"""The arm as points for the picture in three dimensions, from the tables of this console. Base frame [m]."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal.flight import Arm, Terms, library
from kincal.flight.camera import Camera
from kincal.flight.tables import decode
from kincal_shared.errors import BadInput

if TYPE_CHECKING:
    from kincal.flight.headers import KcSpace
    from kincal.link.messages import ArmState, PantiltState, Proposal

_VIEW_M = 0.5  # length of the rays of the camera's view
Points = list[list[float]]


class Tables:
    """The tables of a folder, as far as a console needs them. BadInput if one is missing."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, kind: str) -> tuple[int, Any]:
        """CRC and contents of a table."""
        file = self.path / f"{kind}.tbl"
        if not file.is_file():
            raise BadInput(f"no {kind} table", str(file), "give --tables DIR with the tables that fly")
        image, struct = decode(file.read_bytes(), str(file))
        if image.kind != kind:
            raise BadInput(f"this is no {kind} table", str(file))
        return image.crc, struct


class Geometry:
    """What can be drawn of an arm. points and view are lists of points [m], base frame."""

    def __init__(self, path: Path) -> None:
        self.tables = Tables(path)
        self._arm_crc, self._arm = self.tables.read("arm")
        self._terms_crc, terms = self.tables.read("terms")
        self.arm, self.names = Arm.of_table(self._arm), list(Terms.of_table(terms).names)
        self._corrected: tuple[int, Arm] | None = None

    @property
    def crcs(self) -> dict[str, int]:
        """Kind -> CRC of the tables that names and pictures are made with."""
        return {"ARM": self._arm_crc, "TERMS": self._terms_crc}

    @cached_property
    def joints(self) -> list[dict[str, Any]]:
        """Name, unit and limits of each joint, in its unit."""
        rows = []
        for j in range(self.arm.n):
            row = self._arm.joint[j]
            prismatic = row.type == library("flight").constant("KC_PRISMATIC")
            scale = 1e3 if prismatic else 180.0 / math.pi
            rows.append(
                {
                    "name": f"J{j + 1}",
                    "unit": "mm" if prismatic else "deg",
                    "min": round(row.q_min * scale, 3),
                    "max": round(row.q_max * scale, 3),
                }
            )
        return rows

    def points(self, m: ArmState, proposal: Proposal | None = None) -> Points | None:
        """Base plate, joints and tool at the encoder readings; proposal: with its DH errors. None if the
        message is of another arm or not finite."""
        q = np.array(m.q_rad[: m.n_joints], float)
        if m.n_joints != self.arm.n or not np.isfinite(q).all():
            return None
        arm = self.arm if proposal is None else self._with(proposal)
        return _plain(arm.points(q))

    def _with(self, proposal: Proposal) -> Arm:
        if self._corrected is None or self._corrected[0] != proposal.crc:
            errors = dict(zip(self.names, proposal.value[: proposal.n_coef], strict=False))
            self._corrected = (proposal.crc, Arm.of_table(self._arm, errors))
        return self._corrected[1]

    @cached_property
    def _camera(self) -> Camera:
        return Camera(self.tables.read("camera")[1])

    @property
    def image_px(self) -> list[int]:
        """Width and height of the camera's image."""
        c = self._camera.struct
        return [int(c.width_px), int(c.height_px)]

    def view(self, m: PantiltState) -> Points | None:
        """Camera, then the four corners of its image at some distance."""
        if not (math.isfinite(m.pan_rad) and math.isfinite(m.tilt_rad)):
            return None
        return self.view_at(m.pan_rad, m.tilt_rad)

    def view_at(self, pan_rad: float, tilt_rad: float) -> Points:
        """The same at these angles."""
        eye, corners = self._camera.frustum(pan_rad, tilt_rad, _VIEW_M)
        return _plain(np.vstack([eye, corners]))

    def posture(self, q_rad: np.ndarray) -> Points | None:
        """Base plate, joints and tool of the nominal arm at these joints; None if they are of another arm."""
        return _plain(self.arm.points(q_rad)) if len(q_rad) == self.arm.n else None

    @cached_property
    def scene(self) -> dict[str, Any]:
        """What does not move: mast, tool positions of the candidates."""
        mast = np.array(list(self._camera.struct.mast_xyz_m))
        crc, space = self.tables.read("space")
        return {
            "mast_m": _plain(np.array([mast * [1, 1, 0], mast])),
            "space": f"{crc:08x}",
            "candidates_m": candidates(space),
        }


def candidates(space: KcSpace) -> Points:
    """Tool positions of all poses of a SPACE table, in the order that flight counts them in."""
    return _plain(library("flight").rows(space.cand, int(space.n_cand))["p_m"].astype(float))


def _plain(points: np.ndarray) -> Points:
    return [[round(float(x), 4) for x in row] for row in points]
