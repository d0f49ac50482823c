"""The effect library: physical effects as named bundles of correction terms, made concrete for an arm."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal.rotations import matrix_of_wxyz
from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.effects import EffectEntry, ParameterEntry, read_effects
from kincal_shared.schema.errors import utf8_text
from kincal_shared.schema.model import UnnamedEntry
from kincal_shared.schema.names import COMPONENTS, FAULTS_ON_TOOL, PNP, effect_of, is_unnamed, place_of
from kincal_shared.schema.terms import ONE, Basis, Names, TermEntry, parse_gain

from ..data.measurements import Measurements
from ..numerics.types import Array
from .grids import Grid, data_constants, grid_values
from .levers import TOOL, bodies
from .pnp import column_number
from .sight import SIGHT_CONSTANTS, assumptions, sees_points

_FRAMES = {"tool": FRAME_TOOL, "camera": FRAME_CAMERA, "meas": FRAME_MEAS}
# How a need is said to people: the keys of the arm table or the columns of the data.
_NEED_TEXT = {
    "mass": "mass_kg, com_m (arm table)",
    "gear_ratio": "gear_ratio (arm table)",
    "mass_unknown": "an arm table without masses",
    "gear_unknown": "a joint without gear_ratio (arm table)",
    "own_sensor": "data without camera columns",
    "dir": "dir1..",
    "move": "rows in the order of measurement",
    "cam": "cx..cqz",
    "image": "cx..cqz",
    "rotation": "qw..qz",
    "points": 'qw..qz, and [sensor] mount = "tool", or cx..cqz with [target] points_m',
}


@dataclass(frozen=True)
class Term:
    """coefficient x gain x basis x basis, added to twist component `comp` (0..5: tx ty tz rx ry rz) at
    `frame` (0 base .. n last link, then FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS of kincal.flight)."""

    frame: int
    comp: int
    gain: float
    basis: tuple[Basis, Basis]


@dataclass(frozen=True)
class Parameter:
    """A coefficient: its unit, its typical size (prior sigma, in that unit) and the terms it scales.

    shrunk: the size was chosen by the data, and fits keep to it; else they leave it many times as wide;
    if_negative: what a negative value means, where nature has positive ones only, and what to check then.
    """

    name: str
    unit: str
    sigma: float
    terms: tuple[Term, ...]
    shrunk: bool = False
    if_negative: str = ""


@dataclass(frozen=True)
class Hypothesis:
    """One testable instance: an effect at one joint (or pair) with its constants chosen."""

    effect: str
    name: str
    parameters: tuple[Parameter, ...]
    constants: tuple[tuple[str, float], ...] = ()

    @property
    def label(self) -> str:
        """Name with the searched constants, e.g. bias_step[3] (t0 = 120)."""
        if not self.constants:
            return self.name
        return f"{self.name} ({', '.join(f'{k} = {v:.4g}' for k, v in self.constants)})"

    @property
    def even(self) -> bool:
        """It acts with the same size at every pose, so that it makes none look like an outlier: shifts and
        turns of constant length whose direction follows an angle."""
        return all(_is_even(p) for p in self.parameters)

    @property
    def of_last_move(self) -> bool:
        """It depends on how far joints came, not on where they are."""
        return any(basis.var == "move" for p in self.parameters for term in p.terms for basis in term.basis)

    @property
    def alike_in_joints(self) -> bool:
        """Each coefficient moves several joints: a cause that is outside of them."""
        return all(len(p.terms) > 1 for p in self.parameters)

    @property
    def of_session(self) -> bool:
        """It depends on time, and holds for the session that was measured: what drifts or settles starts anew
        in the next one."""
        return self.follows("t")

    def follows(self, variable: str) -> bool:
        """Whether a term depends on a variable of the grammar, of any joint."""
        return any(b.var == variable for p in self.parameters for term in p.terms for b in term.basis)


def _is_even(parameter: Parameter) -> bool:
    """What a coefficient does at a frame: a vector that turns, cosine along one axis, sine along another."""
    vectors: dict[tuple[int, bool], list[Term]] = {}
    for term in parameter.terms:
        vectors.setdefault((term.frame, term.comp < 3), []).append(term)
    return all(_turns(terms) for terms in vectors.values())


def _turns(terms: Sequence[Term]) -> bool:
    bases = {replace(t.basis[0], fn="") for t in terms}
    functions = sorted(t.basis[0].fn for t in terms)
    lengths, axes = {abs(t.gain) for t in terms}, {t.comp for t in terms}
    alone = all(t.basis[1] == ONE for t in terms)
    return functions == ["cos", "sin"] and len(bases) == len(lengths) == 1 and len(axes) == 2 and alone


@dataclass(frozen=True)
class Effect:
    """One entry of the library as written; `instances` makes it concrete for an arm and data.

    per: "arm", "joint" or "pair"; needs: what arm table or data must hold; grid: constants that are
    searched; joint_type: of the joints that can have it, "" for both; equivalent_to: an effect with the very
    same formula, with which it does not compete; beside: an effect that has to be in the model before;
    shrunk: as of `Parameter`.
    """

    name: str
    title: str
    formula: str
    per: str
    needs: tuple[str, ...]
    looks_like: str
    inspect: str
    confounded_with: tuple[str, ...]
    parameters: tuple[ParameterEntry, ...]
    joints: tuple[int, ...] | None = None
    joint_type: str = ""
    pairs: tuple[tuple[int, int], ...] | None = None
    grid: Mapping[str, Grid] = field(default_factory=dict)
    equivalent_to: str = ""
    beside: str = ""
    source: str = ""
    shrunk: bool = False

    @property
    def _of_points(self) -> tuple[ParameterEntry, ...]:
        """The coefficients that act on the image of a target's points."""
        return tuple(p for p in self.parameters if p.image is not None)

    def sees_points(self, arm: ArmTable, data: Measurements | None) -> bool:
        """Whether the effect acts through a target of many points here."""
        fixed_target = arm.mount == "tool"
        here = any(not (fixed_target and p.image in FAULTS_ON_TOOL) for p in self._of_points)
        return here and sees_points(arm, data)

    def missing(self, arm: ArmTable, data: Measurements | None) -> list[str]:
        """What this effect needs and the arm table or the data do not have, in words."""
        if self.sees_points(arm, data):
            return []
        only_points = len(self._of_points) == len(self.parameters)
        needs = (
            (*self.needs, "points") if only_points or arm.mount == "tool" and self._of_points else self.needs
        )
        lacking = [need for need in needs if not _there(need, arm, data)]
        return list(dict.fromkeys(_NEED_TEXT.get(need, need) for need in lacking))

    def where(self, arm: ArmTable) -> list[dict[str, int]]:
        """The joint letters of each instance: {} for the arm, {j} per joint, {i, j} per pair."""
        joints = self.joints or tuple(range(1, arm.n + 1))
        if self.per == "arm":
            return [{}]
        if self.per == "joint":
            return [{"j": j} for j in joints if j <= arm.n and self._is_at(arm, j)]
        pairs = self.pairs or tuple(itertools.permutations(joints, 2))
        return [{"i": i, "j": j} for i, j in pairs if max(i, j) <= arm.n]

    def _is_at(self, arm: ArmTable, j: int) -> bool:
        """Whether joint j is of the type, and has (or lacks) the gear ratio, that the effect needs."""
        joint = arm.joints[j - 1]
        of_type = not self.joint_type or joint.prismatic == (self.joint_type == "prismatic")
        return of_type and ("gear_unknown" if joint.gear_ratio else "gear_ratio") not in self.needs

    def instances(
        self, arm: ArmTable, data: Measurements | None, known: Mapping[str, float] | None = None
    ) -> list[Hypothesis]:
        """Every joint (or pair) times every grid value. Constants named in the grid come from the data,
        or are known from an earlier fit."""
        known = known or {}
        if self.sees_points(arm, data):
            return self._through_points(arm, known)
        fixed = {**data_constants(data), **known}
        grids = {
            name: [known[name]] if name in known else grid_values(values, data)
            for name, values in self.grid.items()
        }
        made = [
            Hypothesis(
                self.name,
                instance_name(self.name, letters),
                self._parameters(arm, letters, {**fixed, **dict(constants)}),
                constants,
            )
            for letters in self.where(arm)
            for constants in (tuple(zip(grids, c, strict=True)) for c in itertools.product(*grids.values()))
        ]
        return [h for h in made if h.parameters]

    def _through_points(self, arm: ArmTable, known: Mapping[str, float]) -> list[Hypothesis]:
        """One instance for each assumption about camera and target that known constants leave open."""
        return [
            Hypothesis(
                self.name,
                self.name,
                tuple(
                    Parameter(p.name, p.unit, p.sigma, _pnp_terms(k, p.image or "")) for p in self._of_points
                ),
                assumed.constants,
            )
            for k, assumed in enumerate(assumptions(arm))
            if assumed.meant_by(tuple(known.items()))
        ]

    def _parameters(
        self, arm: ArmTable, letters: Mapping[str, int], constants: Mapping[str, float]
    ) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(
                name,
                p.unit,
                p.sigma,
                tuple(self._terms(p, arm, with_body, constants)),
                self.shrunk,
                p.if_negative,
            )
            for p in self.parameters
            if p.image is None
            for name, with_body in _bodies(p, arm, letters)
        )

    def _terms(
        self,
        parameter: ParameterEntry,
        arm: ArmTable,
        letters: Mapping[str, int],
        constants: Mapping[str, float],
    ) -> Iterator[Term]:
        """Terms of a parameter, once for each joint if it says so; those without effect left out."""
        where = f"{self.source}: effect {self.name}"
        joints = range(1, arm.n + 1) if parameter.each_joint else ()
        for names in [{**letters, "j": j} for j in joints] or [dict(letters)]:
            terms = (_concrete_term(entry, arm, names, constants, where) for entry in parameter.term)
            yield from (term for term in terms if term.gain != 0.0)


