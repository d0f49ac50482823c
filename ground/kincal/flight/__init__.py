"""The only door to the C core: what is reviewed on the ground is what flies.

library   the two builds of the core, their constants, enumerations and structs
arm       arms and their nominal kinematics
terms     coefficients and correction terms
model     residuals and derivatives at many poses
tables    table images
events    events in words
"""

from .arm import Arm
from .builds import CoreError, check, library, status_name
from .events import event_action, event_line, event_name, event_text
from .model import Evaluation, Model, Observations
from .terms import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL, Terms

__all__ = [
    "FRAME_CAMERA",
    "FRAME_MEAS",
    "FRAME_TOOL",
    "Arm",
    "CoreError",
    "Evaluation",
    "Model",
    "Observations",
    "Terms",
    "check",
    "event_action",
    "event_line",
    "event_name",
    "event_text",
    "library",
    "status_name",
]
