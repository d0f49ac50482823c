"""What flight includes, and what the simulator must not.

    direction.py [ROOT]

C: headers by bare name, so that the compiler's include path decides which room sees which
(fsw/CMakeLists.txt); no clock, file, heap or stream header in the core; <math.h> only behind kc_libm.h, for
musl and in the Eigen shim; no circle among the files of a room, of includes between headers or of calls
between sources.
messages: only image_t has a part of variable length, at its end. The decoder that lcm-gen makes of one
believes what the message states about its size, so nobody calls that of image_t but the detector's frame.cpp,
which looks first.
sim: neither the simulator nor the detector loads flight code. Imports of Python are for import-linter
(tests/layers.ini); here only that no folder of ground and sim has more modules than one can look over.
"""

import re
import sys
from pathlib import Path

LIBM_HEADER = "fsw/math/kc_libm.h"
CORE_SYSTEM = {"assert.h", "float.h", "limits.h", "stdbool.h", "stddef.h", "stdint.h", "string.h"}
CORE_EXTRA = {
    LIBM_HEADER: {"math.h"},
    "fsw/musl/kc_musl_names.h": {"math.h"},
    "fsw/eigen": {
        "Eigen/Core",
        "Eigen/Dense",
        "Eigen/Cholesky",
        "Eigen/QR",
        "Eigen/SVD",
        "Eigen/LU",
        "Eigen/Eigenvalues",
        "Eigen/Householder",
        "math.h",
        "cmath",
        "cstdint",
        "cstring",
        "cstddef",
        "algorithm",
    },
}
FOREIGN = {"fsw/decide/kc_auth.c": {"monocypher.h"}}  # fetched (.ci/monocypher)
LIBM_ROOMS = ("eigen", "musl")
LIBM = re.compile(
    r"(?<![\w.>])(sin|cos|tan|asin|acos|atan|atan2|sqrt|exp|log|log1p|expm1|tanh|pow|fabs|hypot|fmod)\s*\("
)


def without_comments(text: str) -> str:
    """Comments and string contents blanked, line numbers kept; include lines stay whole."""
    text = re.sub(r"/\*.*?\*/", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.S)
    text = re.sub(r"//[^\n]*", "", text)
    include = r"(?m)^(?P<keep>\s*#\s*include[^\n]*)"
    return re.sub(include + r'|"(?:[^"\\\n]|\\.)*"', lambda m: m["keep"] or '""', text)


def made(root: Path) -> set[str]:
    """Headers that the build makes from the messages: those that they name, and what copies between both."""
    texts = [path.read_text() for path in root.glob("fsw/msg/*.lcm")]
    return {
        "kc_wire.h",
        *(name for text in texts for name in re.findall(r"^// Flight: \w+/(\w+\.h)", text, re.M)),
    }


def check_c(root: Path) -> list[str]:
    own = {h.name for h in [*root.glob("fsw/*/*.h"), *root.glob("ground/native/*.h")]} | made(root)
    faults = []
    for path in sorted(
        [*root.glob("fsw/*/*.[ch]"), *root.glob("fsw/*/*.cpp"), *root.glob("ground/native/*.[ch]")]
    ):
        layer, name = path.parent.name, path.relative_to(root).as_posix()
        core = layer != "lcm"
        extra = CORE_EXTRA.get(name, set()) | CORE_EXTRA.get(f"fsw/{layer}", set())
        text = without_comments(path.read_text())
        for n, line in enumerate(text.splitlines(), 1):
            if header := re.match(r'\s*#\s*include\s*"([^"]+)"', line):
                if header[1] not in own | FOREIGN.get(name, set()) and (
                    core or not re.match(r"kcm[_.]", header[1])
                ):
                    faults.append(f"{name}:{n}: {header[1]} is no header of fsw/ (headers go by bare name)")
            elif system := re.match(r"\s*#\s*include\s*<([^>]+)>", line):
                if core and system[1] not in CORE_SYSTEM | extra:
                    faults.append(f"{name}:{n}: <{system[1]}> is not for the core")
            elif core and layer not in LIBM_ROOMS and name != LIBM_HEADER and (call := LIBM.search(line)):
                faults.append(f"{name}:{n}: {call[1]}() instead of kc_{call[1]}() of kc_libm.h")
    return faults


DEFINED = re.compile(r"^(?!static)[a-z][\w \*]*\b(kc_\w+)\([^;{}]*\)\s*\{", re.M)


