"""Search spaces: candidate poses that the arm reaches, the camera sees, and that stay clear of everything,
also when the arm is wrong (docs/SPACES.md).

From a description to a table: search (with samples, workers, checks, kinematics, view, clearance, collision,
mjcf, error_sampling, metric, encoding). About a table: summary, explain, recheck, information, separability.
Every check says why it fails by a kind of reasons.py."""

from kincal_shared.schema.space import Description, read_description

from .checks import Checks, CorrectedArm
from .collision import CollisionModel, clear_of_contact
from .error_sampling import error_bounds, sampled_errors
from .explain import CheckLine, Region, explain_candidate, explain_region
from .information import Expected, ExpectedInformation, Noise, expected_information
from .inputs import TablesFolder
from .metric import KernelMetric, farthest_points
from .reasons import Reason, kind_of
from .recheck import Difference, Recheck, compare, recheck
from .samples import Sample
from .search import BuiltSpace, build
from .separability import Separability, separability
from .summary import Summary, scene, summarise
from .table import ALL_CHECKS, CHECKS, SpaceTable
from .workers import WorkerPool

__all__ = [
    "ALL_CHECKS",
    "CHECKS",
    "BuiltSpace",
    "CheckLine",
    "Checks",
    "CollisionModel",
    "CorrectedArm",
    "Description",
    "Difference",
    "Expected",
    "ExpectedInformation",
    "KernelMetric",
    "Noise",
    "Reason",
    "Recheck",
    "Region",
    "Sample",
    "Separability",
    "SpaceTable",
    "Summary",
    "TablesFolder",
    "WorkerPool",
    "build",
    "clear_of_contact",
    "compare",
    "error_bounds",
    "expected_information",
    "explain_candidate",
    "explain_region",
    "farthest_points",
    "kind_of",
    "read_description",
    "recheck",
    "sampled_errors",
    "scene",
    "separability",
    "summarise",
]
