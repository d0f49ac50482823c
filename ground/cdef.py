"""Write what cffi needs to know about a build of the flight core: its public headers, preprocessed.

    cdef.py -o build/kincal_cdef.h fsw/math fsw/model ...
    cdef.py -o build/kincal_ground_cdef.h -DKC_GROUND fsw/math fsw/model ground/native

cffi's parser takes plain declarations only: system headers, static inline functions and static
assertions go, macros that are whole numbers become `#define NAME 8`, other numbers a comment. Standard
library only, so that the core builds without the Python environment.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

# Empty stand-ins: cffi knows the names these headers declare.
SYSTEM_HEADERS = ("stdint.h", "stddef.h", "stdbool.h", "math.h", "string.h", "float.h", "assert.h")


def preprocess(text: str, dirs: list[Path], *options: str) -> str:
    """What the C preprocessor makes of a text, system headers taken as empty."""
    with tempfile.TemporaryDirectory() as fake:
        for name in SYSTEM_HEADERS:
            Path(fake, name).write_text("#define bool _Bool\n" if name == "stdbool.h" else "")
        command = [os.environ.get("CC", "gcc"), "-E", "-P", "-std=c11", "-nostdinc", f"-I{fake}"]
        command += [f"-I{d}" for d in dirs] + [*options, "-"]
        return subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout


def without_bodies(text: str) -> str:
    """Drop `static ...` definitions with a body, and static assertions."""
    text = re.sub(r'_Static_assert\s*\((?:[^()"]|"[^"]*"|\((?:[^()]|\([^()]*\))*\))*\)\s*;', "", text)
    out, i = [], 0
    for start in re.finditer(r"^static\b[^;{=]*\{", text, flags=re.M):
        if start.start() < i:
            continue
        out.append(text[i : start.start()])
        depth, i = 1, start.end()
        while depth:
            depth += {"{": 1, "}": -1}.get(text[i], 0)
            i += 1
    out.append(text[i:])
    return "".join(out)


def macros(includes: str, dirs: list[Path], *options: str) -> dict[str, int | float]:
    """Macros of the headers that are numbers, with their values."""
    defined = preprocess(includes, dirs, *options, "-dM")
    names = sorted(set(re.findall(r"^#define (K[CG]_\w+) +\S", defined, flags=re.M)))
    probe = includes + "".join(f'\nkc_probe "{name}" = {name};' for name in names)
    values: dict[str, int | float] = {}
    for name, expr in re.findall(
        r'^kc_probe "(\w+)" = (.*);$', preprocess(probe, dirs, *options), flags=re.M
    ):
        plain = re.sub(r"\b(0[xX][0-9a-fA-F]+|\d+)[uUlL]+\b", r"\1", expr)
        if re.fullmatch(r"[-+*()<>|&.\s\dxXa-fA-F]+", plain) and re.search(r"\d", plain):
            try:
                value = eval(plain, {"__builtins__": {}})  # noqa: S307  (digits and operators only)
            except (SyntaxError, NameError, TypeError):
                continue
            if isinstance(value, (int, float)):
                values[name] = value
    return values


def main() -> int:
    """Write the declarations; exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dirs", type=Path, nargs="+", help="header folders, lowest layer first")
    parser.add_argument("-D", dest="defines", action="append", default=[], help="as for the compiler")
    parser.add_argument("-o", dest="out", type=Path, required=True, help="file to write")
    given = parser.parse_args()
    dirs, options = given.dirs, [f"-D{name}" for name in given.defines]
    headers = [h for d in dirs for h in sorted(d.glob("k[cg]_*.h")) if not h.stem.endswith("_priv")]
    includes = "".join(f'#include "{h.name}"\n' for h in headers)

    lines = ["/* Made by ground/cdef.py from the public headers of fsw/; do not edit. */"]
    for name, value in macros(includes, dirs, *options).items():
        # cffi takes whole numbers only; kincal.flight reads the others from the comment
        lines.append(f"#define {name} {value}" if isinstance(value, int) else f"/* {name} = {value!r} */")
    lines.append(re.sub(r"\n{2,}", "\n", without_bodies(preprocess(includes, dirs, *options))).strip())
    given.out.write_text("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
