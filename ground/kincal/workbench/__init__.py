"""The model workbench: compare a model with measurements, find the missing effect, add it, fly it."""

from kincal.errors import BadInput, CannotAnswer

from .api import FitResult, choose_constants, fit
from .arms import ArmTable, read_arm
from .compare import Comparison, compare
from .data import Measurements, read_csv
from .diagnose import Diagnosis, diagnose
from .effects import Effect, Hypothesis, Library
from .modelfile import ModelFile, read_model, write_model

__all__ = [
    "ArmTable",
    "BadInput",
    "CannotAnswer",
    "Comparison",
    "Diagnosis",
    "Effect",
    "FitResult",
    "Hypothesis",
    "Library",
    "Measurements",
    "ModelFile",
    "choose_constants",
    "compare",
    "diagnose",
    "fit",
    "read_arm",
    "read_csv",
    "read_model",
    "write_model",
]
