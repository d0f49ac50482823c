"""Numbers that measurements can hold: what is beyond them is a slip, or of another kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal_shared.schema.arm import MOST_GRAVITY_M_S2

from ...numerics.types import Array, Mask

LEAST_SIGMA = 1e-12
"""[m or rad] Far below any instrument; squares of much smaller ones are 0 to a computer."""
_MOST_SIGMA = 1e7


@dataclass(frozen=True)
class Range:
    """Least and largest number that can be meant, in SI units, and what to say of others."""

    least: float
    most: float
    unit: str
    hint: str = ""

    def wrong(self, values: Array | float) -> Mask:
        """Which values are outside; numbers that are none are not looked at."""
        x = np.asarray(values, dtype=float)
        return np.asarray((x < self.least) | (x > self.most), dtype=np.bool_)

    def why(self, name: str, value: float) -> str:
        """Why a value that is outside cannot be used."""
        needed = f"{self.least:g} or more is needed"
        if self.least == -self.most or value > self.most:
            needed = f"up to {self.most:g} are possible"
        unit, hint = self.unit and f" {self.unit}", self.hint and f" ({self.hint})"
        return f"{name} is {value:.6g}{unit}, {needed}{hint}"


def _around_zero(most: float, unit: str, hint: str = "") -> Range:
    return Range(-most, most, unit, hint)


RANGES = {
    "q": _around_zero(1e4, "rad or m", "counts of an encoder have to be converted"),
    "qdot": _around_zero(1e4, "rad/s or m/s"),
    "p": _around_zero(1e7, "m"),
    "cam": _around_zero(1e7, "m"),
    "t_s": _around_zero(1e20, "s"),
    "g": _around_zero(MOST_GRAVITY_M_S2, "m/s^2", "mm/s^2 have to be converted"),
    "range_m": Range(0.0, 1e7, "m"),
    "temp_c": Range(-273.15, 1e4, "deg C", "this is below absolute zero, or above any arm"),
    "payload_kg": Range(0.0, 1e7, "kg"),
    "incid_rad": _around_zero(1e4, "rad"),
    "pan_rad": _around_zero(1e4, "rad"),
    "tilt_rad": _around_zero(1e4, "rad"),
    "u_px": _around_zero(1e7, "px"),
    "v_px": _around_zero(1e7, "px"),
    "tag": Range(0.0, 1.0, "", "0 and 1: one of the tags, 0.5: both"),
    "replicate": _around_zero(1e9, "", "whole numbers count the groups"),
    "sp_m": Range(LEAST_SIGMA, _MOST_SIGMA, "m"),
    "sr_rad": Range(LEAST_SIGMA, _MOST_SIGMA, "rad"),
}


def unusable_variance(cov: Array) -> Mask:
    """(N,) which of the covariances (N, 6, 6) hold a variance that no instrument has."""
    variance = np.diagonal(cov, axis1=1, axis2=2)
    outside = (variance < LEAST_SIGMA**2) | (variance > _MOST_SIGMA**2)
    return np.asarray(outside.any(axis=1), dtype=np.bool_)
