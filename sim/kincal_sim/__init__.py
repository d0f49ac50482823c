"""KinCal simulator: the truth that flight software is tested against. Loads no flight code."""

import os

# MuJoCo looks for a back end to draw with when it is loaded, which takes a third of that time. The camera has
# its own.
os.environ.setdefault("MUJOCO_GL", "disable")
