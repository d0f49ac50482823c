"""space.toml: what the ground says about where flight may look."""

from __future__ import annotations

import difflib
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pydantic

from kincal import tables
from kincal.errors import KincalError

CAND_MAX, HUB_MAX, PRIOR_MAX = 1024, 16, 32
FAR_M = 10.0  # as the SPACE table
_ERROR_NAME = re.compile(r"J([1-8])\.(phi_rad|alpha_rad|a_m|d_m)")
_SHOWN = 6  # mistakes named at once

Metres = Annotated[float, pydantic.Field(ge=-FAR_M, le=FAR_M)]
Angle = Annotated[float, pydantic.Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]
Vec3 = tuple[Metres, Metres, Metres]
Positive = Annotated[float, pydantic.Field(gt=0)]
AngleSize = Annotated[float, pydantic.Field(ge=0, le=math.pi)]
Length = Annotated[float, pydantic.Field(ge=0, le=1.0)]


_SIZES_OF: dict[str, set[str]] = {
    "below": set(),
    "box": {"half_m"},
    "capsule": {"end_m", "radius_m"},
    "sphere": {"radius_m"},
}


def _sizes(name: str, half_m: Vec3 | None) -> None:
    if half_m is not None and min(half_m) <= 0.0:
        raise ValueError(f"{name}: half_m must be above 0 in every direction")


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Joints(_Strict):
    margin_rad: list[AngleSize]
    hubs_rad: list[list[float]] = pydantic.Field(min_length=1, max_length=HUB_MAX)
    servo_leash_rad: Positive | list[Positive]  # of each joint, or one for all
    first_rad: list[list[float]] = pydantic.Field(
        default=[], max_length=PRIOR_MAX
    )  # first looks, about hub 0
    spare_first: list[int] = []  # which of them are only taken while few before them saw a tag


class Tool(_Strict):
    box_min_m: Vec3
    box_max_m: Vec3

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> Tool:
        for axis, lo, hi in zip("xyz", self.box_min_m, self.box_max_m, strict=True):
            if lo >= hi:
                raise ValueError(f"no room along {axis}: box_min_m {lo:g} is not below box_max_m {hi:g}")
        return self


class View(_Strict):
    range_min_m: float = pydantic.Field(ge=0)
    range_max_m: float = pydantic.Field(gt=0)
    tags_min: int = pydantic.Field(ge=1, le=4)
    incid_max_rad: float = pydantic.Field(gt=0, lt=1.5)
    tag_min_px: float = pydantic.Field(ge=0)  # shortest edge of the black square in the image
    image_margin_px: float = pydantic.Field(ge=0)
    head_margin_rad: float = pydantic.Field(ge=0)

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> View:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(
                f"range_min_m {self.range_min_m:g} is not below range_max_m {self.range_max_m:g}"
            )
        return self


class Clear(_Strict):
    """Distances that nothing may come nearer than, and how finely moves are looked at."""

    nominal_m: float = pydantic.Field(ge=0)  # of the arm as drawn
    drawn_m: float = pydantic.Field(ge=0)  # of the arms with drawn errors
    step_rad: float = pydantic.Field(gt=0, le=0.2)
    direct_max_rad: float = pydantic.Field(ge=0)
    leash_samples: int = pydantic.Field(ge=1)  # postures in the box around each seed, errors in turn


class Survive(_Strict):
    """DH errors under which everything above must hold."""

    phi_rad: list[AngleSize]  # one per joint
    alpha_rad: list[AngleSize]
    a_m: list[Length]
    d_m: list[Length]
    alone_rad: float = pydantic.Field(ge=0)  # bounds from here on are also tried alone, both ways
    alone_m: float = pydantic.Field(ge=0)
    draws: int = pydantic.Field(ge=0, le=200)
    errors: int = pydantic.Field(ge=1)  # errors at full size in each draw
    case: list[dict[str, float]] = []  # sets of errors named by people
    reach: bool = False  # the servo must be able to bring the tool to the pose under every case

    @pydantic.field_validator("case")
    @classmethod
    def _known_errors(cls, cases: list[dict[str, float]]) -> list[dict[str, float]]:
        for name in (name for c in cases for name in c):
            if not _ERROR_NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no DH error; they are called J1.phi_rad, J2.a_m ...")
        return cases


class Spread(_Strict):
    set: int = pydantic.Field(ge=0)  # hyperparameters of the kernel table that measure distance


class Shape(_Strict):
    """A capsule or box on the arm, in the frame of a joint (its axis is z, before a and alpha) or of the
    tool."""

    name: str
    joint: int = pydantic.Field(default=0, ge=0, le=8)  # 0: tool
    start_m: Vec3 | None = None
    end_m: Vec3 | None = None
    radius_m: float | None = pydantic.Field(default=None, gt=0)
    centre_m: Vec3 | None = None
    half_m: Vec3 | None = None
    tag: int | None = None  # a plate that carries this tag

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> Shape:
        capsule = (self.start_m, self.end_m, self.radius_m)
        box = (self.centre_m, self.half_m)
        if not (all(x is not None for x in capsule) and all(x is None for x in box)) and not (
            all(x is None for x in capsule) and all(x is not None for x in box)
        ):
            raise ValueError(f"{self.name}: give start, end and radius, or centre and half sizes")
        _sizes(self.name, self.half_m)
        return self


