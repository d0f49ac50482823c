"""Made by ground/stubs.py from fsw/design/kc_acquire.h; do not edit: the acquisitions."""

from typing import Literal

Acquisition = Literal["ucb", "random", "dopt", "vopt", "rate"]
