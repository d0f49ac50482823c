"""The model as a term-table image: flight then estimates these coefficients with the DH errors."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kincal.flight import Arm, library, status_name, tables
from kincal.flight.bounds import Flown, place_text, shared_bounds, tightest
from kincal.flight.terms import Coefficient, fill_terms
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import PNP, is_unnamed
from kincal_shared.writing import claim, write_files

from . import capacity
from .effects import Hypothesis
from .hypotheses import covers, effect_of, place_of
from .modelfile import ModelFile
from .parameters import dh_parameters
from .unnamed_names import UnnamedName

if TYPE_CHECKING:
    from kincal.flight.headers import KcTerms

# Typical sizes of the DH errors on board (tables/src/terms.toml states the reasons).
_DH_SCALE = {"phi_rad": 0.1, "alpha_rad": 0.1, "a_m": 0.05, "d_m": 0.05, "beta_rad": 0.1}
_EFFECT_PRIOR = 3.0  # prior sigmas of the library; those that data chose stay
# Bounds that effects ask for: this many prior sigmas, or, once fitted, this many times the fitted value, but
# not less than so many sigmas. One that cannot have _LEAST times its value does not fly.
_UNFITTED, _FITTED, _FITTED_LEAST, _LEAST = 30.0, 2.0, 3.0, 1.2


def flight_name(effect: str, parameter: str, alone: bool) -> str:
    """A coefficient name that fits into flight's table and keeps joint and parameter apart; alone: the
    effect has no other parameter."""
    longest = library("flight").lib.KC_NAME_LEN - 1
    if is_unnamed(effect):
        return f"{_short_place(effect)}.{parameter}"[-longest:]
    tail = place_of(effect) + ("" if alone else f".{parameter}")
    return effect_of(effect)[: longest - len(tail)] + tail


def _short_place(effect: str) -> str:
    """unnamed[link 3 tilt: q1, dir3] -> L3r:q1,dir3"""
    name = UnnamedName.parse(effect)
    word, *rest = name.place.split()
    number = rest[0] if rest and rest[0].isdigit() else ""
    kind = "" if word == "joint" else "t" if rest[-1] == "translation" else "r"
    return f"{word[0].upper()}{number}{kind}:{','.join(name.drivers)}"


def coefficients(
    arm: ArmTable, hypotheses: Sequence[Hypothesis], model: ModelFile | None = None
) -> list[Coefficient]:
    """The DH errors and the effects' coefficients with their priors on board. Bounds of the effects are what
    they ask for (model: whose last fit says how large they are); DH errors have what the space leaves.
    BadInput if two would have the same name there."""
    fitted = model.values if model else {}
    rows = [Coefficient(name, p.terms, math.inf, 0.0, _DH_SCALE[p.name]) for name, p in dh_parameters(arm)]
    rows += [
        Coefficient(
            flight_name(h.name, p.name, len(h.parameters) == 1),
            p.terms,
            _wanted_bound(p.sigma, fitted.get(f"{h.name}.{p.name}")),
            p.sigma if p.shrunk else _EFFECT_PRIOR * p.sigma,
            p.sigma,
        )
        for h in hypotheses
        for p in h.parameters
    ]
    names = [row.name for row in rows]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise BadInput(f"two coefficients would be called {doubled[0]!r} on board; shorten the effect's name")
    return rows


def _wanted_bound(sigma: float, fitted: tuple[float, float] | None) -> float:
    """fitted: value and standard error."""
    if fitted is None:
        return _UNFITTED * sigma
    return max(_FITTED * abs(fitted[0]), _FITTED_LEAST * sigma)


def term_table(
    arm: ArmTable, hypotheses: Sequence[Hypothesis], flown: Flown, model: ModelFile | None = None
) -> KcTerms:
    """Flight's term table of the DH errors and the effects; it names the arm, so that flight refuses it for
    another one.

    flown: whose search space bounds the coefficients (docs/SPACES.md); a DH error that it was not verified
    for is not estimated. model: whose last fit says how large effects are and what could be left out.
    BadInput if flight cannot carry the arm or so many terms, or the space was not verified for such
    effects."""
    limits = library("flight").lib
    _refuse_points(hypotheses)
    _refuse_moves(hypotheses)
    if arm.n > limits.KC_JOINT_MAX:
        raise BadInput(
            f"{arm.name} has {arm.n} joints; flight carries {limits.KC_JOINT_MAX}",
            todo="a model of this arm stays on the ground: `kincal model export` makes it usable elsewhere",
        )
    if flown.space.n_joints != arm.n:
        raise BadInput(
            f"{arm.name} has {arm.n} joints, the search space is for {flown.space.n_joints}",
            todo="name the folder of the tables that fly with --tables",
        )
    over, over_terms, n_coef, n_terms = _too_many(arm, hypotheses, model)
    if over > 0 or over_terms > 0:
        own, _ = capacity.size(hypotheses)
        raise BadInput(
            f"the model needs {n_coef} coefficients ({n_coef - own} of DH errors, {own} of effects) "
            f"and {n_terms} terms; flight carries {limits.KC_COEF_MAX} and {limits.KC_TERM_MAX}",
            todo=_leave_out(arm, hypotheses, flown, model),
        )
    table, cramped = _bounded(arm, hypotheses, flown, model)
    if cramped:
        raise _no_room(table, flown, cramped[0], _to_drop(arm, hypotheses, flown, model, []))
    return table


def _too_many(
    arm: ArmTable, hypotheses: Sequence[Hypothesis], model: ModelFile | None
) -> tuple[int, int, int, int]:
    """Coefficients and terms beyond what flight carries (negative: still free), and how many there are."""
    limits, rows = library("flight").lib, coefficients(arm, hypotheses, model)
    n_terms = sum(len(row.terms) for row in rows)
    return len(rows) - limits.KC_COEF_MAX, n_terms - limits.KC_TERM_MAX, len(rows), n_terms


@dataclass(frozen=True)
class _Cramped:
    """A coefficient of an effect that the search space leaves too little room: its number, its name in the
    model, and the value that it would have to take."""

    coef: int
    name: str
    effect: str
    value: float


def _bounded(
    arm: ArmTable, hypotheses: Sequence[Hypothesis], flown: Flown, model: ModelFile | None
) -> tuple[KcTerms, list[_Cramped]]:
    """The table with bounds inside what the search space was verified for, and what has no room there."""
    table = fill_terms(library("flight"), coefficients(arm, hypotheses, model))
    table.kinematics_crc = Arm.of(arm).kinematics_crc
    owners = [h.name for h in hypotheses for _ in h.parameters]
    names = [f"{h.name}.{p.name}" for h in hypotheses for p in h.parameters]
    cramped: list[_Cramped] = []
    first = table.n_coef - len(names)
    wanted = {c: table.coef[c].ub for c in range(first, table.n_coef)}
    for c, bound in enumerate(shared_bounds(flown, table, wanted)):
        row = table.coef[c]
        row.lb, row.ub, row.enabled = -bound, bound, int(bound > 0.0)
        if c < first:
            continue
        value = abs(model.values[names[c - first]][0]) if model and names[c - first] in model.values else 0.0
        if bound <= 0.0 or bound < _LEAST * value:
            cramped.append(_Cramped(c, names[c - first], owners[c - first], value or wanted[c]))
    return table, cramped


def _to_drop(
    arm: ArmTable,
    hypotheses: Sequence[Hypothesis],
    flown: Flown,
    model: ModelFile | None,
    order: Sequence[capacity.Removal],
) -> list[str]:
    """Effects to leave out so that flight carries the others and the search space has room for them; order:
    of removal, for what is too many. What is left out for its size alone comes back where others have made
    room."""

    def without(names: Sequence[str]) -> list[Hypothesis]:
        return [h for h in hypotheses if h.name not in names]

    def too_many(names: Sequence[str]) -> bool:
        return max(_too_many(arm, without(names), model)[:2]) > 0

    go: list[str] = []
    for removal in order:
        if too_many(go):
            go.append(removal.name)
    for_size = tuple(go)
    while cramped := _bounded(arm, without(go), flown, model)[1]:
        go.append(cramped[0].effect)
    for name in reversed(for_size):
        less = [other for other in go if other != name]
        if not too_many(less) and not _bounded(arm, without(less), flown, model)[1]:
            go = less
    return go


def _drops(names: Sequence[str]) -> str:
    return " ".join(f"--drop {shlex.quote(name)}" for name in names)


def _no_room(table: KcTerms, flown: Flown, cramped: _Cramped, drop: Sequence[str]) -> BadInput:
    place, does, allowed = tightest(flown, table, cramped.coef, cramped.value)
    return BadInput(
        f"{cramped.name} of {cramped.value:.3g} can cause up to {does:.3g} {place_text(place)}; the bounds "
        f"of all that acts there may add up to {allowed:.3g}, a tenth more than the search space was "
        "verified for",
        todo="verify a search space for larger `error_bounds` (docs/SPACES.md), or leave out what does not "
        f"fit in this one: {_drops(drop)}",
    )


def _leave_out(arm: ArmTable, hypotheses: Sequence[Hypothesis], flown: Flown, model: ModelFile | None) -> str:
    """Which effects to leave out, so that flight takes the others, and what that costs the fit."""
    order = capacity.order_of_removal(hypotheses, model) if model else []
    if not order:
        taken: dict[str, int] = {}
        for h in hypotheses:
            taken[h.effect] = taken.get(h.effect, 0) + len(h.parameters)
        by_size = sorted(taken.items(), key=lambda item: -item[1])
        sizes = ", ".join(f"{name} {count}" for name, count in by_size)
        return f"`kincal model fit` first, then this says what to leave out; coefficients by effect: {sizes}"
    go = _to_drop(arm, hypotheses, flown, model, order)
    lines = [
        "leave out the effects that the poses of the last fit show least, and those that do not fit in the",
        "  search space. In order of removal, with the increase of chi^2 (about 1 for each insignificant",
        "  coefficient):",
        f"    {'effect':<32} coefficients  terms  chi^2 lost  for each coefficient",
        *(
            f"    {x.name:<32} {x.coefficients:>12} {x.terms:>6} {x.chi2:>11.1f} {x.each:>21.1f}"
            + ("  leave out" if x.name in go else "")
            for x in order
        ),
        f"  add to the command: {_drops(go)}",
        "  and --data to see what it costs on held-out poses; the model file keeps all effects",
    ]
    return "\n".join(lines)


def dropped(hypotheses: Sequence[Hypothesis], names: Sequence[str]) -> list[Hypothesis]:
    """The effects that these names leave out, each at all joints or at some. BadInput for a name that none
    of them has."""
    for name in names:
        if not any(covers(name, h.name) for h in hypotheses):
            there = ", ".join(h.name for h in hypotheses) or "no effect"
            raise BadInput(f"{name} is not in the model; it holds {there}")
    return [h for h in hypotheses if any(covers(name, h.name) for name in names)]


def refuse_other_arm(arm: ArmTable, tables_dir: Path) -> str:
    """Which arm table of flight's tables the arm was compared with, in words. BadInput if it is of another
    arm: other nominal joints."""
    path = tables_dir / "arm.tbl"
    if not path.exists():
        return f"{tables_dir} holds no arm.tbl: whether flight has this arm was not checked"
    flown = Arm.of_table(tables.decode_as("arm", path.read_bytes(), str(path))[1])
    if flown.kinematics_crc != Arm.of(arm).kinematics_crc:
        name = library("ground").text(flown.struct.name)
        raise BadInput(
            f"the model is for {arm.name} ({arm.n} joints), the arm table of these flight tables is for "
            f"{name} ({flown.n} joints) with other DH parameters",
            str(path),
            "name the tables of this arm with --tables, or the model of that arm",
        )
    return f"the arm is that of {path}"


def _refuse_points(hypotheses: Sequence[Hypothesis]) -> None:
    """BadInput for effects of a camera and a target of many points: flight sees single tags, with a camera of
    its own."""
    names = [
        h.name
        for h in hypotheses
        if any(basis.var in PNP for p in h.parameters for term in p.terms for basis in term.basis)
    ]
    if names:
        raise BadInput(
            f"{', '.join(names)} {'acts' if len(names) == 1 else 'act'} through all points of the target "
            "that these data were measured with: that belongs to their camera; flight has a camera of its "
            "own and sees single tags",
            todo=f"leave them out with {_drops(names)}: the effects of the arm stay. If flight has this very "
            "camera and these tags, diagnose again without `[target]` in the arm table: most of these "
            "effects then have terms that fly",
        )


def _refuse_moves(hypotheses: Sequence[Hypothesis]) -> None:
    """BadInput for effects of the last move: flight observes an arm at rest."""
    if names := [h.name for h in hypotheses if h.follows("move")]:
        follow = "follows" if len(names) == 1 else "follow"
        raise BadInput(
            f"{', '.join(names)} {follow} the last move, and flight waits until the arm is at rest",
            todo=f"leave out what these measurements had because they did not wait: {_drops(names)}",
        )


def term_image(
    arm: ArmTable, hypotheses: Sequence[Hypothesis], flown: Flown, model: ModelFile | None = None
) -> tables.Image:
    """The encoded image. BadInput as `term_table`, or if flight's own checks for this arm refuse it."""
    flight = library("flight")
    struct = term_table(arm, hypotheses, flown, model)
    index, got = flight.ffi.new("int32_t *"), flight.ffi.new("double *")
    status = flight.lib.kc_terms_validate(struct, arm.n, index, got)
    if status != 0:
        raise BadInput(
            f"flight would refuse the term table: {status_name(status)}, entry {index[0]}, value {got[0]:g}"
        )
    if excess := flown.excess(struct):
        raise BadInput(f"flight would refuse the term table: {excess.text}")
    return tables.encode("terms", struct)


def flight_tables(source: Path, out: Path, terms: tables.Image) -> list[Path]:
    """A directory of table images to fly with: those of `source`, these terms, and no correction yet (the
    one in force belongs to the old terms). Returns its files. BadInput if there is nothing to copy, or if
    images of others would be replaced."""
    if source.resolve() == out.resolve():
        raise BadInput(f"{out} holds the tables to copy; name another directory")
    images = sorted(source.glob("*.tbl"))
    if not images:
        raise BadInput(f"{source}: holds no table image (*.tbl)")
    kin = library("flight").new("kc_kin_t")
    kin.n_coef = tables.decode_as("terms", terms.data)[1].n_coef
    new = {"terms.tbl": terms.data, "kin.tbl": tables.encode("kin", kin).data}
    claim(out, "model uplink --fly", [image.name for image in images])
    return write_files({out / image.name: new.get(image.name) or image.read_bytes() for image in images})
