"""Arms: tables of common robots (the .toml files beside this one, `kincal arm list`), and any serial chain
of a URDF as an arm table (`kincal arm import`)."""

from .importing import ImportedArm, import_urdf
from .library import ShippedArm, arm_text, shipped

__all__ = ["ImportedArm", "ShippedArm", "arm_text", "import_urdf", "shipped"]