def _pnp_terms(sight: int, fault: str) -> tuple[Term, ...]:
    """The twist by which a fault moved the measured pose, taken back there."""
    number = column_number(sight, fault)
    return tuple(
        Term(FRAME_MEAS, comp, -1.0, (Basis("lin", name, number), ONE)) for comp, name in enumerate(PNP)
    )


def _bodies(
    parameter: ParameterEntry, arm: ArmTable, letters: Mapping[str, int]
) -> Iterator[tuple[str, Mapping[str, int]]]:
    """Name and letters of a coefficient, for each body beyond joint j if it says so."""
    if not parameter.each_body:
        yield parameter.name, letters
        return
    link = {"p": letters.get("j", 1) - 1, **letters}.get(parameter.lever_link)
    for body in bodies(arm, int(parameter.lever_link) if link is None else link, parameter.levers):
        name = f"{parameter.name}_tool" if body == TOOL else f"{parameter.name}{body}"
        yield name, {**letters, "k": body}


def _there(need: str, arm: ArmTable, data: Measurements | None) -> bool:
    """Whether the arm table or the data have what an effect needs; unknown data may have everything but
    a sensor of their own."""
    of_arm = {
        "mass": arm.has_masses,
        "mass_unknown": not arm.has_masses,
        "gear_ratio": any(joint.gear_ratio for joint in arm.joints),
        "gear_unknown": not all(joint.gear_ratio for joint in arm.joints),
    }
    if need in of_arm:
        return of_arm[need]
    if need == "points":
        return sees_points(arm, data)
    if need == "own_sensor":
        return data is not None and data.has(need)
    return data is None or data.has("cam" if need == "image" else need)


