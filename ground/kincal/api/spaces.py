"""Search spaces: tables or descriptions, checked and planned with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from kincal import space
from kincal.flight.tables import Image
from kincal.rotations import Floats
from kincal.workbench.model.uplink import refuse_other_arm
from kincal.workbench.numerics.types import Mask
from kincal_shared.schema.arm import ArmTable

_STEPS = (5, 8, 12)


def load(file: Path, tables_dir: Path) -> tuple[Image, space.SpaceTable]:
    """Image and contents of a SPACE table, or of a description as it would be built."""
    if file.suffix == ".toml":
        built = space.build(space.read_description(file), tables_dir)
        return built.image, built.table
    return space.SpaceTable.load(file)


def checks(description: Path, tables_dir: Path) -> space.Checks:
    """The checks that a description asks for, with the arm and camera of a folder."""
    return space.Checks.load(space.read_description(description), space.TablesFolder(tables_dir))


def expected(
    table: space.SpaceTable, tables_dir: Path, poses: int, sigma_m: float, sigma_rad: float
) -> space.ExpectedInformation:
    """What a space is expected to tell after up to that many poses, with that noise of a measurement."""
    steps = tuple(sorted({n for n in _STEPS if n < poses} | {poses}))
    return space.expected_information(
        table, space.TablesFolder(tables_dir), steps, space.Noise(sigma_m, sigma_rad)
    )


def free_of_contact(description: Path, tables_dir: Path, arm: ArmTable) -> Callable[[Floats], Mask]:
    """Whether shapes of a search space stand clear at joints (N, n) to (N,). BadInput if the shapes are of
    another arm."""
    tables = space.TablesFolder(tables_dir)
    refuse_other_arm(arm, tables_dir)
    return space.clear_of_contact(space.read_description(description), tables)