def needs(root: Path, room: str) -> dict[str, set[str]]:
    """Who needs whom among the files of a room: a header the headers that it includes, a source the sources
    whose functions it calls."""
    texts = {f: without_comments(f.read_text()) for f in sorted(root.glob(f"fsw/{room}/*.[ch]"))}
    home = {name: f.name for f, text in texts.items() if f.suffix == ".c" for name in DEFINED.findall(text)}
    found = {}
    for f, text in texts.items():
        if f.suffix == ".h":
            named = set(re.findall(r'#\s*include\s*"([^"]+)"', text)) & {g.name for g in texts}
        else:
            named = {home[name] for name in re.findall(r"\b(kc_\w+)\s*\(", text) if name in home}
        found[f.name] = named - {f.name}
    return found


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Files that lead from one back to itself, or nothing."""
    done: set[str] = set()

    def visit(at: str, before: list[str]) -> list[str]:
        if at in before:
            return [*before[before.index(at) :], at]
        if at in done:
            return []
        for then in sorted(graph[at]):
            if found := visit(then, [*before, at]):
                return found
        done.add(at)
        return []

    return next((found for start in sorted(graph) if (found := visit(start, []))), [])


def check_circles(root: Path) -> list[str]:
    rooms = sorted({f.parent.name for f in root.glob("fsw/*/*.[ch]")})
    found = {room: circle(needs(root, room)) for room in rooms}
    return [f"fsw/{room}: a circle: {' -> '.join(files)}" for room, files in found.items() if files]


def check_sim(root: Path) -> list[str]:
    """The simulator, its C and the detector know nothing of the flight core, in any language."""
    faults = []
    for path in sorted((root / "sim").rglob("*.py")):
        for n, line in enumerate(path.read_text().splitlines(), 1):
            if "libkincal" in line or "kincal_cdef" in line:
                faults.append(f"{path.relative_to(root)}:{n}: the simulator must not load the flight core")
    folders = ("sim/native", "sim/tagdet")
    for path in sorted(
        p for folder in folders for end in ("c*", "h*") for p in root.glob(f"{folder}/*.{end}")
    ):
        for n, line in enumerate(without_comments(path.read_text()).splitlines(), 1):
            if re.match(r'\s*#\s*include\s*"(kc_\w+\.h|.*fsw/)', line):
                faults.append(f"{path.relative_to(root)}:{n}: the simulator must not include flight code")
    return faults


MOST_MODULES = 25


def check_folders(root: Path) -> list[str]:
    """A folder with more modules than this holds several things."""
    folders = {path.parent for name in ("ground", "sim") for path in (root / name).rglob("*.py")}
    number = {folder: len(list(folder.glob("*.py"))) for folder in folders}
    return [
        f"{folder.relative_to(root)}: {n} modules in one folder; {MOST_MODULES} are the most"
        for folder, n in sorted(number.items())
        if n > MOST_MODULES
    ]


FIELD = re.compile(r"(?m)^\s*(?!const\b|package\b|struct\b)(\w+)\s+(\w+)\s*((?:\[\w+\])*)\s*;")
VARIABLE = {"image_t.lcm": "jpeg"}
READER = "sim/tagdet/frame.cpp"


def check_messages(root: Path) -> list[str]:
    """What a message states about its own size is believed nowhere."""
    faults = []
    for path in sorted(root.glob("fsw/msg/*.lcm")):
        fields = FIELD.findall(without_comments(path.read_text()))
        for n, (kind, name, dims) in enumerate(fields, 1):
            if kind != "string" and all(d.isdigit() for d in re.findall(r"\w+", dims)):
                continue
            if VARIABLE.get(path.name) != name or n < len(fields):
                faults.append(f"{path.relative_to(root)}: {name}: a message has a fixed size")
    for path in sorted([*root.glob("fsw/*/*.c"), *root.glob("sim/tagdet/*.[ch]pp")]):
        called = re.search(r"kcm_image_t_(decode|subscribe)\b", without_comments(path.read_text()))
        if called and path.relative_to(root).as_posix() != READER:
            faults.append(f"{path.relative_to(root)}: {called[0]}() believes n_bytes; read_frame() does not")
    return faults


def main() -> int:
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2]
    faults = check_c(root) + check_circles(root) + check_messages(root) + check_sim(root)
    faults += check_folders(root)
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
