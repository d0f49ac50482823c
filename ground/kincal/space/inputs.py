"""Tables of a folder: those that a search space is built with and asked about, and the space itself."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from kincal.flight.tables import decode_as
from kincal_shared.errors import BadInput

from .table import SpaceTable

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera, KcConfig, KcKernel, KcKin, KcTerms
    from kincal.flight.tables import Image


class TablesFolder:
    """A folder with built table images; each is read when first asked for. BadInput if one is missing,
    KincalError if it is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def _bytes(self, kind: str) -> tuple[bytes, str]:
        file = self.path / f"{kind}.tbl"
        if not file.is_file():
            raise BadInput(
                f"the built {kind} table is needed",
                str(file),
                "run `kincal table build tables/src tables/bin` or give --tables DIR",
            )
        return file.read_bytes(), str(file)

    @cached_property
    def _arm(self) -> tuple[Image, KcArm]:
        return decode_as("arm", *self._bytes("arm"))

    @property
    def arm(self) -> KcArm:
        """The ARM table."""
        return self._arm[1]

    @property
    def arm_crc(self) -> int:
        """CRC of the ARM table."""
        return self._arm[0].crc

    @cached_property
    def camera(self) -> KcCamera:
        """The CAMERA table."""
        return decode_as("camera", *self._bytes("camera"))[1]

    @cached_property
    def kernel(self) -> KcKernel:
        """The KERNEL table."""
        return decode_as("kernel", *self._bytes("kernel"))[1]

    @cached_property
    def terms(self) -> KcTerms:
        """The TERMS table."""
        return decode_as("terms", *self._bytes("terms"))[1]

    @cached_property
    def config(self) -> KcConfig:
        """The CONFIG table."""
        return decode_as("config", *self._bytes("config"))[1]

    @cached_property
    def kin(self) -> KcKin:
        """The KIN table."""
        return decode_as("kin", *self._bytes("kin"))[1]

    @cached_property
    def space(self) -> SpaceTable:
        """The SPACE table."""
        return SpaceTable.from_struct(decode_as("space", *self._bytes("space"))[1])
