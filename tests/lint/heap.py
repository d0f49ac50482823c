"""No heap in the flight core: fails when its objects, linked together, still want a heap function.

    heap.py build/libkincal.a

Also names everything else the core wants from outside, and fails on anything but the memory functions it is
meant to use: a core that reads no clock and opens no file does not link to either, and one whose bits are the
same on every CPU does not link to a mathematics library.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

HEAP = re.compile(
    r"^(malloc|calloc|realloc|reallocarray|free|cfree|aligned_alloc|posix_memalign|memalign|valloc|pvalloc"
    r"|strdup|strndup|asprintf|vasprintf|getline|open_memstream|sbrk|brk|mmap|munmap|_Zn[wa].*|_Zd[la].*"
    r"|__cxa_allocate_exception|__cxa_throw)$"
)
# Memory functions, and what the linker puts in by itself. No mathematics: that is in the core.
ALLOWED = re.compile(r"^(memcpy|memmove|memset|memcmp|strlen|strncmp|strcmp|strnlen|_GLOBAL_OFFSET_TABLE_)$")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("archive", type=Path)
    archive = parser.parse_args().archive

    with tempfile.TemporaryDirectory() as work:
        whole = Path(work, "core.o")
        subprocess.run(["ld", "-r", "--whole-archive", str(archive), "-o", str(whole)], check=True)
        out = subprocess.run(["nm", "-u", str(whole)], capture_output=True, text=True, check=True).stdout
    wanted = sorted({line.split()[-1].split("@")[0] for line in out.splitlines()})

    heap = [name for name in wanted if HEAP.match(name)]
    strange = [name for name in wanted if not HEAP.match(name) and not ALLOWED.match(name)]
    print(f"  the core wants from outside: {' '.join(wanted)}")
    if heap:
        print(f"  FAIL heap functions: {' '.join(heap)}")
    if strange:
        print(f"  FAIL not for the core: {' '.join(strange)}")
    return 1 if heap or strange else 0


if __name__ == "__main__":
    sys.exit(main())
