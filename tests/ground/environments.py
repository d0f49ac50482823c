"""Fresh environments: a wheel and the packages that it declares, linked from the environment of the tests, so
that no network is needed."""

import filecmp
import os
import re
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from importlib.metadata import distribution
from importlib.util import cache_from_source
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import preloaded
from packaging.requirements import Requirement
from places import ROOT


def clean(**env):
    """Variables of programs that know nothing of this tree."""
    hidden = ("PYTHONPATH", "KINCAL_CORE", "PYTHONHOME")
    return {k: v for k, v in os.environ.items() if k not in hidden} | env


def child(*command, cwd, **env):
    """What a command does that knows nothing of this tree."""
    words = [str(c) for c in command]
    return subprocess.run(words, cwd=cwd, env=clean(**env), capture_output=True, text=True, timeout=600)


def run(*command, cwd, **env):
    done = child(*command, cwd=cwd, **env)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def needs_of(lines, extras=()):
    """Names of the packages that Requires-Dist lines ask for here; those of extras only if asked for."""
    for need in map(Requirement, lines or ()):
        if need.marker is None or any(need.marker.evaluate({"extra": e}) for e in ("", *extras)):
            yield need.name


def closure(names):
    """These packages and all that they need."""
    found, todo = set(), list(names)
    while todo:
        name = re.sub(r"[-_.]+", "-", todo.pop()).lower()
        if name not in found:
            found.add(name)
            todo += needs_of(distribution(name).requires)
    return found


def link(names, site):
    """Installed packages, linked into another environment with what they were compiled to: folders as a whole
    where no other package of these has files in them."""
    owners = {}
    for name in names:
        for file in distribution(name).files:
            if ".." not in file.parts:
                owners.setdefault(file.parts[0], {}).setdefault(name, []).append(file)
    for top, of in owners.items():
        for name, files in of.items():
            there = distribution(name)
            source = Path(there.locate_file(top))
            if len(of) == 1 and source.is_dir() and top != "__pycache__":
                (site / top).symlink_to(source.resolve())
            else:
                link_files(there, files, site)


def link_files(there, files, site):
    for file in files:
        for part in (file, cache_from_source(file)) if file.suffix == ".py" else (file,):
            source, target = Path(there.locate_file(part)).resolve(), site / part
            if source.exists() and not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                target.symlink_to(source)


# Takes from a compilation what does not change its code (sed): compiler, outputs, debug data, warnings.
CODE = r"s#^[^ ]+ +##; s# -MD .* -c # -c #; s# -(g|Werror|fcallgraph-info=su)( |$)# #g; s# +# #g"
COMPILED = Path(__file__).with_name("compiled.sh")


def built_wheel(out):
    """The wheel, built as `pip install ./ground` does in an active environment with LCM's Python package: its
    lcm-gen stands first on the PATH, and does not work where pip builds. What `make build` has compiled from
    the same sources with the same flags is not compiled again."""
    shadow = out / "shadow" / "lcm-gen"
    shadow.parent.mkdir()
    shadow.write_text("#!/bin/sh\necho \"ModuleNotFoundError: No module named 'lcm'\" >&2\nexit 1\n")
    shadow.chmod(0o755)
    rel, build = ROOT / "build" / "rel", out / "build"
    calls = run("ninja", "-C", rel, "-t", "commands", "all", cwd=out).splitlines()
    calls = [call for call in calls if re.search(r" -o \S+ -c \S+$", call)]
    (out / "calls").write_text("\n".join(calls))
    keys = run("sed", "-E", CODE, out / "calls", cwd=out).splitlines()
    lines = [f"{key}\t{rel / call.split()[-3]}\n" for key, call in zip(keys, calls, strict=True)]
    (out / "compiled").write_text("".join(lines))
    settings = {f"cmake.define.CMAKE_{name}_COMPILER_LAUNCHER": COMPILED for name in ("C", "CXX")}
    words = [f"--config-settings={k}={v}" for k, v in ({"build-dir": build} | settings).items()]
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    run(*pip, *words, "--wheel-dir", out, ROOT / "ground", cwd=out,
        PATH=f"{shadow.parent}{os.pathsep}{os.environ['PATH']}",
        COMPILED=str(out / "compiled"), COMPILED_AS=f"{CODE}; s#{build}/#{ROOT}/build/#g")  # fmt: skip
    for made in ("gen", "gen-all", "made"):  # what both were compiled from
        there = filecmp.dircmp(build / made, ROOT / "build" / made)
        assert not there.diff_files + there.left_only
    (path,) = out.glob("kincal-*.whl")
    return path


def environment(home, wheel, extras=()):
    """A fresh environment with the wheel and what it declares for these extras."""
    run(sys.executable, "-m", "venv", "--without-pip", home, cwd=home)
    python = home / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip())
    metadata = next(n for n in zipfile.ZipFile(wheel).namelist() if n.endswith("METADATA"))
    lines = zipfile.ZipFile(wheel).read(metadata).decode().splitlines()
    declared = [line.partition(": ")[2] for line in lines if line.startswith("Requires-Dist")]
    link(closure(needs_of(declared, extras)), site)
    pip = [sys.executable, "-m", "pip", "--python", python]  # a pip of its own would take seconds
    run(*pip, "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=home)
    return home


PRELOADED = Path(preloaded.__file__)
COMMON = ("scipy.stats", "kincal.cli.command", "kincal.cli.model", "kincal.pages.review",
          "kincal.review.decisions", "kincal.workbench.diagnosis")  # fmt: skip
SIMULATOR = ("kincal.run.fast", "kincal.space")  # with their extras


@contextmanager
def loaded(home, *modules, **env):
    """A `kincal` of an environment that has loaded these modules: the socket at which it is asked."""
    with TemporaryDirectory() as folder:
        door = f"{folder}/door"
        serve = [home / "bin" / "python", PRELOADED, "serve", door, *COMMON, *modules]
        with subprocess.Popen(serve, cwd=folder, env=clean(**env), stdout=subprocess.PIPE) as process:
            try:
                assert process.stdout.readline() == b"listens\n"
                yield door
                preloaded.end(door)
            except BaseException:
                process.kill()
                raise


def as_function(home, door):
    """`kincal` for shells, by way of their environment."""
    return {"BASH_FUNC_kincal%%": f'() {{ {home}/bin/python -IS {PRELOADED} ask {door} "$@"; }}'}


def asked(door, folder, answers, calls):
    """Status, output and messages of commands of `kincal`, run one after the other in a folder."""
    done = []
    for number, words in enumerate(calls):
        files = [answers / f"{number}.{kind}" for kind in ("out", "err")]
        with open(os.devnull) as nothing, files[0].open("w") as out, files[1].open("w") as err:
            streams = [stream.fileno() for stream in (nothing, out, err)]
            status = preloaded.ask(door, words, folder, clean(), streams)
        done.append(
            SimpleNamespace(returncode=status, stdout=files[0].read_text(), stderr=files[1].read_text())
        )
    return done
