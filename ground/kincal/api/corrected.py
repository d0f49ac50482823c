"""Clearance and reach with a correction, against the kinematics table in force: by the shapes, segments and
checks that the search space was verified with (kincal.space), for the arm as each of the two tables has it.

The joints of park pose, hubs, seeds, local poses, stops and segments are what encoders read: they stay, and
the arm stands where the table says. At a candidate flight brings the tool to its pose: joints change."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kincal.flight import Arm, Model, Observations
from kincal.review import Review
from kincal.review.changes import Flown, KinValues, Reason, amount, padded
from kincal.rotations import Floats
from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS

DESCRIPTION = "tables/src/space.toml"
HORIZON_M = 0.1
"""Farther away than this counts as far."""
KINDS = ("arm", "camera", "terms", "space")
_REMEMBERED = 20
_SAME = 1e-6  # a value of a description, and of the table that was built from it
_NAMED = 3
Progress = Callable[[str, int, int], None]
Plain = dict[str, Any]


def silent(_what: str, _done: int, _of: int) -> None:
    """A progress callback that shows nothing."""


@dataclass(frozen=True)
class Near:
    """Where a group of postures is nearest to something: distance [m], None if it is farther than HORIZON_M
    everywhere; pair of shapes; which posture."""

    distance_m: float | None = None
    pair: str = ""
    place: str = ""

    @property
    def text(self) -> str:
        """For people."""
        if self.distance_m is None:
            return f"more than {HORIZON_M * 1e3:.0f} mm"
        return f"{self.distance_m * 1e3:.1f} mm"

    @property
    def where(self) -> str:
        """What is near, and at which posture."""
        return f"{self.pair}, {self.place}" if self.pair else ""


@dataclass(frozen=True)
class Clear:
    """Clearance of a group of postures with the table in force and with the proposed one."""

    what: str
    before: Near
    after: Near


@dataclass(frozen=True)
class Reach:
    """A group of poses: how many there are, and those that fail with each table: pose -> why. what: they are;
    want: of each; asked: whether losing one is worth a remark (flight passes over stops that show no tag)."""

    what: str
    want: str
    of: int
    asked: bool
    before: Mapping[str, str]
    after: Mapping[str, str]

    @property
    def lost(self) -> tuple[str, ...]:
        """What fails with the proposed table only."""
        return tuple(name for name in self.after if name not in self.before)

    @property
    def won(self) -> tuple[str, ...]:
        """What fails with the table in force only."""
        return tuple(name for name in self.before if name not in self.after)

    @property
    def lost_text(self) -> str:
        """The first of them, with why."""
        shown = [f"{name}: {self.after[name]}" for name in self.lost[:_NAMED]]
        more = f"; {len(self.lost) - _NAMED} more" if len(self.lost) > _NAMED else ""
        return "; ".join(shown) + more


@dataclass(frozen=True)
class Corrected:
    """space, description: that it was asked of; margin_m: what verified segments keep on arms with errors;
    nominal_m: on the nominal arm; old_known: whether the table in force was at hand, if not it stands for the
    nominal arm; left_out_m: how far the tool is moved by effects that are no DH errors, at most: these are
    not in the numbers."""

    space: str
    description: str
    margin_m: float
    nominal_m: float
    old_known: bool
    left_out_m: float
    clear: tuple[Clear, ...]
    reach: tuple[Reach, ...]

    @property
    def worst(self) -> Clear:
        """The group that comes nearest with the proposed table."""
        return min(self.clear, key=lambda c: _or_far(c.after.distance_m))

    @property
    def headline(self) -> str:
        """In one sentence."""
        c = self.worst
        lost = [f"{len(r.lost)} of {r.of} {r.what} no longer {r.want}" for r in self.reach if r.lost]
        where = f" ({c.after.where})" if c.after.where else ""
        was = f"with the table in force {c.before.text}"
        return f"Clearance of {c.what}: {c.after.text}{where}, {was}; {'; '.join(lost) or 'no pose is lost'}"

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the correction."""
        asked = f"at least {self.margin_m * 1e3:.0f} mm"
        near = [c for c in self.clear if _or_far(c.after.distance_m) < self.margin_m]
        return tuple(Reason(f"clearance of {c.what} ({c.after.where})", c.after.text, asked) for c in near)

    @property
    def look_at(self) -> tuple[str, ...]:
        """What a reviewer has to know, in words."""
        out = [reason.text for reason in self.reasons]
        lost = [r for r in self.reach if r.lost and r.asked]
        out += [f"{len(r.lost)} of {r.of} {r.what} no longer {r.want}: {r.lost_text}" for r in lost]
        return tuple(out)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the numbers do not say."""
        out = []
        if not self.old_known:
            out.append("The table in force is not at hand: the nominal arm stands for it.")
        if self.left_out_m >= _LEFT_OUT_M:
            out.append(
                f"Effects that are no DH errors move the tool by up to {amount(self.left_out_m, 'm')}: they "
                "are not in these numbers."
            )
        return tuple(out)

    def as_dict(self) -> Plain:
        """Plain data for --json and the console; `of_dict` makes it whole again."""
        return asdict(self) | {"headline": self.headline, "reasons": [r.text for r in self.reasons]}

    @classmethod
    def of_dict(cls, plain: Plain) -> Corrected:
        """From `as_dict`."""
        clear = [Clear(c["what"], Near(**c["before"]), Near(**c["after"])) for c in plain["clear"]]
        rest = {k: v for k, v in plain.items() if k not in ("headline", "reasons")}
        return cls(**rest | {"clear": tuple(clear), "reach": tuple(Reach(**r) for r in plain["reach"])})


_LEFT_OUT_M = 1e-4


def _or_far(distance_m: float | None) -> float:
    return math.inf if distance_m is None else distance_m


def why_not(tables_dir: Path) -> str:
    """Why clearance and reach cannot be computed for the tables of a folder; empty if they can."""
    if missing := [kind for kind in KINDS if not (tables_dir / f"{kind}.tbl").is_file()]:
        return f"{tables_dir} has no {', '.join(missing)} table"
    try:
        installation.require("sim", "clearance and reach")
    except BadInput as error:
        return str(error)
    return ""


def of_review(
    review: Review, old: KinValues | None, tables_dir: Path, description: Path | None = None,
    progress: Progress = silent,
) -> Corrected:  # fmt: skip
    """Clearance and reach of a proposal. description: of the SPACE table, as default the one that ships.
    BadInput if tables are missing or do not belong together."""
    after = tuple(c.value for c in review.coefs)
    before = None if old is None else old.values
    return between(before, after, tables_dir, description, progress)


def between(
    before: Sequence[float] | None, after: Sequence[float], tables_dir: Path,
    description: Path | None = None, progress: Progress = silent,
) -> Corrected:  # fmt: skip
    """From values of the coefficients to others, with the tables of a folder (see of_review). A process
    computes it once."""
    if why := why_not(tables_dir):
        raise BadInput(why)
    file = description or description_of(tables_dir)
    key = identity(before, after, tables_dir, file)
    if key not in _computed:
        _computed[key] = _compute(before, after, tables_dir, file, progress)
        while len(_computed) > _REMEMBERED:
            del _computed[next(iter(_computed))]
    return _computed[key]


_computed: dict[str, Corrected] = {}


def identity(
    before: Sequence[float] | None, after: Sequence[float], tables_dir: Path, description: Path
) -> str:
    """What a result belongs to: values, tables and description, as a hash."""
    out = hashlib.sha256(repr((None if before is None else tuple(before), tuple(after))).encode())
    for file in (*(tables_dir / f"{kind}.tbl" for kind in KINDS), description):
        out.update(file.read_bytes())
    return out.hexdigest()


def description_of(tables_dir: Path, more: Sequence[Path] = ()) -> Path:
    """The description that the SPACE table of a folder was built from: of `more`, beside the table, in `src`
    beside the folder, or the one that ships. BadInput if it is none of them."""
    from kincal import space

    given, why = space.TablesFolder(tables_dir), ""
    beside = (tables_dir / "space.toml", tables_dir.parent / "src" / "space.toml")
    for file in (*more, *beside, installation.file(DESCRIPTION)):
        if not file.is_file():
            continue
        try:
            _require_of(space.read_description(file), given.space, given.arm_crc, file)
        except BadInput as error:
            why = str(error)
        else:
            return file
    raise BadInput(why or "the description of the SPACE table is not at hand", str(tables_dir))


def _compute(
    before: Sequence[float] | None, after: Sequence[float], tables_dir: Path, description: Path,
    progress: Progress,
) -> Corrected:  # fmt: skip
    from kincal import space

    given, desc = space.TablesFolder(tables_dir), space.read_description(description)
    table, flown = given.space, Flown(tables_dir)
    crc = space.SpaceTable.load(tables_dir / "space.tbl")[0].crc
    _require_of(desc, table, given.arm_crc, description)
    both = [_dh_errors(flown, () if values is None else values) for values in (before, after)]
    arms = [space.CorrectedArm(desc, given.arm, given.camera, errors, HORIZON_M) for errors in both]
    groups = list(_postures(desc, table))
    total = sum(len(rows) for _, rows in groups) + 2 * len(table.q_rad)
    done = 0

    def step(what: str) -> None:
        nonlocal done
        done += 1
        if done % 50 == 0 or done == total:
            progress(what, done, total)

    reach, joints = [], []
    for arm in arms:
        found, reached = _reached(arm, table, step)
        reach.append(found)
        joints.append(reached)
    clear = []
    for what, rows in groups:
        near = [_Nearest(), _Nearest()]
        for place, q in rows:
            step("distances")
            for arm, best in zip(arms, near, strict=True):
                best.take(*arm.nearest(q), place)
        clear.append(Clear(what, *(best.found for best in near)))
    at_poses = [_Nearest(), _Nearest()]
    for arm, rows, best in zip(arms, joints, at_poses, strict=True):
        for place, q in rows:
            best.take(*arm.nearest(q), place)
    clear.insert(3, Clear("candidates, tool at its pose", *(best.found for best in at_poses)))
    left_out = max(_left_out_m(flown, values or (), errors, table.q_rad)
                   for values, errors in zip((before, after), both, strict=True))  # fmt: skip
    return Corrected(
        f"{crc:08x}", str(description), desc.clear.perturbed_m, desc.clear.nominal_m, before is not None,
        left_out, tuple(clear),
        tuple(dataclasses.replace(a, after=b.before) for a, b in zip(*reach, strict=True)),
    )  # fmt: skip


@dataclass
class _Nearest:
    """The least distance so far."""

    found: Near = Near()

    def take(self, distance_m: float, pair: str, place: str) -> None:
        if pair and distance_m < _or_far(self.found.distance_m):
            self.found = Near(distance_m, pair, place)


def _require_of(desc: Any, table: Any, arm_crc: int, file: Path) -> None:
    """That a table was built from a description, as far as it shows."""
    todo = "name the description that this SPACE was built from: --space FILE"
    if table.arm_crc != arm_crc:
        raise BadInput(f"the SPACE table was built for ARM {table.arm_crc:08x}, this is {arm_crc:08x}")
    bounds = np.array([getattr(desc.error_bounds, field) for field in DH_FIELDS]).T
    hubs = np.array(desc.joints.hubs_rad)
    same = bounds.shape == table.verified.shape and np.allclose(bounds, table.verified, atol=_SAME)
    same = same and hubs.shape == table.hub_q_rad.shape and np.allclose(hubs, table.hub_q_rad, atol=_SAME)
    if not same:
        raise BadInput("this is not the description of the SPACE table", str(file), todo)


def _dh_errors(flown: Flown, values: Sequence[float]) -> dict[str, float]:
    """DH errors of a kinematics table by name."""
    names = zip(flown.terms.names, values, strict=False)
    return {n: float(v) for n, v in names if v and n.partition(".")[2] in DH_FIELDS and n.startswith("J")}


def _left_out_m(flown: Flown, values: Sequence[float], errors: Mapping[str, float], q_rad: Floats) -> float:
    """How far the arm as flight has it and as it is drawn here are apart, over the poses of the space."""
    at = Observations.of_columns({"q": q_rad}, list(flown.arm.gravity_m_s2))
    whole = Model(Arm.of_table(flown.arm), flown.terms, at).poses(padded(values, flown.terms.n))
    drawn = Arm.of_table(flown.arm, errors).fk(q_rad)
    return float(np.max(np.linalg.norm(whole.p_m - drawn.p_m, axis=1)))


# ---- postures that are verified


def _postures(desc: Any, table: Any) -> Iterator[tuple[str, list[tuple[str, Floats]]]]:
    """Groups of postures with their names."""
    n = table.n_candidates
    hubs = [(_hub(h), q) for h, q in enumerate(table.hub_q_rad)]
    yield "park pose", hubs[:1]
    yield "hubs", hubs
    yield "seeds of candidates", [(f"seed of candidate {i}", table.q_rad[i]) for i in range(n)]
    yield "local initial poses", [(_pose(table, i), table.q_rad[i]) for i in range(n, len(table.q_rad))]
    yield "verified segments", list(_on_segments(desc, table))


def _on_segments(desc: Any, table: Any) -> Iterator[tuple[str, Floats]]:
    from kincal.space.clearance import segment_postures

    for name, a, b in _segments(table):
        for q in segment_postures(a, b, desc.clear.step_rad):
            yield name, q


def _segments(table: Any) -> Iterator[tuple[str, Floats, Floats]]:
    """Every verified segment: between hubs, from the hub of a pose, and direct ones."""
    hubs = table.hub_q_rad
    for i in range(len(hubs)):
        for j in range(i):
            if int(table.hub_edges[i]) >> j & 1:
                yield f"segment {_hub(j)} to {_hub(i)}", hubs[j], hubs[i]
    for i, q in enumerate(table.q_rad):
        h = int(table.hub[i])
        yield f"segment {_hub(h)} to {_pose(table, i)}", hubs[h], q
    for i, j in np.argwhere(table.direct):
        yield f"segment {_pose(table, j)} to {_pose(table, i)}", table.q_rad[j], table.q_rad[i]


def _hub(h: int) -> str:
    return f"hub {h}" if h else "park pose"


def _pose(table: Any, i: int) -> str:
    n = table.n_candidates
    return f"candidate {i}" if i < n else f"local pose {i - n + 1}"


# ---- reach


def _reached(
    arm: Any, table: Any, step: Callable[[str], None]
) -> tuple[list[Reach], list[tuple[str, Floats]]]:
    """What this arm does not reach or show (as `before`), and the joints at the candidates that it
    reaches."""
    n = table.n_candidates
    reached: list[tuple[str, Floats]] = []
    out_of_reach: dict[str, str] = {}
    local: dict[str, str] = {}
    stops: list[tuple[str, Floats]] = []
    for i in range(len(table.q_rad)):
        step("reach and view")
        row, name = table.row(i), _pose(table, i)
        if i >= n:
            if problem := arm.local_view_problem(row.q_rad):
                local[name] = problem
            continue
        q, problem = arm.servo(row.q_rad, row.pose, table.servo_bound_rad)
        if problem:
            out_of_reach[name] = problem
        else:
            reached.append((name, q))
        stops += [(f"stop {part} to {name}", q_stop) for part, q_stop in arm.stops(row)]
    lost = out_of_reach | _unseen(arm, reached)
    groups = [
        Reach("candidates", "reached with tags in view", n, True, lost, {}),
        Reach("local initial poses", "with a tag in view", len(table.q_rad) - n, True, local, {}),
        Reach("stops on segments", "with tags in view", len(stops), False, _unseen(arm, stops), {}),
    ]
    return groups, reached


def _unseen(arm: Any, named: Sequence[tuple[str, Floats]]) -> dict[str, str]:
    """Those of some postures at which too few tags show, and why."""
    if not named:
        return {}
    problems = arm.view_problems(np.array([q for _, q in named]))
    return {name: problem for (name, _), problem in zip(named, problems, strict=True) if problem}
