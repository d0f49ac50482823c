"""Builds the wheel of `kincal` (PEP 517, named in pyproject.toml), so that `pip install ./ground` works
on a user's machine: compiles the flight core from ../fsw into the package, adds the LCM
messages and the part of the source tree that a simulated run needs (in kincal/_tree).

Needs the whole source tree, gcc, g++ and Eigen's headers (Debian: gcc g++ libeigen3-dev). With lcm-gen
(liblcm-bin), or after `make messages`, the wheel can also read logs and talk to the flight process; with
liblcm-dev it holds the flight process, with libapriltag-dev and libopencv-dev the tag detector, both for
`kincal run`. Without, it says so when asked to. No Python package is needed to build, so it works without
a network.

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
CC, CXX = os.environ.get("CC", "gcc"), os.environ.get("CXX", "g++")
OPENCV = ("-isystem", "/usr/include/opencv4")
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


def _compile(
    work: Path, sources: list[Path], flags: list[str], cxx_flags: tuple[str, ...] = CXX_FLAGS
) -> list[str]:
    """Object files of C and C++ sources, in work; a source name occurs once."""
    work.mkdir(parents=True, exist_ok=True)
    jobs, objects = [], []
    for source in sources:
        objects.append(str(work / f"{source.name}.o"))
        tool = [CC, *C_FLAGS] if source.suffix == ".c" else [CXX, *cxx_flags]
        jobs.append([*tool, *COMMON, *flags, "-c", str(source), "-o", objects[-1]])
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(_run, jobs))
    return objects


def _library(out: Path, work: Path, name: str, folders: list[Path], *options: str) -> list[str]:
    """Compile the sources of some folders into <name>.so; their declarations go into <name>_cdef.h, without
    the lib in front. Returns the object files."""
    sources = sorted(p for folder in folders for p in folder.glob("k[cg]_*.c*"))
    if not sources:
        raise SystemExit(f"kincal: {ROOT / 'fsw'} holds no flight core; build from the whole source tree")
    include = [f"-I{folder}" for folder in folders] + ["-isystem", _eigen()]
    objects = _compile(work / name, sources, [*options, *include])
    _run([CXX, "-shared", "-Wl,-z,defs", *objects, "-lm", "-o", str(out / f"{name}.so")])
    defines = [option for option in options if option.startswith("-D")]
    declare = [sys.executable, str(GROUND / "cdef.py"), *defines, *map(str, folders)]
    (out / f"{name.removeprefix('lib')}_cdef.h").write_text(_run(declare))
    return objects


def _core(out: Path, work: Path) -> list[str]:
    """Both builds of the flight core in out: what flies, and the ground's (Makefile says the same). Returns
    the object files of what flies."""
    flight = _library(out, work, "libkincal", [ROOT / "fsw" / layer for layer in LAYERS])
    ground = [ROOT / "fsw" / "math", ROOT / "fsw" / "model", GROUND / "native"]
    _library(out, work, "libkincal_ground", ground, "-O3", "-fno-semantic-interposition", "-DKC_GROUND")
    return flight


def _messages(out: Path) -> bool:
    """The package kcm in out: made by lcm-gen, or taken from build/py. False if neither is there."""
    sources = [str(p) for p in sorted((ROOT / "fsw" / "msg").glob("*.lcm"))]
    made = ROOT / "build" / "py" / "kcm"
    if shutil.which("lcm-gen"):
        _run(["lcm-gen", "-p", "--ppath", str(out), *sources])
    elif made.is_dir():
        shutil.copytree(made, out / "kcm", ignore=shutil.ignore_patterns("__pycache__"))
    return (out / "kcm").is_dir()


# --------------------------------------------------------------------------- the processes


def _has_header(*flags: str) -> bool:
    """Whether the compiler finds a header: flags are -include HEADER and where to look."""
    try:
        return not subprocess.run(
            [CXX, "-x", "c++", "-E", *flags, "/dev/null"], capture_output=True
        ).returncode
    except FileNotFoundError:
        return False


def _lcm_types(work: Path) -> list[str]:
    """Object files of the message types; their headers lie in work/gen."""
    gen = work / "gen"
    gen.mkdir(parents=True)
    sources = [str(p) for p in sorted((ROOT / "fsw" / "msg").glob("*.lcm"))]
    _run(["lcm-gen", "-c", "--c-cpath", str(gen), "--c-hpath", str(gen), *sources])
    return _compile(work / "types", sorted(gen.glob("*.c")), [f"-I{gen}"])


def _flight_process(out: Path, work: Path, core: list[str], types: list[str]) -> None:
    """kincal-fsw in out."""
    include = [f"-I{ROOT / 'fsw' / layer}" for layer in LAYERS] + [f"-I{ROOT / 'fsw' / 'lcm'}"]
    edge = _compile(
        work / "edge", sorted((ROOT / "fsw" / "lcm").glob("*.c")), [*include, f"-I{work / 'gen'}"]
    )
    _run([CXX, *edge, *types, *core, "-llcm", "-lm", "-o", str(out / "kincal-fsw")])


def _detector(out: Path, work: Path, types: list[str]) -> None:
    """kincal-tagdet in out."""
    folder = ROOT / "sim" / "tagdet"
    sources = sorted([*folder.glob("*.c"), *folder.glob("*.cpp")])
    include = [f"-I{folder}", f"-I{work / 'gen'}", *OPENCV]
    objects = _compile(work / "tagdet", sources, include, ("-std=c++17",))  # OpenCV needs exceptions
    libraries = [f"-lopencv_{name}" for name in ("calib3d", "imgcodecs", "imgproc", "core")]
    _run([CXX, *objects, *types, "-lapriltag", *libraries, "-llcm", "-lm", "-o", str(out / "kincal-tagdet")])


def _programs(out: Path, work: Path, core: list[str]) -> None:
    """The processes of a simulated run in out, or for each a note NAME.missing that says what was not there
    to build it with."""
    lcm = [] if shutil.which("lcm-gen") else ["lcm-gen"]
    lcm += [] if _has_header("-include", "lcm/lcm.h") else ["lcm/lcm.h"]
    seen = [] if _has_header("-include", "apriltag/apriltag.h") else ["apriltag/apriltag.h"]
    seen += [] if _has_header("-include", "opencv2/calib3d.hpp", *OPENCV) else ["opencv2/calib3d.hpp"]
    types = [] if lcm else _lcm_types(work)
    for name, missing in (("kincal-fsw", lcm), ("kincal-tagdet", lcm + seen)):
        if missing:
            note = f"when it was built, {', '.join(missing)} was not there"
            (out / f"{name}.missing").write_text(note)
            print(f"kincal: no {name}: {note}", file=sys.stderr)
        elif name == "kincal-fsw":
            _flight_process(out, work, core, types)
        else:
            _detector(out, work, types)


# --------------------------------------------------------------------------- the archive


def _metadata(project: dict) -> str:
    lines = ["Metadata-Version: 2.1", f"Name: {project['name']}", f"Version: {project['version']}"]
    lines += [f"Summary: {project['description']}", f"Requires-Python: {project['requires-python']}"]
    lines += [f"License: {project['license']['text']}"]
    lines += [f"Requires-Dist: {need}" for need in project["dependencies"]]
    for extra, needs in project["optional-dependencies"].items():
        lines += [f"Provides-Extra: {extra}"]
        lines += [f'Requires-Dist: {need}; extra == "{extra}"' for need in needs]
    return "\n".join(lines) + "\n"


def _digest(data: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def _below(folder: Path, suffixes: tuple[str, ...], name: str) -> dict[str, bytes]:
    """Files of a folder with these suffixes, named as they lie below `name`."""
    found = (p for p in sorted(folder.rglob("*")) if p.suffix in suffixes and "__pycache__" not in p.parts)
    return {f"{name}/{path.relative_to(folder).as_posix()}": path.read_bytes() for path in found}


def _sources() -> dict[str, bytes]:
    """The package, the glossary that its pages quote, and the part of the tree that a run needs."""
    files = _below(GROUND / "kincal", (".py", ".pyi", ".typed", ".toml", ".j2", ".css", ".js"), "kincal")
    files["kincal/pages/GLOSSARY.md"] = (ROOT / "docs" / "GLOSSARY.md").read_bytes()
    tree = {"sim/kincal_sim": (".py",), "sim/models": (".toml", ".yml"), "sim/scenarios": (".toml",),
            "tables/bin": (".tbl",), "tables/src": (".toml",)}  # fmt: skip
    for folder, suffixes in tree.items():
        files |= _below(ROOT / folder, suffixes, f"kincal/_tree/{folder}")
    return files


def _built() -> dict[str, bytes]:
    """What is compiled or generated: core, messages, processes."""
    files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as folder:
        core, messages, programs, work = (Path(folder, n) for n in ("core", "messages", "programs", "work"))
        for made in (core, messages, programs):
            made.mkdir()
        objects = _core(core, work)
        _programs(programs, work, objects)
        for name, parts in (("kincal/_core", core), ("kincal/_tree/build", programs)):
            files |= {f"{name}/{path.name}": path.read_bytes() for path in sorted(parts.iterdir())}
        if _messages(messages):
            files |= _below(messages / "kcm", (".py",), "kcm")
        else:
            print("kincal: no lcm-gen and no build/py: this wheel cannot read logs", file=sys.stderr)
    return files


def build_wheel(
    wheel_directory: str,
    config_settings: dict | None = None,  # noqa: ARG001  (PEP 517)
    metadata_directory: str | None = None,  # noqa: ARG001
) -> str:
    """Write the wheel into wheel_directory and return its name."""
    project = tomllib.loads((GROUND / "pyproject.toml").read_text("utf-8"))["project"]
    files = _sources() | _built()
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
    _archive(Path(wheel_directory, name), files)
    return name


def _archive(path: Path, files: dict[str, bytes]) -> None:
    """The same files give the same bytes: no date, fixed modes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            runs = name.endswith(".so") or data.startswith(b"\x7fELF")
            entry.external_attr = (0o100755 if runs else 0o100644) << 16
            archive.writestr(entry, data)


def build_sdist(sdist_directory: str, config_settings: dict | None = None) -> str:  # noqa: ARG001
    """PEP 517 asks for it; the core's sources are outside this folder, so there is none."""
    raise SystemExit("kincal: build a wheel from the whole source tree; there is no source distribution")
