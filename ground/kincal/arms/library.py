"""The arm tables that ship with KinCal."""

from __future__ import annotations

from dataclasses import dataclass

from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmFile, shipped_arms
from kincal_shared.schema.errors import parse_toml, validate
from kincal_shared.schema.suggestions import nearest_name


@dataclass(frozen=True)
class ShippedArm:
    """An arm that `--arm NAME` takes. convention: "standard" or "modified"; source: where the dimensions come
    from; masses: whether every link has a mass."""

    name: str
    title: str
    joints: int
    convention: str
    masses: bool
    source: str


def shipped() -> tuple[ShippedArm, ...]:
    """All arms that ship, by name."""
    return tuple(_entry(name) for name in sorted(shipped_arms()))


def arm_text(name: str) -> str:
    """The table of a shipped arm as it stands in its file. BadInput, with the nearest name, if none is."""
    files = shipped_arms()
    if name not in files:
        near = nearest_name(name, files)
        todo = f"did you mean {near}? `kincal arm list` lists all" if near else "`kincal arm list` lists all"
        raise BadInput(f"no arm {name!r} is shipped", todo=todo)
    return files[name].read_text(encoding="utf-8")


def _entry(name: str) -> ShippedArm:
    file = validate(ArmFile, parse_toml(arm_text(name), name), name)
    return ShippedArm(
        name=name,
        title=file.name or name,
        joints=len(file.joint),
        convention=file.convention,
        masses=all(joint.mass_kg is not None for joint in file.joint),
        source="; ".join(file.provenance.values()),
    )
