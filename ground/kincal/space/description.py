"""space.toml: what the ground says about where flight may look."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from kincal import tables
from kincal.errors import KincalError

CAND_MAX, HUB_MAX = 1024, 16
Vec3 = tuple[float, float, float]
Positive = Annotated[float, pydantic.Field(gt=0)]


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Joints(_Strict):
    margin_rad: list[float]
    hubs_rad: list[list[float]] = pydantic.Field(min_length=1, max_length=HUB_MAX)
    servo_leash_rad: Positive | list[Positive]  # of each joint, or one for all


class Tool(_Strict):
    box_min_m: Vec3
    box_max_m: Vec3


class View(_Strict):
    range_min_m: float
    range_max_m: float
    tags_min: int = pydantic.Field(ge=1, le=4)
    incid_max_rad: float = pydantic.Field(gt=0, lt=1.5)
    tag_min_px: float = pydantic.Field(ge=0)  # shortest edge of the black square in the image
    image_margin_px: float = pydantic.Field(ge=0)
    head_margin_rad: float = pydantic.Field(ge=0)


class Clear(_Strict):
    """Distances that nothing may come nearer than, and how finely moves are looked at."""

    nominal_m: float = pydantic.Field(ge=0)  # of the arm as drawn
    drawn_m: float = pydantic.Field(ge=0)  # of the arms with drawn errors
    step_rad: float = pydantic.Field(gt=0, le=0.2)
    direct_max_rad: float = pydantic.Field(ge=0)
    leash_samples: int = pydantic.Field(ge=1)  # postures in the box around each seed, errors in turn


class Survive(_Strict):
    """DH errors under which everything above must hold."""

    phi_rad: list[float]  # one per joint
    alpha_rad: list[float]
    a_m: list[float]
    d_m: list[float]
    alone_rad: float = pydantic.Field(ge=0)  # bounds from here on are also tried alone, both ways
    alone_m: float = pydantic.Field(ge=0)
    draws: int = pydantic.Field(ge=0, le=200)
    errors: int = pydantic.Field(ge=1)  # errors at full size in each draw
    case: list[dict[str, float]] = []  # sets of errors named by people
    reach: bool = False  # the servo must be able to bring the tool to the pose under every case


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
        return self


class KeepOut(_Strict):
    """A volume that nothing of the arm may enter, in the base frame."""

    name: str
    kind: Literal["box", "capsule", "sphere", "below"]
    centre_m: Vec3 = (0.0, 0.0, 0.0)
    half_m: Vec3 | None = None  # box
    end_m: Vec3 | None = None  # capsule: from centre to here
    radius_m: float | None = None
    except_: list[str] = pydantic.Field(default=[], alias="except")  # shapes that stand there by design


class Sight(_Strict):
    margin_m: float = pydantic.Field(ge=0)
    border: float = pydantic.Field(ge=1)  # printed size of a tag over its black square


class Description(_Strict):
    """space.toml"""

    kind: str
    title: str = ""
    provenance: dict[str, str] = {}
    seed: int
    candidates: int = pydantic.Field(ge=1, le=CAND_MAX)
    samples: int = pydantic.Field(ge=1, le=10_000_000)
    priors: int = pydantic.Field(ge=0, le=16)
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


def read_description(path: Path) -> Description:
    doc = tables.read_toml(path)
    try:
        desc = Description.model_validate(doc)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        raise KincalError(
            f"{'.'.join(map(str, first['loc']))}: {first['msg']}",
            str(path),
            "see tables/src/space.toml for a complete description",
        ) from None
    if desc.kind != "space":
        raise KincalError(f"this is a {desc.kind!r} source, not a search space", str(path))
    return desc
