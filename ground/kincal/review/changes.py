"""What a correction changes: each value old and new in degrees and millimetres, what it is made of, and where
the tool goes; for the terminal, the page and the console.

It serves a proposal (from the table in force to what is proposed) and a rollback (back to the table
before)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal.flight import Arm, Model, Observations, Terms
from kincal.flight.tables import decode, decode_as
from kincal.link import read_log, unsigned32
from kincal.rotations import angle_of_matrix
from kincal.tables import unit_of
from kincal_shared.errors import BadInput, KincalError

from . import Review, called_poor, kin_crc
from .thresholds import Limits, thresholds

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcTerms

BIG_RAD, BIG_M = math.radians(3.0), 0.025
"""From here on a change is named in the headline: far beyond what thermal cycles and wear do to an arm."""
CORRELATED = 0.95
SUFFIX = ".lcmlog"
_MOST_NAMED = 4
_DATA, _PRIOR = 0.9, 0.1  # share of the information that the data brought
_JOINT = re.compile(r"J(\d+)\.(\w+)")
_WHAT = {
    "phi_rad": ("joint {} is {} off", "rotation"),
    "alpha_rad": ("link {} is twisted by {}", "twist"),
    "a_m": ("link {} is {} off in length", "length"),
    "d_m": ("link {} is {} off along its joint axis", "offset"),
}


@dataclass(frozen=True)
class KinValues:
    """Values of a kinematics table. crc: its own; where: it was
    found."""

    crc: int
    values: tuple[float, ...]
    where: str = ""


@dataclass(frozen=True)
class Change:
    """One coefficient. joint: from 1, 0 if it belongs to none; old: None if the table before is not at hand;
    sigma: 0 if it was not estimated; share: of the bound on the new value's side, NaN without a bound;
    source: what determines the new value."""

    name: str
    unit: str
    joint: int
    old: float | None
    new: float
    sigma: float
    bound: float
    share: float
    source: str

    @property
    def delta(self) -> float:
        """What changes; the whole value if the table before is not at hand."""
        return self.new - (self.old or 0.0)

    @property
    def big(self) -> bool:
        """Whether it belongs in the headline."""
        return abs(self.delta) >= {"rad": BIG_RAD, "m": BIG_M}.get(self.unit, math.inf)

    @property
    def old_text(self) -> str:
        """For people, with unit."""
        return "?" if self.old is None else amount(self.old, self.unit)

    @property
    def new_text(self) -> str:
        """With sigma."""
        sigma = f" ± {amount(self.sigma, self.unit)}" if self.sigma > 0.0 else ""
        return f"{amount(self.new, self.unit)}{sigma}"

    @property
    def delta_text(self) -> str:
        """With sign."""
        return amount(self.delta, self.unit, sign=True)

    @property
    def share_text(self) -> str:
        """Of the bound."""
        return "-" if math.isnan(self.share) else f"{self.share:.0%}"

    @property
    def back(self) -> str:
        """What a rollback does to it."""
        return f"{self.name} goes back by {amount(self.delta, self.unit, sign=True, short=True)}"

    @property
    def sentence(self) -> str:
        """What it means for the arm."""
        found = _JOINT.fullmatch(self.name)
        size = amount(abs(self.delta), self.unit, short=True)
        if found and found[2] in _WHAT:
            return _WHAT[found[2]][0].format(found[1], size)
        return f"{self.name} changes by {size}"


@dataclass(frozen=True)
class ToolShift:
    """Where the tool goes at a posture: distance and turn, and the vector in the base frame [m]."""

    place: str
    pos_m: float
    rot_rad: float
    vector_m: tuple[float, float, float]


@dataclass(frozen=True)
class Reason:
    """What speaks against it: a number and what it has to be."""

    what: str
    number: str
    threshold: str

    @property
    def text(self) -> str:
        """In one line."""
        return f"{self.what} is {self.number}, has to be {self.threshold}" if self.threshold else self.what


@dataclass(frozen=True)
class Changes:
    """headline: the size of the change in one sentence; big: each large change; rows: all that change or were
    estimated, the largest share of a bound first; tool: at work points, then the largest over the space;
    space: RMS and largest shift over the space [m, rad], None without tables; correlations: pairs that the
    data barely tell apart; undetermined: coefficients that nothing determined; old_known: whether the table
    before was at hand."""

    headline: str
    big: tuple[str, ...]
    rows: tuple[Change, ...]
    tool: tuple[ToolShift, ...]
    space: tuple[float, float, float, float] | None
    correlations: tuple[tuple[str, str, float], ...]
    undetermined: tuple[str, ...]
    reasons: tuple[Reason, ...]
    old_known: bool

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json and the console."""
        rows = [
            asdict(c) | {"old_text": c.old_text, "new_text": c.new_text, "delta_text": c.delta_text}
            for c in self.rows
        ]
        return asdict(self) | {"rows": rows, "reasons": [asdict(r) | {"text": r.text} for r in self.reasons]}


