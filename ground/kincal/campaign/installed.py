"""The software that flies the cases of a campaign."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import zlib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from kincal.flight.builds import library_file
from kincal_shared import installation


def software() -> dict[str, str]:
    """Everything but the spec that the bits of a case depend on: version and contents of kincal, flight core,
    simulator with its models, the libraries that compute in it."""
    of_kincal, of_simulator, of_schema = (_folder(name) for name in ("kincal", "kincal_sim", "kincal_shared"))
    models = installation.root() / "sim" / "models"
    library = installation.built(installation.SIMULATOR_LIBRARY)
    return {
        "kincal": import_module("kincal").__version__,  # no import that layers would see: it is above
        "flight": f"{zlib.crc32(library_file('flight').read_bytes()):08x}",
        "ground": f"{zlib.crc32(library_file('ground').read_bytes()):08x}",
        "code": _hash(*(of_kincal / name for name in ("run", "flight", "campaign")), of_schema),
        "simulator": _hash(of_simulator, models),
        "simulator library": f"{zlib.crc32(library.read_bytes()):08x}",
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: importlib.metadata.version(name) for name in ("mujoco", "numpy", "scipy")},
    }


def _folder(package: str) -> Path:
    """Of a package that need not be loaded for it."""
    found = find_spec(package)
    assert found is not None and found.origin is not None
    return Path(found.origin).parent


def _hash(*folders: Path) -> str:
    made = hashlib.sha256()
    for folder in folders:
        for file in sorted(folder.rglob("*")):
            if file.suffix in (".py", ".toml", ".yml", ".csv"):
                made.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes())
    return made.hexdigest()[:16]
