"""A SPACE table as numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal.flight import library
from kincal.flight.tables import Image, decode_as
from kincal.rotations import Pose
from kincal_shared.schema.dh import DH_FIELDS

from .arrays import Bools, Floats, Ints

if TYPE_CHECKING:
    from kincal.flight.headers import KcSpace

# Bits of kc_cand_t.why: checks that a candidate passed.
CHECKS = {
    1: "joints inside their limits with margin",
    2: "tool inside the position box",
    4: "distance to the camera inside its range, tags large enough in the image",
    8: "enough tags inside the image with margin, pan-tilt unit aimed at the tool",
    16: "incidence of those tags below the limit",
    32: "pan-tilt angles inside their limits with margin",
    64: "nominal arm clear of itself, deck, ground, mast and instruments, with safety distance",
    128: "straight segment from the hub clear, also with all sampled errors",
    256: "line of sight to those tags clear of the arm (rays)",
    512: "clear at the seed with all sampled errors",
    1024: "servo bound around the seed clear under sampled postures and errors",
    2048: "the servo can reach the pose under every named case of errors, if the description asks for it",
}
ALL_CHECKS = sum(CHECKS)


def local_bit() -> int:
    """Bit of kc_cand_t.why that marks a local initial pose."""
    return library("flight").lib.KC_CAND_LOCAL


def reserve_bit() -> int:
    """Bit of kc_cand_t.why that marks a reserve pose among the local ones."""
    return library("flight").lib.KC_CAND_RESERVE


@dataclass(frozen=True)
class Row:
    """One pose of a table: seed (joints,), tool pose in the base frame, tags (bits), its hub (joints,), and
    places of its stops."""

    q_rad: Floats
    pose: Pose
    tags: int
    hub_q_rad: Floats
    stops: tuple[int, ...]


@dataclass(frozen=True)
class SpaceTable:
    """A SPACE table, read only. Rows are poses: the candidates, then the local initial poses.

    q_rad (n, joints): seeds [rad or m], joints that reach the pose on the nominal arm.
    poses (n,): tool pose in the base frame.
    pan_tilt_rad (n, 2): pan-tilt angles that see it.
    tags (n,): bit per tag in view.
    hub (n,): hub with a verified segment to the seed.
    checks (n,): bits of CHECKS, `local_bit`, `reserve_bit`.
    stops (n, most): places of stops on the segment from the hub, in parts of `stop_joints`; 0: none.
    hub_q_rad (hubs, joints); hub_edges (hubs,): bit per hub with a verified segment.
    direct (n, n): verified direct segments, set below the diagonal.
    initial: rows of the initial design, local poses first.
    servo_bound_rad (joints,): how far the servo may take each joint from a seed.
    verified (joints, 4): DH errors that it was verified for, phi, alpha [rad], a, d [m], both ways.
    arm_crc: ARM table that it was built for."""

    q_rad: Floats
    poses: Pose
    pan_tilt_rad: Floats
    tags: Ints
    hub: Ints
    checks: Ints
    stops: Ints
    hub_q_rad: Floats
    hub_edges: Ints
    direct: Bools
    initial: tuple[int, ...]
    servo_bound_rad: Floats
    verified: Floats
    arm_crc: int

    @classmethod
    def load(cls, path: Path) -> tuple[Image, SpaceTable]:
        """Image and contents of a .tbl file. BadInput if it is no SPACE table."""
        image, struct = decode_as("space", path.read_bytes(), str(path))
        return image, cls.from_struct(struct)

    @classmethod
    def from_struct(cls, space: KcSpace) -> SpaceTable:
        """Copy of a kc_space_t."""
        n, joints, hubs = int(space.n_cand), int(space.n_joints), int(space.n_hub)
        rows = library("flight").rows(space.cand, n)
        return cls(
            q_rad=rows["q_seed"][:, :joints].astype(float),
            poses=Pose.of_wxyz(rows["p_m"], rows["q_wxyz"]),
            pan_tilt_rad=np.stack([rows["pan_rad"], rows["tilt_rad"]], axis=1).astype(float),
            tags=rows["tags"].astype(int),
            hub=rows["hub"].astype(int),
            checks=rows["why"].astype(int),
            stops=_stops(space, n),
            hub_q_rad=np.array([list(q)[:joints] for q in space.hub_q[0:hubs]], float).reshape(-1, joints),
            hub_edges=np.array(list(space.hub_edge[0:hubs]), int),
            direct=_direct(space, n),
            initial=tuple(space.initial[0 : space.n_initial]),
            servo_bound_rad=np.array(list(space.servo_bound[0:joints])),
            verified=np.array([[getattr(v, f) for f in DH_FIELDS] for v in space.verified[0:joints]]),
            arm_crc=int(space.arm_crc),
        )

    @property
    def p_m(self) -> Floats:
        """Tool positions in the base frame, (n, 3)."""
        return self.poses.p_m

    @property
    def n_joints(self) -> int:
        """Joints of the arm."""
        return int(self.q_rad.shape[1])

    @property
    def n_candidates(self) -> int:
        """Poses to choose among: all but the local initial poses, which come last."""
        return len(self.checks) - self.n_local

    @property
    def n_local(self) -> int:
        """Local initial poses."""
        return int(np.count_nonzero(self.checks & local_bit()))

    @property
    def n_reserve(self) -> int:
        """Local initial poses that are only taken while few of those before them saw a tag."""
        return int(np.count_nonzero(self.checks & reserve_bit()))

    @property
    def initial_candidates(self) -> tuple[int, ...]:
        """Candidates of the initial design, measured after the local poses."""
        return tuple(i for i in self.initial if i < self.n_candidates)

    def row(self, i: int) -> Row:
        """Row i, with the joints of its hub."""
        stops = tuple(int(part) for part in self.stops[i] if part)
        return Row(self.q_rad[i], self.poses[i], int(self.tags[i]), self.hub_q_rad[self.hub[i]], stops)

    def candidates(self) -> SpaceTable:
        """The same table without local initial poses."""
        n = self.n_candidates
        rows = ("q_rad", "poses", "pan_tilt_rad", "tags", "hub", "checks", "stops")
        cut: dict[str, Any] = {name: getattr(self, name)[:n] for name in rows}
        return replace(self, **cut, direct=self.direct[:n, :n], initial=self.initial_candidates)


def stop_joints(hub_q_rad: Floats, q_rad: Floats, part: int) -> Floats:
    """Joints (joints,) at a place on the segment from a hub to a seed, both as the table has them; part: of
    KC_STOP_PARTS."""
    out: Floats = hub_q_rad + part / library("flight").lib.KC_STOP_PARTS * (q_rad - hub_q_rad)
    return out


def _stops(space: KcSpace, n: int) -> Ints:
    """(n, most) places of stops."""
    flight = library("flight")
    places = np.frombuffer(memoryview(flight.ffi.buffer(space.stop)), np.uint8)
    return places.reshape(-1, flight.lib.KC_STOP_MAX)[:n, : int(space.n_stop)].astype(int)


def _direct(space: KcSpace, n: int) -> Bools:
    """Direct segments below the diagonal: bit i (i - 1) / 2 + j of the table for i > j."""
    packed = np.frombuffer(memoryview(library("flight").ffi.buffer(space.edge)), np.uint8)
    out = np.zeros((n, n), bool)
    out[np.tril_indices(n, -1)] = np.unpackbits(packed, bitorder="little")[: n * (n - 1) // 2]
    return out


def pack_direct(direct: Bools) -> bytes:
    """Direct segments (n, n), set below the diagonal, as the table keeps them."""
    return np.packbits(direct[np.tril_indices(len(direct), -1)], bitorder="little").tobytes()
