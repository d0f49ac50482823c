"""The model workbench: compare a model with measurements, find the missing effect, add it, fly it."""

from kincal.errors import BadInput, CannotAnswer
from kincal.schema.arm import ArmTable, read_arm

from .additions import Addition, Additions, add_one, add_unnamed, add_unnamed_to
from .api import FitResult, Found, advise, find_unnamed, fit, report_content
from .compare import Comparison, compare
from .constants import choose_constants
from .curves import Curve, curves
from .data import Measurements
from .diagnosis import Diagnosis, diagnose
from .effects import Effect, Hypothesis, Library
from .modelfile import ModelFile, read_model, write_model
from .readers import read_csv, read_measurements
from .smooth import SmoothEffect, UnnamedName

__all__ = [
    "Addition",
    "Additions",
    "ArmTable",
    "BadInput",
    "CannotAnswer",
    "Comparison",
    "Curve",
    "Diagnosis",
    "Effect",
    "FitResult",
    "Found",
    "Hypothesis",
    "Library",
    "Measurements",
    "ModelFile",
    "SmoothEffect",
    "UnnamedName",
    "add_one",
    "add_unnamed",
    "add_unnamed_to",
    "advise",
    "choose_constants",
    "compare",
    "curves",
    "diagnose",
    "find_unnamed",
    "fit",
    "read_arm",
    "read_csv",
    "read_measurements",
    "read_model",
    "report_content",
    "write_model",
]