def amount(value: float, unit: str, *, sign: bool = False, short: bool = False) -> str:
    """A value in degrees or millimetres, other units as they are. short: for a sentence."""
    plus = "+" if sign else ""
    if unit == "rad":
        degrees = math.degrees(value)
        digits = (0 if abs(degrees) >= 10.0 else 1) if short else 3
        return f"{degrees:{plus}.{digits}f} deg"
    if unit == "m":
        return (
            f"{value * 1e3:{plus}.0f} mm" if short and abs(value) >= 0.01 else f"{value * 1e3:{plus}.2f} mm"
        )
    return f"{value:{plus}.4g} {unit}".strip()


# ---- where old values come from


def kin_values(wanted: int, places: Iterable[Path]) -> KinValues | None:
    """The kinematics table of that CRC: from table images, folders of them, and proposals of logs. None if
    none of the places has it."""
    for place in places:
        for found in _values_in(place):
            if found.crc == wanted:
                return found
    return None


def _values_in(place: Path) -> list[KinValues]:
    if place.is_dir():
        inside = [place / "kin.tbl", *sorted(place.glob(f"*{SUFFIX}"))]
        return [values for file in inside if file.is_file() for values in _values_in(file)]
    try:
        if place.suffix == ".tbl":
            image, kin = decode_as("kin", place.read_bytes(), str(place))
            return [KinValues(image.crc, tuple(kin.value[0 : kin.n_coef]), str(place))]
        sessions = read_log(place, ["KC_PROPOSAL"]).sessions.values()
        proposals = [s.proposal for s in sessions if s.proposal is not None]
    except (KincalError, OSError):
        return []  # what cannot be read holds nothing
    # a message carries no signature: it counts only if its values make the table that it names
    sound = [p for p in proposals if kin_crc(p) == unsigned32(p.crc)]
    return [KinValues(unsigned32(p.crc), tuple(p.value[: p.n_coef]), str(place)) for p in sound]


# ---- where the tool goes


class Flown:
    """Arm, terms and space of the tables of a folder. BadInput if one is missing or damaged."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.arm: KcArm = self._read("arm")
        self._terms: KcTerms = self._read("terms")
        self.terms = Terms.of_table(self._terms)

    def _read(self, kind: str) -> Any:
        file = self.folder / f"{kind}.tbl"
        if not file.is_file():
            raise BadInput(f"no {kind} table", str(file), "give --tables DIR with the tables of the run")
        image, table = decode(file.read_bytes(), str(file))
        if image.kind != kind:
            raise BadInput(
                f"this is a {image.kind} table, a {kind} table is needed",
                str(file),
                "give --tables DIR with the tables of the run",
            )
        return table

    def bound(self, index: int, value: float) -> float:
        """Bound of a coefficient on the side of a value; 0 if it has none."""
        if index >= self.terms.n:
            return 0.0
        coef = self._terms.coef[index]
        return float(coef.ub if value >= 0.0 else -coef.lb)

    def prior_sigma(self, index: int) -> float:
        """1-sigma of its prior; 0: flat."""
        return float(self._terms.coef[index].prior_sigma) if index < self.terms.n else 0.0

    @cached_property
    def places(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Postures of the space, with their names: work points (hubs, of which the first is the park pose),
        then candidates; joints (N, n)."""
        space, n = self._read("space"), int(self.arm.n_joints)
        hubs = [list(space.hub_q[h][0:n]) for h in range(space.n_hub)]
        seeds = [list(space.cand[i].q_seed[0:n]) for i in range(space.n_cand)]
        named = [f"hub {h}" if h else "park pose" for h in range(len(hubs))]
        return (*named, *(f"candidate {i}" for i in range(len(seeds)))), np.array([*hubs, *seeds])

    def shifts(self, old: Sequence[float], new: Sequence[float]) -> list[ToolShift]:
        """Where the tool goes at every place."""
        names, q = self.places
        at = Observations.of_columns({"q": q}, list(self.arm.gravity_m_s2))
        model = Model(Arm.of_table(self.arm), self.terms, at)
        before, after = (model.poses(padded(values, self.terms.n)) for values in (old, new))
        step = after.p_m - before.p_m
        turn = angle_of_matrix(before.R.transpose(0, 2, 1) @ after.R)
        return [
            ToolShift(name, float(np.linalg.norm(d)), float(a), (float(d[0]), float(d[1]), float(d[2])))
            for name, d, a in zip(names, step, turn, strict=True)
        ]

    @property
    def n_work(self) -> int:
        """How many of the places are work points."""
        return sum(not name.startswith("candidate") for name in self.places[0])


