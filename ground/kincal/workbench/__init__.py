"""The model workbench: compare a model with measurements, find the missing effect, add it, fly it."""

from kincal.errors import BadInput, CannotAnswer
from kincal.schema.arm import ArmTable, read_arm

from .api import FitResult, advise, fit, report_content
from .compare import Comparison, compare
from .constants import choose_constants
from .data import Measurements
from .diagnosis import Diagnosis, diagnose
from .effects import Effect, Hypothesis, Library
from .modelfile import ModelFile, read_model, write_model
from .readers import read_csv, read_measurements

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
    "advise",
    "choose_constants",
    "compare",
    "diagnose",
    "fit",
    "read_arm",
    "read_csv",
    "read_measurements",
    "read_model",
    "report_content",
    "write_model",
]
