"""The effect library (TOML, docs/EFFECTS.md): physical effects as named bundles of correction terms."""

from __future__ import annotations

from typing import Annotated, Literal

import pydantic

from kincal_shared.letters import unseen

from .base import Strict
from .datamap import RECORDED
from .errors import Contradiction, Problem, SchemaError, parse_toml, validate
from .names import DATA_CONSTANTS, FAULTS, VARIABLES
from .numbers import Count, Positive, Real
from .terms import Factor, TermEntry

JointNumber = Annotated[int, Count(ge=1, le=16)]
# What `needs` may name beside data columns: keys of the arm table, there or absent, and groups of columns.
NEEDS = (
    "mass", "gear_ratio", "mass_unknown", "gear_unknown", "own_sensor", "dir", "cam", "image", "rotation",
    "move", "qdot", "points", *RECORDED,
)  # fmt: skip


class ParameterEntry(Strict):
    """One coefficient of an effect, with the terms that carry it."""

    name: str = pydantic.Field(min_length=1, examples=["k"])
    """Name of the coefficient inside the effect."""
    unit: str = "1"
    """Unit of the coefficient."""
    sigma: Positive = pydantic.Field(examples=[1e-3])
    """Typical size, the 1-sigma of the prior [unit]."""
    each_joint: pydantic.StrictBool = False
    """true: the terms are repeated for every joint of the arm, all with this one coefficient."""
    each_body: pydantic.StrictBool = False
    """true: one coefficient for each body k beyond joint j whose gravity levers are its own: NAME3 for the
    end of link 3, NAME_tool for the tool."""
    if_negative: str = ""
    """What a negative value means and what to check then, where nature has positive ones only; empty where
    both signs can be."""
    image: Literal[FAULTS] | None = None  # type: ignore[valid-type]
    """What a unit of the coefficient does to the image of the target's points, in place of terms. Where poses
    come from a camera and a target of many points, an effect has its coefficients with `image` only; else
    those with terms."""
    term: list[TermEntry] = pydantic.Field(default=[], examples=["at least one [[effect.parameter.term]]"])
    """Terms of the coefficient."""

    @pydantic.field_validator("name")
    @classmethod
    def _is_seen(cls, name: str) -> str:
        if code := unseen(name):
            raise ValueError(f"holds {code}, which is not shown; write letters that are")
        return name

    @pydantic.model_validator(mode="after")
    def _does_something(self) -> ParameterEntry:
        if self.image is None and not self.term:
            raise Contradiction("term", "is missing", "write at least one [[effect.parameter.term]]")
        if self.image is not None and self.term:
            raise Contradiction("image", "stands beside terms", "write one of the two")
        return self

    @pydantic.model_validator(mode="after")
    def _has_levers(self) -> ParameterEntry:
        levers = self._of_bodies()
        if self.each_body != bool(levers):
            what = "is true, but no term has a lever of body k" if self.each_body else "is needed for body k"
            raise Contradiction("each_body", what, 'write basis = "levz[p,k]" and each_body = true')
        return self

    @property
    def levers(self) -> tuple[str, ...]:
        """Gravity levers of body k that the terms use, in the order of the grammar."""
        return tuple(name for name in VARIABLES if name in {f.var for f in self._of_bodies()})

    @property
    def lever_link(self) -> str:
        """Link that those levers are about: a number or a letter."""
        return next(f.joint for f in self._of_bodies()).partition(",")[0]

    def _of_bodies(self) -> list[Factor]:
        return [f for t in self.term for f in t.factors if "k" in f.letters()]