def padded(values: Sequence[float], n: int) -> np.ndarray:
    """(n,) values of coefficients; those that are not given are 0."""
    out = np.zeros(n)
    out[: min(len(values), n)] = np.asarray(values, float)[:n]
    return out


# ---- a proposal


def of_review(
    review: Review, old: KinValues | None, flown: Flown | None, limits: Limits | None = None
) -> Changes:
    """What a proposal changes. old: the table in force; flown: its tables; without them the columns stay
    empty."""
    before = old.values if old else None
    rows = []
    for i, c in enumerate(review.coefs):
        was = None if before is None else (before[i] if i < len(before) else 0.0)
        bound = flown.bound(i, c.value) if flown else 0.0
        source = _source(c.status, c.sigma, flown.prior_sigma(i) if flown else 0.0)
        rows.append(_change(c.name, was, c.value, c.sigma, bound, source))
    shown = [row for row in rows if row.sigma > 0.0 or row.delta]
    undetermined = tuple(c.name for c in review.coefs if c.status == "held")
    return _changes(
        shown,
        _shifts(flown, before, [c.value for c in review.coefs]),
        flown,
        correlations=_correlations(review),
        undetermined=undetermined,
        reasons=reasons(review, limits),
        old_known=before is not None,
    )


def of_values(
    values: Sequence[float],
    sigmas: Sequence[float],
    old: KinValues | None,
    names: Sequence[str],
    flown: Flown | None,
) -> Changes:
    """What a kinematics table changes, by its values alone."""
    before = None if old is None else padded(old.values, len(values)).tolist()
    rows = [
        _change(
            names[i] if i < len(names) else f"coef[{i}]",
            None if before is None else before[i],
            value,
            sigma,
            flown.bound(i, value) if flown else 0.0,
            # the words are for those without sigma
            _source("not estimated", sigma, flown.prior_sigma(i) if flown else 0.0),
        )
        for i, (value, sigma) in enumerate(zip(values, sigmas, strict=True))
    ]
    shown = [row for row in rows if row.sigma > 0.0 or row.delta]
    return _changes(shown, _shifts(flown, before, values), flown, old_known=before is not None)


def of_rollback(now: KinValues, previous: KinValues, names: Sequence[str], flown: Flown | None) -> Changes:
    """What a rollback changes back: from the table in force to the one before it."""
    n = max(len(now.values), len(previous.values))
    both = [padded(values.values, n) for values in (now, previous)]
    rows = [
        _change(
            names[i] if i < len(names) else f"coef[{i}]",
            float(both[0][i]),
            float(both[1][i]),
            0.0,
            flown.bound(i, float(both[1][i])) if flown else 0.0,
            "table before",
        )
        for i in range(n)
    ]
    shown = [row for row in rows if row.delta]
    return _changes(shown, _shifts(flown, now.values, previous.values), flown, old_known=True, back=True)


def _change(name: str, old: float | None, new: float, sigma: float, bound: float, source: str) -> Change:
    found = _JOINT.fullmatch(name)
    share = abs(new) / bound if bound > 0.0 else math.nan
    return Change(name, unit_of(name), int(found[1]) if found else 0, old, new, sigma, bound, share, source)


