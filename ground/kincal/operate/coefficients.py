"""Which coefficients belong to a joint, for a calibration that is limited to it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from kincal.flight import library
from kincal.flight.tables import decode_as
from kincal_shared.errors import BadInput


def of_joints(joints: Collection[int], file: Path) -> tuple[int, str, tuple[str, ...]]:
    """Mask for START, CRC of the TERMS table, and names of the enabled coefficients of these joints (from 1).

    BadInput if the file is no TERMS table, or has no enabled coefficient of one of the joints."""
    try:
        image, table = decode_as("terms", file.read_bytes(), str(file))
    except OSError as error:
        raise BadInput(f"cannot read: {error.strerror}", str(file), "name its folder by --tables") from None
    flight, mask = library("flight"), 0
    names: list[str] = []
    for joint in sorted(set(joints)):
        found = [
            (i, name)
            for i in range(table.n_coef)
            if table.coef[i].enabled and (name := flight.text(table.coef[i].name)).startswith(f"J{joint}.")
        ]
        if not found:
            raise BadInput(f"no enabled coefficient of joint {joint}", str(file), "joints count from 1")
        mask |= sum(1 << i for i, _ in found)
        names += [name for _, name in found]
    return mask, image.crc_text, tuple(names)
