"""What came with this installation, and what it needs for which command.

The wheel carries a part of the source tree in `kincal/_tree`, with the same folders: models and scenarios of
the simulator (`sim/`), tables (`tables/`) and the processes (`build/`). In a source tree the tree itself is
used."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Final

from kincal_shared.errors import BadInput

_PACKAGES: Final = Path(__file__).resolve().parents[1]

# extra of the package -> modules that it brings
EXTRAS: Final[dict[str, tuple[str, ...]]] = {
    "sim": ("mujoco", "cv2", "OpenGL"),
    "image": ("kaleido",),
    "urdf": ("yourdfpy",),
    "data": ("pyarrow",),
    "ros": ("rosbags",),
    "xtce": ("yamcs",),
    "console": ("starlette", "uvicorn", "websockets"),
    "campaign": ("pyarrow", "distributed", "SALib"),
}

SIMULATOR_LIBRARY = "libsim_native.so"  # of built()


def root() -> Path:
    """The folder that holds sim/, tables/ and build/: what the wheel brought, or the source tree."""
    packed = _PACKAGES / "kincal" / "_tree"
    return packed if packed.is_dir() else _PACKAGES.parent


def file(name: str) -> Path:
    """A file or folder by its path in the source tree: below the current folder if it is there, else as it
    came with kincal."""
    here = Path(name)
    return here if here.exists() else root() / name


def extra_of(module: str) -> str:
    """The extra that brings a module; "" if it belongs to none."""
    top = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if top in modules), "")


def require(extra: str, what: str) -> None:
    """BadInput that names the extra, unless all its modules are installed. what: what needs them."""
    missing = [module for module in EXTRAS[extra] if find_spec(module) is None]
    if missing:
        raise BadInput(
            f"{what} needs {', '.join(missing)}", todo=f"install them: pip install 'kincal[{extra}]'"
        )


def simulator() -> None:
    """BadInput if what the simulator (package kincal_sim) needs is not installed."""
    require("sim", "a simulated run")


def campaign() -> None:
    """BadInput if what campaigns need is not installed."""
    require("campaign", "a campaign")
    simulator()


def built(name: str) -> Path:
    """A process of the flight side (kincal-fsw, kincal-tagdet), or the simulator's library. BadInput that
    says what was missing when the wheel was built, or that it was not built."""
    path = root() / "build" / name
    if path.is_file():
        return path
    note = path.with_name(f"{name}.missing")
    if note.is_file():
        raise BadInput(
            f"this installation has no {name}: {note.read_text('utf-8').strip()}",
            str(path),
            "install that (Debian: liblcm-dev liblcm-bin libapriltag-dev libopencv-dev) and kincal anew",
        )
    raise BadInput(f"{name} was not built", str(path), "run `make build`")
