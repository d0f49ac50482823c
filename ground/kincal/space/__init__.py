"""Search spaces: candidate poses that the arm reaches, the camera sees and nothing stands in the way of, also
when the arm is wrong (docs/SPACES.md).

description: space.toml. bodies: the arm as solid shapes. drawn: errors to survive. checks: what a candidate
has to pass. spread: distance as the kernel sees it. work: what two processes share. search: description to
table. look: numbers and geometry of a table."""

from .bodies import Bodies
from .checks import WHY, WHY_ALL, Checks
from .description import Description, read_description
from .drawn import draw
from .look import Numbers, describe, ordinary, scene
from .search import Built, build
from .spread import Metric, farthest
from .work import Crew

__all__ = [
    "WHY",
    "WHY_ALL",
    "Bodies",
    "Built",
    "Checks",
    "Crew",
    "Description",
    "Metric",
    "Numbers",
    "build",
    "describe",
    "draw",
    "farthest",
    "ordinary",
    "read_description",
    "scene",
]
