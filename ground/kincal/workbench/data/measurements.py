"""Measurements: arrays over the poses of an arm (docs/WORKBENCH.md says what a file holds)."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from kincal_shared.errors import BadInput
from kincal_shared.letters import shown

from ..numerics.types import Array, Groups, Indices, Mask

# Names that effects use for their needs, where they differ from ours.
_RENAMED = {"dir": "direction", "cam": "cam_p_m", "rotation": "quat_wxyz"}
_NAMED = 5  # ids in a message
SAME_PAYLOAD_KG = 0.01
SAME_POSE = 2e-3  # [rad or m], readings that differ by less belong to one commanded pose

DirectionSource = Literal["measured", "inferred", "none"]


@dataclass(frozen=True, eq=False)
class Measurements:
    """Arrays of N poses of an arm with n joints; optional ones are None when the file lacks them.

    source: where they come from; ids: one name a pose; q: (N, n) encoder readings [rad or m]; p_m: (N, 3)
    measured tool position, base frame; quat_wxyz: (N, 4) its orientation; cov: (N, 6, 6) stated covariance of
    (position, rotation vector), base frame [m, rad] (None if nothing was stated); direction: (N, n) approach
    signs; move: (N, n) change of each joint from the pose before, by the order of measurement [rad or m], 0
    where it is unknown; qdot: (N, n) [rad/s or m/s]; g_m_s2: (N, 3) gravity, base frame; cam_p_m,
    cam_quat_wxyz: (N, 3), (N, 4) camera pose in the base frame; tag: (N,) which tag was seen (0 first, 1
    second, 0.5 both); split: (N,) "fit" or "held"; replicate: (N,) number of the group of poses that were
    measured again (same commanded pose), replicate_stated: the file says so; the others are (N,) in the unit
    of their name.
    direction_source: "measured" (in the file), "inferred" from the order of measurement, or "none".
    order_is_time: t_s only counts the poses; skipped: malformed rows that were left out, and why; duplicates:
    number of rows that were left out as copies of another row, rounded: of those, such with fewer digits;
    unknown_columns: columns of the file that nothing reads; notes: what was assumed or left out in reading;
    orientation: how the file writes the orientations, as --rotation says it ("xyzw", "euler-ZYX"), empty if
    it is not known; euler_rad: (N, 3) its Euler angles in the order of the columns, None if it has none;
    sums: `[readings]` of the map, by which q follows from the file's columns;
    whole: the set that these poses were taken from, None if they are all of it.
    """

    source: str
    ids: tuple[str, ...]
    q: Array
    p_m: Array
    quat_wxyz: Array | None = None
    cov: Array | None = None
    t_s: Array | None = None
    direction: Array | None = None
    move: Array | None = None
    qdot: Array | None = None
    temp_c: Array | None = None
    payload_kg: Array | None = None
    g_m_s2: Array | None = None
    range_m: Array | None = None
    incid_rad: Array | None = None
    u_px: Array | None = None
    v_px: Array | None = None
    cam_p_m: Array | None = None
    cam_quat_wxyz: Array | None = None
    tag: Array | None = None
    pan_rad: Array | None = None
    tilt_rad: Array | None = None
    split: NDArray[np.str_] | None = None
    replicate: Groups | None = None
    replicate_stated: bool = False
    order_is_time: bool = False
    direction_source: DirectionSource = "measured"
    skipped: tuple[str, ...] = ()
    duplicates: int = 0
    rounded: int = 0
    unknown_columns: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    orientation: str = ""
    euler_rad: Array | None = None
    sums: tuple[tuple[str, str], ...] = ()
    whole: Measurements | None = None

    def __post_init__(self) -> None:
        if self.direction is None:
            object.__setattr__(self, "direction_source", "none")

    @property
    def n(self) -> int:
        """Number of poses N."""
        return len(self.ids)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.q.shape[1])

    @property
    def components(self) -> int:
        """Residual components of a pose: 6 with orientation, 3 with positions only."""
        return 6 if self.quat_wxyz is not None else 3

    def take(self, index: Indices | Mask) -> Measurements:
        """The poses of `index` (positions or mask), in that order."""
        places = np.flatnonzero(index) if index.dtype == bool else index
        arrays = {name: x[places] for name, x in vars(self).items() if isinstance(x, np.ndarray)}
        changes: dict[str, Any] = {**arrays, "ids": tuple(self.ids[i] for i in places)}
        changes["whole"] = self if self.whole is None else self.whole
        return replace(self, **changes)

    def without(self, ids: Iterable[str]) -> Measurements:
        """The poses but those with these ids. BadInput names ids that no pose has, or says none is left."""
        wanted = set(ids)
        if unknown := sorted(wanted.difference(self.ids)):
            raise BadInput(
                f"no pose has the id {shown(', '.join(unknown[:_NAMED]))}",
                self.source,
                f"ids of these data: {shown(', '.join(self.ids[:_NAMED]))} ...",
            )
        if wanted.issuperset(self.ids):
            raise BadInput("no pose is left", self.source, "leave fewer of them out")
        return self.take(np.array([name not in wanted for name in self.ids], dtype=bool))

    @property
    def repeats(self) -> Groups | None:
        """(N,) number of the group of replicates of each pose; None where no pose was measured again."""
        if self.replicate is None or len(np.unique(self.replicate)) == self.n:
            return None
        return self.replicate

    @property
    def end_s(self) -> float | None:
        """Time of the last pose of the session, be it among these or not [s]; None without times."""
        t_s = (self.whole or self).t_s
        return None if t_s is None else float(t_s.max())

    def are_not(self, ids: Collection[str]) -> Mask:
        """(N,) poses with other ids than these; all poses where that leaves none."""
        others = ~np.isin(self.ids, list(ids))
        return others if others.any() else np.ones(self.n, dtype=bool)

    def has(self, column: str) -> bool:
        """Whether the data carry what an effect needs (`dir`, `temp_c`, `cam`, `rotation` ...)."""
        if column == "own_sensor":
            return self.cam_p_m is None
        return getattr(self, _RENAMED.get(column, column)) is not None

    def constant(self, column: str) -> bool:
        """Whether a column is there and never changes."""
        values = getattr(self, _RENAMED.get(column, column), None)
        return values is not None and not np.ptp(values, axis=0).any()


def of_one_session(data: Measurements, known: Measurements) -> bool:
    """Whether all poses of `data` are measurements of `known`: of the same source, or the same readings and
    positions to the last bit, wherever they were read from."""
    if data.source == known.source:
        return True
    rows, all_rows = (
        {row.tobytes() for row in np.column_stack([x.q, x.p_m])} for x in (data, known.whole or known)
    )
    return rows <= all_rows


def at_time(data: Measurements, t_s: float) -> Measurements:
    """The data as if all poses had been measured at one time."""
    return replace(data, t_s=np.full(data.n, t_s))


def replicate_groups(q: Array, payload_kg: Array | None = None, tol: float = SAME_POSE) -> Groups:
    """(N,) group number per pose: poses whose readings (N, n) all agree within `tol` [rad or m], with the
    same payload (N,), are replicates; a group has the number of its first pose."""
    group = np.full(len(q), -1)
    if payload_kg is not None:
        q = np.column_stack([q, payload_kg * (tol / SAME_PAYLOAD_KG)])
    tree = KDTree(q)
    near = tree.query_ball_tree(tree, tol, p=np.inf)
    for i, neighbours in enumerate(near):
        if group[i] < 0:
            group[[j for j in neighbours if group[j] < 0]] = i
    return group