class KeepOut(_Strict):
    """A volume that nothing of the arm may enter, in the base frame."""

    name: str
    kind: Literal["box", "capsule", "sphere", "below"]
    centre_m: Vec3 = (0.0, 0.0, 0.0)
    half_m: Vec3 | None = None  # box
    end_m: Vec3 | None = None  # capsule: from centre to here
    radius_m: float | None = pydantic.Field(default=None, gt=0)
    except_: list[str] = pydantic.Field(default=[], alias="except")  # shapes that stand there by design

    @pydantic.model_validator(mode="after")
    def _complete(self) -> KeepOut:
        given = {k for k in ("half_m", "end_m", "radius_m") if getattr(self, k) is not None}
        want = _SIZES_OF[self.kind]
        if given != want:
            takes = " and ".join(["centre_m", *sorted(want)])
            raise ValueError(f"{self.name}: a volume of kind {self.kind!r} takes {takes}")
        _sizes(self.name, self.half_m)
        return self


class Sight(_Strict):
    margin_m: float = pydantic.Field(ge=0)
    border: float = pydantic.Field(ge=1)  # printed size of a tag over its black square


class Description(_Strict):
    """space.toml"""

    kind: str
    title: str = ""
    provenance: dict[str, str] = {}
    seed: int = pydantic.Field(ge=0)
    candidates: int = pydantic.Field(ge=1, le=CAND_MAX)
    samples: int = pydantic.Field(ge=1, le=10_000_000)
    priors: int = pydantic.Field(ge=0, le=PRIOR_MAX)
    joints: Joints
    tool: Tool
    view: View
    clear: Clear
    survive: Survive
    spread: Spread
    sight: Sight
    shape: list[Shape]
    touching: list[tuple[str, str]] = []  # pairs of shapes that touch by design
    keep_out: list[KeepOut]

    @pydantic.model_validator(mode="after")
    def _fits_the_table(self) -> Description:
        first = len(self.joints.first_rad)
        if self.priors + first > PRIOR_MAX:
            raise ValueError(
                f"{self.priors} priors and {first} first looks; the table has room for {PRIOR_MAX}"
            )
        if wrong := sorted({i for i in self.joints.spare_first if not 0 <= i < first}):
            raise ValueError(f"spare_first {wrong[0]}: there are {first} first looks, counted from 0")
        if self.candidates + first > CAND_MAX:
            raise ValueError(f"{self.candidates} candidates and {first} first looks; room is for {CAND_MAX}")
        return self

    @pydantic.model_validator(mode="after")
    def _one_of_each(self) -> Description:
        names = [s.name for s in self.shape] + [k.name for k in self.keep_out]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise ValueError(f"two shapes or volumes are called {', '.join(map(repr, twice))}")
        return self


def _siblings(loc: tuple[Any, ...]) -> list[str]:
    """Keys that may stand where `loc` points."""
    model: Any = Description
    for part in loc[:-1]:
        if isinstance(part, str) and model is not None:
            field = model.model_fields.get(part)
            inner = (field.annotation, *get_args(field.annotation)) if field else ()
            model = next((t for t in inner if isinstance(t, type) and issubclass(t, _Strict)), None)
    return [f.alias or name for name, f in model.model_fields.items()] if model else []


def _mistake(error: Any) -> str:
    """One problem of a description: where, what, and what it may have meant."""
    loc = error["loc"]
    where = "".join(f"[{x}]" if isinstance(x, int) else f".{x}" for x in loc).lstrip(".")
    kind, text = error["type"], error["msg"].removeprefix("Value error, ")
    if kind == "missing":
        return f"{where}: is missing"
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(loc[-1]), _siblings(loc), 1, 0.6)
        return f"{where}: unknown key" + (f", perhaps {near[0]}?" if near else "")
    got = error["input"]
    if isinstance(got, (int, float, str)) and kind != "value_error":
        text += f", got {got!r}"
        named = next((x for x in reversed(loc) if isinstance(x, str)), "")
        if named.endswith("_rad") and isinstance(got, (int, float)) and abs(got) > math.pi:
            text += f" (radians: {got:g} deg are {math.radians(got):.4g})"
    return f"{where}: {text}" if where else text


def read_description(path: Path) -> Description:
    doc = tables.read_toml(path)
    if doc.get("kind") != "space":
        raise KincalError(f"this is a {doc.get('kind')!r} source, not a search space", str(path))
    try:
        return Description.model_validate(doc)
    except pydantic.ValidationError as error:
        found = [_mistake(e) for e in error.errors()]
        more = [f"and {len(found) - _SHOWN} more"] if len(found) > _SHOWN else []
        raise KincalError(
            "\n  ".join(found[:_SHOWN] + more),
            str(path),
            "correct it; tables/src/space.toml is complete, docs/SPACES.md says what its parts mean",
        ) from None
