"""Builds the wheel of `kincal` (PEP 517, named in pyproject.toml), so that `pip install ./ground` works
on a user's machine: compiles the flight core from ../fsw into the package and adds the LCM messages.

Needs the whole source tree, gcc, g++ and Eigen's headers (Debian: gcc g++ libeigen3-dev). With lcm-gen
(liblcm-bin), or after `make messages`, the wheel can also read logs and talk to the flight process;
without, it says so when asked to. No Python package is needed to build, so it works without a network.

Environment: CC, CXX choose the compilers, EIGEN3_INCLUDE the folder that holds Eigen/.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

GROUND = Path(__file__).resolve().parent
ROOT = GROUND.parent
LAYERS = ("math", "eigen", "model", "estimate", "design", "motion", "exec")
# As the Makefile builds what flies, without its warnings: a user's compiler may know more of them.
COMMON = ("-O2", "-fPIC", "-ffp-contract=off", "-w")
C_FLAGS = ("-std=c11",)
CXX_FLAGS = ("-std=c++17", "-fno-exceptions", "-fno-rtti", "-DEIGEN_DONT_VECTORIZE")
DATE = (2020, 1, 1, 0, 0, 0)  # the same sources give the same archive


# --------------------------------------------------------------------------- the flight core


def _eigen() -> str:
    named = os.environ.get("EIGEN3_INCLUDE")
    for folder in ([named] if named else []) + ["/usr/include/eigen3", "/usr/local/include/eigen3"]:
        if Path(folder, "Eigen", "Core").is_file():
            return folder
    raise SystemExit(
        "kincal: Eigen's headers were not found; install libeigen3-dev, or set EIGEN3_INCLUDE to the folder "
        "that holds Eigen/"
    )


def _run(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        raise SystemExit(
            f"kincal: {command[0]} was not found; the flight core is compiled with gcc and g++"
        ) from None
    if done.returncode:
        raise SystemExit(f"kincal: {' '.join(command)}\n{done.stderr}")
    return done.stdout


def _core(out: Path) -> None:
    """libkincal.so and kincal_cdef.h in out."""
    sources = sorted(p for layer in LAYERS for p in (ROOT / "fsw" / layer).glob("kc_*.c*"))
    if not sources:
        raise SystemExit(f"kincal: {ROOT / 'fsw'} holds no flight core; build from the whole source tree")
    include = [f"-I{ROOT / 'fsw' / layer}" for layer in LAYERS] + ["-isystem", _eigen()]
    cc, cxx = os.environ.get("CC", "gcc"), os.environ.get("CXX", "g++")
    with tempfile.TemporaryDirectory() as folder:
        jobs, objects = [], []
        for source in sources:
            objects.append(str(Path(folder, source.name + ".o")))
            tool = [cc, *C_FLAGS] if source.suffix == ".c" else [cxx, *CXX_FLAGS]
            jobs.append([*tool, *COMMON, *include, "-c", str(source), "-o", objects[-1]])
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            list(pool.map(_run, jobs))
        _run([cxx, "-shared", "-Wl,-z,defs", *objects, "-lm", "-o", str(out / "libkincal.so")])
    folders = [str(ROOT / "fsw" / layer) for layer in LAYERS]
    (out / "kincal_cdef.h").write_text(_run([sys.executable, str(GROUND / "cdef.py"), *folders]))


def _messages(out: Path) -> bool:
    """The package kcm in out: made by lcm-gen, or taken from build/py. False if neither is there."""
    sources = [str(p) for p in sorted((ROOT / "fsw" / "msg").glob("*.lcm"))]
    made = ROOT / "build" / "py" / "kcm"
    if shutil.which("lcm-gen"):
        _run(["lcm-gen", "-p", "--ppath", str(out), *sources])
    elif made.is_dir():
        shutil.copytree(made, out / "kcm", ignore=shutil.ignore_patterns("__pycache__"))
    return (out / "kcm").is_dir()


# --------------------------------------------------------------------------- the archive


def _metadata(project: dict) -> str:
    lines = ["Metadata-Version: 2.1", f"Name: {project['name']}", f"Version: {project['version']}"]
    lines += [f"Summary: {project['description']}", f"Requires-Python: {project['requires-python']}"]
    lines += [f"License: {project['license']['text']}"]
    lines += [f"Requires-Dist: {need}" for need in project["dependencies"]]
    return "\n".join(lines) + "\n"


def _digest(data: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def build_wheel(
    wheel_directory: str,
    config_settings: dict | None = None,  # noqa: ARG001  (PEP 517)
    metadata_directory: str | None = None,  # noqa: ARG001
) -> str:
    """Write the wheel into wheel_directory and return its name."""
    project = tomllib.loads((GROUND / "pyproject.toml").read_text("utf-8"))["project"]
    files: dict[str, bytes] = {}
    for path in sorted((GROUND / "kincal").rglob("*")):
        if path.suffix in (".py", ".toml") and "__pycache__" not in path.parts:
            files[path.relative_to(GROUND).as_posix()] = path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        core, messages = Path(folder, "core"), Path(folder, "messages")
        core.mkdir()
        messages.mkdir()
        _core(core)
        for path in sorted(core.iterdir()):
            files[f"kincal/_core/{path.name}"] = path.read_bytes()
        if _messages(messages):
            for path in sorted((messages / "kcm").glob("*.py")):
                files[f"kcm/{path.name}"] = path.read_bytes()
        else:
            print("kincal: no lcm-gen and no build/py: this wheel cannot read logs", file=sys.stderr)
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    tag = f"py3-none-{platform}"
    info = f"{project['name']}-{project['version']}.dist-info"
    files[f"{info}/METADATA"] = _metadata(project).encode()
    files[f"{info}/WHEEL"] = (
        f"Wheel-Version: 1.0\nGenerator: kincal\nRoot-Is-Purelib: false\nTag: {tag}\n"
    ).encode()
    scripts = "".join(f"{name} = {target}\n" for name, target in project["scripts"].items())
    files[f"{info}/entry_points.txt"] = f"[console_scripts]\n{scripts}".encode()
    record = [f"{name},{_digest(data)},{len(data)}" for name, data in files.items()]
    files[f"{info}/RECORD"] = ("\n".join([*record, f"{info}/RECORD,,"]) + "\n").encode()
    name = f"{project['name']}-{project['version']}-{tag}.whl"
    with zipfile.ZipFile(Path(wheel_directory, name), "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in files.items():
            entry = zipfile.ZipInfo(path, DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if path.endswith(".so") else 0o644) << 16
            archive.writestr(entry, data)
    return name


def build_sdist(sdist_directory: str, config_settings: dict | None = None) -> str:  # noqa: ARG001
    """PEP 517 asks for it; the core's sources are outside this folder, so there is none."""
    raise SystemExit("kincal: build a wheel from the whole source tree; there is no source distribution")
