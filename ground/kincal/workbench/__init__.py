"""The model workbench: compare a model with measurements, find the missing effect, add it, fly it."""

from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.arm import ArmTable, read_arm

from .comparison.compare import Comparison, compare
from .comparison.fitting import FitResult, fit
from .data.measurements import Measurements
from .data.readers import read_csv, read_measurements
from .diagnosis import Diagnosis, diagnose
from .diagnosis.additions import Addition, Additions, add_one, add_unnamed, add_unnamed_to
from .diagnosis.competing import advise
from .diagnosis.unnamed_effects import Found, find_unnamed
from .evidence.constants import choose_constants
from .evidence.curves import Curve, curves
from .evidence.smooth import SmoothEffect
from .model.effects import Effect, Hypothesis, Library
from .model.modelfile import ModelFile, read_model, write_model
from .model.unnamed_names import UnnamedName
from .report.content import report_content

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
