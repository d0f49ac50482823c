"""A fitted model to take away: corrected DH table, JSON, URDF, Python and C source.

calibrated   the fitted arm as plain numbers: nominal chain, frames, correction terms, covariance
dh, urdf     the part that a DH table or a URDF can carry, and what it leaves out
source       self-contained code with every effect
files        formats, paths, writing
"""

from .calibrated import CalibratedArm, calibrated_arm, calibrated_fit
from .dh import DhTable, dh_table
from .files import FORMATS, Exported, export

__all__ = [
    "FORMATS",
    "CalibratedArm",
    "DhTable",
    "Exported",
    "calibrated_arm",
    "calibrated_fit",
    "dh_table",
    "export",
]
