"""The loops in C and C++ that bench parts call, compiled when they are older than their sources.

flight_loop.c is compiled and linked as flight is; pinocchio_loop.cpp as Pinocchio says, with -O3; and
bare_apriltag.cpp as the detector is."""

from __future__ import annotations

import subprocess
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
HERE, OUT = Path(__file__).parent, ROOT / "build" / "bench"
FLAGS = ("-O2", "-ffp-contract=off", "-fno-tree-vectorize", "-fno-math-errno")
PINOCCHIO = (
    "BOOST_MPL_LIMIT_LIST_SIZE=30",
    "BOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "BOOST_FUSION_INVOKE_MAX_ARITY=12",
)
"""What Pinocchio's CMake package defines for who uses it."""


def _compile(name: str, command: list[str], sources: list[Path]) -> Path:
    made = OUT / name
    if not made.exists() or made.stat().st_mtime < max(s.stat().st_mtime for s in sources):
        OUT.mkdir(parents=True, exist_ok=True)
        subprocess.run([*command, "-o", str(made.with_suffix(".new"))], check=True)
        made.with_suffix(".new").rename(made)
    return made


def flight_loop() -> Path:
    """Shared library with the loops over flight's functions."""
    source, core = HERE / "flight_loop.c", ROOT / "build" / "libkincal.a"
    places = [*(ROOT / "fsw").iterdir(), *(ROOT / "build/made").iterdir()]
    folders = [f"-I{folder}" for folder in sorted(places) if folder.is_dir()]
    command = ["gcc", "-std=c11", *FLAGS, "-fPIC", "-shared", *folders, str(source), str(core), "-lstdc++"]
    return _compile("libflight_loop.so", command, [source, core])


def pinocchio_loop() -> Path:
    """Shared library with the loops over Pinocchio's functions; a minute."""
    source = HERE / "pinocchio_loop.cpp"
    wheel = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
    given = ["-std=c++17", "-O3", "-DNDEBUG", "-w", *(f"-D{d}" for d in PINOCCHIO), "-fPIC", "-shared"]
    where = [f"-I{wheel}/include", "-isystem", "/usr/include/eigen3"]
    links = [f"-L{wheel}/lib", "-lpinocchio_default", f"-Wl,-rpath,{wheel}/lib"]
    return _compile("libpinocchio_loop.so", ["g++", *given, *where, str(source), *links], [source])


def bare_apriltag() -> Path:
    """Program that calls libapriltag and nothing else."""
    source = HERE / "bare_apriltag.cpp"
    given = ["-std=c++17", *FLAGS, "-I/usr/include/opencv4", str(source)]
    links = ["-lapriltag", "-lopencv_imgcodecs", "-lopencv_core"]
    return _compile("bare_apriltag", ["g++", *given, *links], [source])