def instance_name(effect: str, letters: Mapping[str, int]) -> str:
    """joint_coupling[1,2] of its letters; the bare name for the whole arm."""
    if not letters:
        return effect
    return f"{effect}[{','.join(str(letters[k]) for k in sorted(letters))}]"


def _link_vector(arm: ArmTable, j: int) -> Array:
    """Origin of frame j-1 to origin of frame j, in frame j."""
    joint = arm.joints[j - 1]
    return np.array([joint.a_m, joint.d_m * math.sin(joint.alpha_rad), joint.d_m * math.cos(joint.alpha_rad)])


def _mount_lever(arm: ArmTable) -> Array:
    """From the origin of the base frame, where the arm is bolted on, to frame 0, in frame 0 [m]; a mount that
    tips turns about that origin. Zero when the base frame is unknown."""
    if arm.base.estimate:
        return np.zeros(3)
    lever: Array = matrix_of_wxyz(arm.base.quat_wxyz).T @ arm.base.xyz_m
    return lever


def _gain(
    value: float | str, arm: ArmTable, names: Mapping[str, int], constants: Mapping[str, float], where: str
) -> float:
    """A gain with constants and the properties of link j and of the base filled in."""
    if not isinstance(value, str):
        return float(value)
    symbols = dict(zip(("Bx", "By", "Bz"), _mount_lever(arm), strict=True))
    symbols |= {f"${name}": constant for name, constant in constants.items()}
    if "j" in names:
        length = _link_vector(arm, names["j"])
        joint = arm.joints[names["j"] - 1]
        symbols |= dict(zip(("Lx", "Ly", "Lz"), length, strict=True)) | {"a": joint.a_m, "d": joint.d_m}
        symbols["long"] = float(np.linalg.norm(length) > 1e-6)
    gain, used = parse_gain(value)
    for symbol in used:
        if symbol not in symbols:
            raise BadInput(f"gain {value!r} uses {symbol} of a link, but no joint j is meant here", where)
        gain *= symbols[symbol]
    return float(gain)


