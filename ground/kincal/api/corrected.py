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
from kincal.flight.tables import decode, kind_number
from kincal.link import crc_text, unsigned32
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
    want: of each; passed_over: whether flight goes on without those that fail, as at stops without tags."""

    what: str
    want: str
    of: int
    passed_over: bool
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
    """space, description: that it was asked of; tables: where they were found, in words; margin_m: what
    verified segments keep on arms with errors; nominal_m: on the nominal arm; old_known: whether the table in
    force was at hand, if not the nominal arm stands for it; left_out_m: how far the tool is moved by effects
    that are no DH errors, at most: these are not in the numbers."""

    space: str
    description: str
    tables: str
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
    def source(self) -> str:
        """Where the numbers come from."""
        return f"Computed with {self.tables}; shapes and steps of {self.description}."

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the new table: an approval has to override it."""
        asked = f"at least {self.margin_m * 1e3:.0f} mm"
        near = [c for c in self.clear if _or_far(c.after.distance_m) < self.margin_m]
        return tuple(Reason(f"clearance of {c.what} ({c.after.where})", c.after.text, asked) for c in near)

    @property
    def against(self) -> tuple[str, ...]:
        """The reasons, in words."""
        return tuple(reason.text for reason in self.reasons)

    @property
    def look_at(self) -> tuple[str, ...]:
        """What a reviewer has to know besides the reasons, in words."""
        lost = [r for r in self.reach if r.lost]
        return tuple(f"{len(r.lost)} of {r.of} {r.what} no longer {r.want}: {r.lost_text}" for r in lost)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the numbers do not say."""
        out = [self.source]
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
        return asdict(self) | {"headline": self.headline, "reasons": list(self.against)}

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


def in_force(table_crc: Sequence[int]) -> dict[str, int]:
    """Kind -> CRC of the tables that clearance and reach depend on, by `table_crc` of KC_HK; 0: none."""
    numbers = {kind: kind_number(kind) for kind in KINDS}
    return {kind: unsigned32(table_crc[n]) for kind, n in numbers.items() if n < len(table_crc)}


def misfits(tables_dir: Path, wanted: Mapping[str, int]) -> dict[str, str]:
    """Kind -> how the table of a folder differs from the one that is wanted (a CRC, 0: not known), in words.
    A table that is not there, or cannot be read, differs."""
    out = {}
    for kind, crc in wanted.items():
        file = tables_dir / f"{kind}.tbl"
        found = "none"
        try:
            if file.is_file():
                image = decode(file.read_bytes(), str(file))[0]
                found = image.crc_text if image.kind == kind else f"a {image.kind.upper()} table"
        except (BadInput, OSError):
            found = "one that cannot be read"
        if crc and found != crc_text(crc):
            out[kind] = f"{kind.upper()} {crc_text(crc)} is in force, {found} is here"
    return out


def require(tables_dir: Path, wanted: Mapping[str, int]) -> None:
    """BadInput if the tables of a folder are not those that are wanted (see `misfits`)."""
    if differ := misfits(tables_dir, wanted):
        first = next(iter(differ))
        raise BadInput(
            f"the tables at hand are not those in force: {'; '.join(differ.values())}",
            str(tables_dir),
            f"--tables DIR with those in force; `kincal table dump {first} DIR/{first}.tbl` reads one back",
        )


def of_review(
    review: Review, old: KinValues | None, tables_dir: Path, description: Path | None = None,
    progress: Progress = silent, wanted: Mapping[str, int] = {},  # noqa: B006
) -> Corrected:  # fmt: skip
    """Clearance and reach of a proposal. description: of the SPACE table, as default the one that ships;
    wanted: CRCs of the tables that fly. BadInput if tables are missing, do not belong together or are
    others."""
    after = tuple(c.value for c in review.coefs)
    before = None if old is None else old.values
    return between(before, after, tables_dir, description, progress, wanted)


def between(
    before: Sequence[float] | None, after: Sequence[float], tables_dir: Path,
    description: Path | None = None, progress: Progress = silent,
    wanted: Mapping[str, int] = {}, said: str = "",  # noqa: B006
) -> Corrected:  # fmt: skip
    """From values of the coefficients to others, with the tables of a folder (see of_review); said: where
    they come from, as default the folder. A process computes an arm once."""
    if why := why_not(tables_dir):
        todo = "give --tables DIR with all tables; `pip install 'kincal[sim]'` if that is missing"
        raise BadInput(why.splitlines()[0], str(tables_dir), todo)
    require(tables_dir, wanted)
    if not all(map(math.isfinite, (*(before or ()), *after))):
        raise BadInput("a kinematics table has a value that is no finite number", todo="do not decide by it")
    try:
        file = description or description_of(tables_dir)
        given = _Given(tables_dir, file)
        total = sum(given.steps for values in (before, after) if (given.key, _dense(values)) not in _arms)
        step = _Counted(progress, total)
        arms = [_arm(given, _dense(values), step) for values in (before, after)]
    except OSError as error:
        raise BadInput(
            f"a file cannot be read: {error.strerror}",
            str(error.filename or ""),
            "see to its permissions, or name another folder by --tables",
        ) from None
    now, then = arms
    return Corrected(
        given.space_crc, str(file), said or f"the tables of {tables_dir}", given.desc.clear.perturbed_m,
        given.desc.clear.nominal_m, before is not None, max(now.left_out_m, then.left_out_m),
        tuple(Clear(what, now.near[what], then.near[what]) for what in now.near),
        tuple(dataclasses.replace(a, after=b.before) for a, b in zip(now.reach, then.reach, strict=True)),
    )  # fmt: skip


def identity(
    before: Sequence[float] | None, after: Sequence[float], tables_dir: Path, description: Path
) -> str:
    """What a result belongs to: values, tables and description, as a hash."""
    out = hashlib.sha256(repr((before is None, _dense(before), _dense(after))).encode())
    return _hashed(out, tables_dir, description)


def _hashed(out: Any, tables_dir: Path, description: Path) -> str:
    for file in (*(tables_dir / f"{kind}.tbl" for kind in KINDS), description):
        out.update(file.read_bytes())
    return str(out.hexdigest())


def _dense(values: Sequence[float] | None) -> tuple[float, ...]:
    """Without zeros at the end: coefficients that are not given are 0."""
    out = list(values or ())
    while out and out[-1] == 0.0:
        out.pop()
    return tuple(out)


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
    todo = "name the description that this SPACE was built from: --space FILE"
    raise BadInput(why or "the description of the SPACE table is not at hand", str(tables_dir), todo)


class _Given:
    """What clearance and reach are computed with: tables of a folder, description of their SPACE."""

    def __init__(self, tables_dir: Path, description: Path) -> None:
        from kincal import space

        self.key = _hashed(hashlib.sha256(), tables_dir, description)
        self.tables, self.desc = space.TablesFolder(tables_dir), space.read_description(description)
        self.space, self.flown = self.tables.space, Flown(tables_dir)
        self.space_crc = f"{space.SpaceTable.load(tables_dir / 'space.tbl')[0].crc:08x}"
        _require_of(self.desc, self.space, self.tables.arm_crc, description)
        self.groups = list(_postures(self.desc, self.space))
        self.steps = sum(len(rows) for _, rows in self.groups) + len(self.space.q_rad)

    def arm(self, errors: Mapping[str, float]) -> Any:
        from kincal import space

        return space.CorrectedArm(self.desc, self.tables.arm, self.tables.camera, dict(errors), HORIZON_M)


@dataclass(frozen=True)
class _Computed:
    """One arm: where each group is nearest to something, what is not reached or shown (as `before`)."""

    near: Mapping[str, Near]
    reach: tuple[Reach, ...]
    left_out_m: float


_arms: dict[tuple[str, tuple[float, ...]], _Computed] = {}


@dataclass
class _Counted:
    """Says now and then how far the work has come."""

    progress: Progress
    total: int
    done: int = 0

    def __call__(self, what: str) -> None:
        self.done += 1
        if self.done % 50 == 0 or self.done == self.total:
            self.progress(what, self.done, self.total)


def _arm(given: _Given, values: tuple[float, ...], step: Callable[[str], None]) -> _Computed:
    """The arm as a kinematics table has it."""
    if (given.key, values) not in _arms:
        _arms[given.key, values] = _compute(given, values, step)
        while len(_arms) > _REMEMBERED:
            del _arms[next(iter(_arms))]
    return _arms[given.key, values]


def _compute(given: _Given, values: tuple[float, ...], step: Callable[[str], None]) -> _Computed:
    errors = _dh_errors(given.flown, values)
    arm = given.arm(errors)
    reach, reached = _reached(arm, given.space, step)
    near: dict[str, Near] = {}
    for what, rows in given.groups:
        near[what] = _nearest(arm, rows, step)
        if what == "seeds of candidates":
            near["candidates, tool at its pose"] = _nearest(arm, reached, lambda _what: None)
    left_out = _left_out_m(given.flown, values, errors, given.space.q_rad)
    return _Computed(near, tuple(reach), left_out)


def _nearest(arm: Any, rows: Sequence[tuple[str, Floats]], step: Callable[[str], None]) -> Near:
    """The posture of a group that is nearest to something."""
    best = Near()
    for place, q in rows:
        step("distances")
        distance_m, pair = arm.nearest(q)
        if pair and distance_m < _or_far(best.distance_m):
            best = Near(distance_m, pair, place)
    return best


def _require_of(desc: Any, table: Any, arm_crc: int, file: Path) -> None:
    """That a table was built from a description, as far as it shows."""
    todo = "name the description that this SPACE was built from: --space FILE"
    if table.arm_crc != arm_crc:
        raise BadInput(
            f"the SPACE table was built for ARM {table.arm_crc:08x}, this is {arm_crc:08x}",
            todo="--tables DIR with tables that belong together; `kincal table dump KIND FILE` gets those",
        )
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
        Reach("candidates", "reached with tags in view", n, False, lost, {}),
        Reach("local initial poses", "with a tag in view", len(table.q_rad) - n, False, local, {}),
        Reach("stops along segments", "with tags in view", len(stops), True, _unseen(arm, stops), {}),
    ]
    return groups, reached


def _unseen(arm: Any, named: Sequence[tuple[str, Floats]]) -> dict[str, str]:
    """Those of some postures at which too few tags show, and why."""
    if not named:
        return {}
    problems = arm.view_problems(np.array([q for _, q in named]))
    return {name: problem for (name, _), problem in zip(named, problems, strict=True) if problem}