def _source(status: str, sigma: float, prior: float) -> str:
    """What determines a value: the share of the information that the data brought, beside the prior."""
    if status in ("held", "masked"):
        return f"{status}: kept as it was"
    if sigma <= 0.0:
        return status
    data = 1.0 if prior <= 0.0 else max(0.0, 1.0 - (sigma / prior) ** 2)
    by = "data" if data >= _DATA else "prior" if data <= _PRIOR else f"data {data:.0%}, prior"
    return f"{by}, {status}" if status.startswith("at ") else by


def _shifts(flown: Flown | None, old: Sequence[float] | None, new: Sequence[float]) -> list[ToolShift]:
    if flown is None or old is None or not (flown.folder / "space.tbl").is_file():
        return []
    return flown.shifts(old, new)


def _changes(
    rows: Sequence[Change],
    shifts: Sequence[ToolShift],
    flown: Flown | None,
    *,
    correlations: tuple[tuple[str, str, float], ...] = (),
    undetermined: tuple[str, ...] = (),
    reasons: tuple[Reason, ...] = (),
    old_known: bool,
    back: bool = False,
) -> Changes:
    ranked = sorted(rows, key=lambda row: -_size(row))
    big = tuple(row.back if back else row.sentence for row in ranked if row.big)
    n_work = flown.n_work if flown and shifts else 0
    work, over = list(shifts[:n_work]), list(shifts[n_work:])
    space = None
    if over:
        pos, rot = np.array([s.pos_m for s in over]), np.array([s.rot_rad for s in over])
        space = (_rms(pos), float(pos.max()), _rms(rot), float(rot.max()))
        work.append(max(over, key=lambda s: s.pos_m))
    return Changes(
        _headline(ranked, big, space),
        big,
        tuple(ranked),
        tuple(work),
        space,
        correlations,
        undetermined,
        reasons,
        old_known,
    )


def _size(row: Change) -> float:
    """To rank changes of different units: against what is named in the headline."""
    return abs(row.delta) / {"rad": BIG_RAD, "m": BIG_M}.get(row.unit, math.inf)


def _headline(rows: Sequence[Change], big: Sequence[str], space: tuple[float, ...] | None) -> str:
    tool = f"; the tool moves by up to {amount(space[1], 'm', short=True)}" if space else ""
    if big:
        more = f", and {len(big) - _MOST_NAMED} more" if len(big) > _MOST_NAMED else ""
        text = ", ".join(big[:_MOST_NAMED]) + more
        return f"{text[:1].upper()}{text[1:]}{tool}"
    if not rows:
        return "Nothing changes"
    return f"Largest change: {rows[0].name} {rows[0].delta_text}{tool}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _correlations(review: Review) -> tuple[tuple[str, str, float], ...]:
    """Pairs of estimated coefficients that the data barely tell apart, the strongest first."""
    names = [c.name for c in review.estimated]
    i, k = np.triu_indices(len(names), 1)
    rho = review.correlation[i, k]
    strong = [
        (names[a], names[b], float(r)) for a, b, r in zip(i, k, rho, strict=True) if abs(r) >= CORRELATED
    ]
    return tuple(sorted(strong, key=lambda pair: -abs(pair[2])))


def reasons(review: Review, limits: Limits | None) -> tuple[Reason, ...]:
    """What speaks against a proposal, each with its number and threshold."""
    out = []
    if review.verdict == "poor fit":
        out.append(Reason(called_poor(review.numbers), "", ""))
    numbers = review.numbers | {"n_outliers": float(review.n_outliers)}
    for key, asked in thresholds(review, limits).items():
        if asked.kept is False:
            out.append(Reason(key, _number(key, numbers[key]), asked.text))
    return tuple(out)


def _number(key: str, value: float) -> str:
    unit = "m" if key.endswith("_m") else "rad" if key.endswith("_rad") else ""
    return amount(value, unit)


def names_of(tables_dir: Path) -> list[str]:
    """Names of the coefficients of a folder's TERMS table; empty if it has none."""
    file = tables_dir / "terms.tbl"
    if not file.is_file():
        return []
    return list(Terms.of_table(decode_as("terms", file.read_bytes(), str(file))[1]).names)


def flown(tables_dir: Path) -> Flown | None:
    """Tables of a folder; None if they are not all there."""
    try:
        return Flown(tables_dir)
    except BadInput:
        return None