def _concrete_term(
    entry: TermEntry, arm: ArmTable, names: Mapping[str, int], constants: Mapping[str, float], where: str
) -> Term:
    """A term of the file on this arm, joint letters and constants filled in."""
    values = _values(arm, names, constants)
    place, comp = entry.place, entry.comp
    frame = place.frame(values)
    if place.joint and not 1 <= place.index(values) <= arm.n:
        raise BadInput(f"at = {entry.at!r} names no joint of this arm", where, f"joints are 1 to {arm.n}")
    if place.kind == "joint":
        comp = "tz" if arm.joints[place.index(values) - 1].prismatic else "rz"
    assert comp is not None  # the file's reader refuses a term without
    basis = entry.bases(values, where)
    for factor in basis:
        if factor.highest_link > arm.n:
            what = f"basis {entry.basis!r} names joint {factor.highest_link}, the arm has {arm.n}"
            raise BadInput(what, where)
    number = frame if isinstance(frame, int) else _FRAMES[frame]
    return Term(number, COMPONENTS.index(comp), _gain(entry.gain, arm, names, constants, where), basis)


def _values(arm: ArmTable, names: Mapping[str, int], constants: Mapping[str, float]) -> Names:
    """Names that bases may use: constants, joint letters, the link before j (p), the gear ratio of j (N)."""
    values: dict[str, float] = {**constants, **names}
    if "j" in names:
        values["p"] = names["j"] - 1
        if gear_ratio := arm.joints[names["j"] - 1].gear_ratio:
            values["N"] = gear_ratio
    return values


class Library:
    """Effects by name, the built-in ones and a user's own; `unnamed`: those of a model file that have no
    name. These never compete."""

    def __init__(self, effects: list[Effect], unnamed: Sequence[Effect] = ()):
        self.effects = {effect.name: effect for effect in effects}
        self.unnamed = {effect.name: effect for effect in unnamed}

    @classmethod
    def load(cls, *user_files: str | Path) -> Library:
        """The built-in effects and those of a user's files, each once: a model file names its own, and a
        command may name them again. BadInput names file, effect and key."""
        effects = [*_built_in()]
        for path in {Path(path).resolve(): path for path in user_files}.values():
            mine = _effects(_read(path), str(path))
            taken = {effect.name for effect in effects}
            for name in (effect.name for effect in mine if effect.name in taken):
                raise BadInput(f"effect {name!r} is already in the library", str(path), "choose another name")
            effects += mine
        return cls(effects)

    def without(self, *names: str) -> Library:
        """The library without some effects."""
        left = [effect for effect in self.effects.values() if effect.name not in names]
        return Library(left, list(self.unnamed.values()))

    def with_unnamed(self, entries: Iterable[UnnamedEntry]) -> Library:
        """The library with the unnamed effects of a model file."""
        unnamed = [_unnamed_effect(entry) for entry in entries]
        return Library(list(self.effects.values()), [*self.unnamed.values(), *unnamed])

    def effect(self, name: str) -> Effect | None:
        """The effect of `name[joint]`, of a bare name or of an unnamed effect; None if there is none."""
        return self.unnamed.get(name) or self.effects.get(effect_of(name))

    def is_open(
        self, name: str, arm: ArmTable, data: Measurements | None, known: Mapping[str, float] | None = None
    ) -> bool:
        """Whether an effect has constants that the data still have to choose: those of its grid, or what is
        assumed of camera and target."""
        effect = self.effect(name)
        if effect is None:
            return False
        if effect.sees_points(arm, data):
            return len(effect.instances(arm, data, known)) > 1
        return bool(self.grid_of(name, known))

    def grid_of(self, name: str, known: Mapping[str, float] | None = None) -> dict[str, Grid]:
        """Grids of the constants of an effect that have to be searched, those that are known left out."""
        effect = self.effect(name)
        return {} if effect is None else {k: v for k, v in effect.grid.items() if k not in (known or {})}

    def check_constants(self, name: str, constants: Iterable[str]) -> None:
        """BadInput for a constant that an effect does not have."""
        effect = self.effect(name)
        if effect is None:
            return
        known = (*effect.grid, *(SIGHT_CONSTANTS if effect._of_points else ()))
        for constant in constants:
            if constant not in known:
                has = f"it has {', '.join(known)}" if known else "it has none"
                raise BadInput(f"{name} has no constant {constant!r}; {has}")

    def find(
        self,
        name: str,
        arm: ArmTable,
        data: Measurements | None,
        known: Mapping[str, float] | None = None,
    ) -> list[Hypothesis]:
        """Instances for `name[joint]`, each joint of `name[2,3]`, or all joints for a bare name. BadInput
        with near names."""
        if is_unnamed(name):
            return self._unnamed(name).instances(arm, data, known)
        base = effect_of(name)
        if base not in self.effects:
            near = [n for n in self.effects if n.startswith(base[:4])] or list(self.effects)
            raise BadInput(f"no effect {base!r}; did you mean {', '.join(near[:6])}? (kincal model effects)")
        found = self.effects[base].instances(arm, data, known)
        if "[" in name:
            wanted = _places(name.replace(" ", ""), self.effects[base])
            found = [h for h in found if h.name in wanted]
            if len({h.name for h in found}) < len(wanted):
                at = {"gear_ratio": " with gear_ratio", "gear_unknown": " without gear_ratio"}
                which = "".join(text for need, text in at.items() if need in self.effects[base].needs)
                raise BadInput(f"effect {name!r}: no such joint{which} on {arm.name} ({arm.n} joints)")
        return found

    def check_joints(self, name: str, arm: ArmTable) -> None:
        """BadInput if a name of an effect is at a joint that the arm does not have."""
        inside = "" if is_unnamed(name) else name.partition("[")[2].rstrip("]")
        beyond = [x.strip() for x in inside.split(",") if x.strip().isdecimal() and int(x) > arm.n]
        if beyond:
            raise BadInput(
                f"effect {name!r}: {arm.name} has {arm.n} joints, there is no joint {', '.join(beyond)}",
                todo=f"name joints from 1 to {arm.n}",
            )

    def check_once(self, names: Iterable[str]) -> None:
        """BadInput if an effect is twice at a joint: backlash[1,5] and backlash[5,6], or backlash[2,2]."""
        named: dict[str, str] = {}
        for name in names:
            effect = self.effects.get(effect_of(name))
            if effect is None or effect.per != "joint" or not place_of(name):
                continue
            for place in place_of(name)[1:-1].split(","):
                at = f"{effect.name}[{place.strip()}]"
                if at in named:
                    by = f"by {named[at]}" if named[at] != name else "by itself"
                    raise BadInput(
                        f"{name} would be twice at one joint: {at} is named {by}", todo="name each joint once"
                    )
                named[at] = name

    def _unnamed(self, name: str) -> Effect:
        if name not in self.unnamed:
            todo = f'`kincal model add --model M.toml "{name}" --arm A.toml --data D.csv` makes them'
            raise BadInput(f"{name} has no terms yet", todo=todo)
        return self.unnamed[name]


