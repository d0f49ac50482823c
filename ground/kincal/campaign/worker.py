"""The process that flies cases: `python -m kincal.campaign.worker`, JSON lines on standard input and output.

First line: what all cases share. Then a line a case, answered by a line. A process of its own, because a
case must not share flight core and simulator with another, and because what kills it then kills nothing
else. When the input ends, so does the process, also in the middle of a case: the command is gone."""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import gc  # noqa: E402
import json  # noqa: E402
import signal  # noqa: E402
import threading  # noqa: E402
from contextlib import suppress  # noqa: E402
from importlib import import_module  # noqa: E402
from pathlib import Path  # noqa: E402
from queue import SimpleQueue  # noqa: E402
from typing import Any, BinaryIO  # noqa: E402

from kincal.campaign import function  # noqa: E402
from kincal.results import Flown  # noqa: E402


def fly(shared: dict[str, Any], case: dict[str, Any]) -> dict[str, Any]:
    """The answer to a case: what was flown, or the error that ended it."""
    try:
        if shared["function"]:
            flown = function.fly(shared["function"], Path(shared["beside"]), case["changes"], case["seed"])
        else:
            flown = _calibration(shared, case)
    except Exception as error:  # noqa: BLE001 whatever a case dies of is its outcome
        text = f"{type(error).__name__}: {error}".encode("utf-8", "backslashreplace").decode()
        return {"index": case["index"], "error": text}
    return {"index": case["index"], **vars(flown)}


def _calibration(shared: dict[str, Any], case: dict[str, Any]) -> Flown:
    from kincal.run import dispersed  # a second of imports, which no function waits for

    folder = Path(str(case["changes"].get(dispersed.TABLES_KEY, shared["tables"])))
    log = Path(case["log"]) if case.get("log") else None
    return dispersed.fly(shared["scenario"], folder, case["changes"], case["seed"], log)


def _receive(source: BinaryIO, lines: SimpleQueue[bytes]) -> None:
    """Lines of the input; at its end, end this process with all that cases have started in its group."""
    for line in source:
        lines.put(line)
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            os.killpg(0, signal.SIGKILL)
    os._exit(0)


def main() -> None:
    """Serve until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which ends its workers
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    lines = SimpleQueue[bytes]()
    threading.Thread(target=_receive, args=(os.fdopen(os.dup(0), "rb"), lines), daemon=True).start()
    shared = json.loads(lines.get())
    if not shared["function"]:
        os.environ.setdefault("MUJOCO_GL", "disable")  # nothing is drawn, so no window system is loaded
        import_module("kincal.run.dispersed")  # what is loaded is what `software` finds, and is not collected
    here = function.software(shared["function"], Path(shared["beside"]))
    other = shared["software"] != here  # files changed since the command began
    gc.freeze()  # what is loaded stays: the collector need not walk it over and over
    while True:
        case = json.loads(lines.get())
        answer = {"index": case["index"], "other": True} if other else fly(shared, case)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