class EffectEntry(Strict):
    """One physical effect."""

    name: str = pydantic.Field(examples=["my_effect"])
    """Name: letters, digits and _."""
    title: str = ""
    """What it is, in a few words."""
    formula: str = ""
    """Formula for people."""
    per: Literal["arm", "joint", "pair"] = "arm"
    """One instance for the arm, one for each joint j, or one for each ordered pair of joints i, j."""
    joints: list[JointNumber] | None = None
    """Joints that can have it; all if absent."""
    joint_type: Literal["revolute", "prismatic"] | None = None
    """Type of the joints that can have it; both if absent."""
    pairs: list[tuple[JointNumber, JointNumber]] | None = None
    """Pairs (i, j) that can have it; all if absent."""
    needs: list[str] = []
    """What the data or the arm table must hold, beside what the terms say by themselves."""
    looks_like: str = ""
    """How it shows in the residuals."""
    inspect: str = ""
    """What to look at on the arm."""
    confounded_with: list[str] = []
    """Effects that data can hardly tell from it."""
    equivalent_to: str = ""
    """Effect with exactly the same terms: it never competes with that one and is always listed with it."""
    beside: str = ""
    """Effect that has to be in the model, at the same joint, before this one competes: a second one."""
    grid: dict[str, list[Real] | Literal["times", "durations", "periods"]] = {}
    """Constants that are searched, $name in a basis or gain: a list of values, or "times", "durations"
    (fractions of the time span of the data), "periods" (per turn)."""
    parameter: list[ParameterEntry] = pydantic.Field(
        min_length=1, examples=["at least one [[effect.parameter]]"]
    )
    """Coefficients of the effect."""

    @pydantic.field_validator("name")
    @classmethod
    def _is_a_name(cls, name: str) -> str:
        if not name.isidentifier() or unseen(name):
            raise ValueError(f"is {name!r}; letters, digits and _ are needed")
        return name

    @pydantic.field_validator("needs")
    @classmethod
    def _are_known(cls, needs: list[str]) -> list[str]:
        for need in needs:
            if need not in NEEDS:
                raise ValueError(
                    f"{need!r} is nothing that data or arm tables hold; possible: {', '.join(NEEDS)}"
                )
        return needs

    @pydantic.model_validator(mode="after")
    def _fits_its_kind(self) -> EffectEntry:
        if self.pairs is not None and self.per != "pair":
            raise Contradiction("pairs", f'stands in an effect with per = "{self.per}"', 'write per = "pair"')
        if self.joints is not None and self.per == "arm":
            raise Contradiction("joints", 'stands in an effect with per = "arm"', 'write per = "joint"')
        if self.joint_type is not None and self.per != "joint":
            what = f'stands in an effect with per = "{self.per}"'
            raise Contradiction("joint_type", what, 'write per = "joint"')
        return self

    @pydantic.model_validator(mode="after")
    def _letters_and_constants_have_values(self) -> EffectEntry:
        for p, parameter in enumerate(self.parameter, 1):
            for t, term in enumerate(parameter.term, 1):
                self._has_values(term, parameter, f"parameter[{p}].term[{t}]")
        return self

    def _has_values(self, term: TermEntry, parameter: ParameterEntry, where: str) -> None:
        known = {"j", "p"} if parameter.each_joint else set()
        known |= {"k"} if parameter.each_body else set()
        known |= {"arm": set(), "joint": {"j", "p"}, "pair": {"i", "j", "p"}}[self.per]
        for key, letter in _letters(term):
            if letter not in known:
                what = f'names joint {letter}, which per = "{self.per}" does not have'
                raise Contradiction(f"{where}.{key}", what)
        for name in term.constants:
            if name not in (*DATA_CONSTANTS, *self.grid):
                todo = f"add it to [effect.grid]: {name} = [...]"
                key = "basis" if f"${name}" in term.basis else "gain"
                raise Contradiction(f"{where}.{key}", f"uses ${name}, which has no value", todo)

    def all_needs(self) -> tuple[str, ...]:
        """What the effect needs: `needs`, and what its terms depend on, each once."""
        of_terms = (need for parameter in self.parameter for term in parameter.term for need in term.needs())
        return tuple(dict.fromkeys((*self.needs, *of_terms)))


def _letters(term: TermEntry) -> list[tuple[str, str]]:
    """(key, letter) of the joint letters that a term uses."""
    at = [term.place.joint] if term.place.joint and not term.place.joint.isdigit() else []
    basis = [letter for factor in term.factors for letter in factor.letters()]
    return [*(("at", letter) for letter in at), *(("basis", letter) for letter in basis)]


class EffectsFile(Strict):
    """A library of effects."""

    effect: list[EffectEntry] = pydantic.Field(min_length=1, examples=["at least one [[effect]] table"])
    """Effects, by name."""

    @pydantic.model_validator(mode="after")
    def _names_once(self) -> EffectsFile:
        names = [effect.name for effect in self.effect]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise Contradiction(
                    f"effect[{number + 1}].name", f"is {name!r}, as another effect's", "choose another name"
                )
        return self


def read_effects(text: str, source: str) -> tuple[EffectEntry, ...]:
    """Effects of a library in TOML. SchemaError lists all that is wrong, each with the effect's name."""
    doc = parse_toml(text, source)
    try:
        return tuple(validate(EffectsFile, doc, source).effect)
    except SchemaError as error:
        raise SchemaError([_named(problem, doc) for problem in error.problems], source) from None


def _named(problem: Problem, doc: dict[str, object]) -> Problem:
    """The problem with the name of its effect beside the number."""
    head, bracket, rest = problem.path.partition("]")
    effects = doc.get("effect")
    if not head.startswith("effect[") or not bracket or not isinstance(effects, list):
        return problem
    effect = effects[int(head.removeprefix("effect[")) - 1]
    name = effect.get("name") if isinstance(effect, dict) else None
    return Problem(f"{head}]{rest} ({name})", problem.what, problem.todo, problem.right) if name else problem