def _places(name: str, effect: Effect) -> set[str]:
    """Names of the instances that a name stands for: a joint effect may name several joints."""
    inside = name.partition("[")[2].rstrip("]")
    if effect.per != "joint":
        return {name}
    return {f"{effect.name}[{joint}]" for joint in inside.split(",")}


def _read(path: str | Path) -> str:
    try:
        return utf8_text(Path(path))
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None


@cache
def _built_in() -> tuple[Effect, ...]:
    text = resources.files(__package__).joinpath("effects.toml").read_text(encoding="utf-8")
    return tuple(_effects(text, "effects.toml"))


def _effects(text: str, source: str) -> list[Effect]:
    return [_effect(entry, source) for entry in read_effects(text, source)]


def _effect(entry: EffectEntry, source: str) -> Effect:
    return Effect(
        name=entry.name,
        title=entry.title or entry.name,
        formula=entry.formula,
        per=entry.per,
        needs=entry.all_needs(),
        looks_like=entry.looks_like,
        inspect=entry.inspect,
        confounded_with=tuple(entry.confounded_with),
        parameters=tuple(entry.parameter),
        joints=tuple(entry.joints) if entry.joints is not None else None,
        joint_type=entry.joint_type or "",
        pairs=tuple(entry.pairs) if entry.pairs is not None else None,
        grid=dict(entry.grid),
        equivalent_to=entry.equivalent_to,
        beside=entry.beside,
        source=source,
    )


def _unnamed_effect(entry: UnnamedEntry) -> Effect:
    needs = dict.fromkeys(need for p in entry.parameter for term in p.term for need in term.needs())
    return Effect(
        name=entry.name,
        title="a smooth function found in the data",
        formula="sum of its terms",
        per="arm",
        needs=tuple(needs),
        looks_like="",
        inspect="",
        confounded_with=(),
        parameters=tuple(entry.parameter),
        source=entry.name,
        shrunk=True,
    )
