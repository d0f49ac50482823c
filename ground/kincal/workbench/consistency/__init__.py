"""Do the arm table and the measurements belong together?

`check` looks at what was recorded (doubled rows, readings outside the limits, joints that stand still), then
at whether the nominal arm explains the poses. If it does not, simple misreadings of the files are tried:
columns in another order, a joint's sign, degrees, millimetres, the other DH convention, another arm.
"""

from .check import Check, check, left_m, refuse
from .findings import Finding
from .models import refuse_model_of_other_arm
from .units import reach_m

__all__ = ["Check", "Finding", "check", "left_m", "reach_m", "refuse", "refuse_model_of_other_arm"]
