"""Start the console and keep it until it is stopped."""

from __future__ import annotations

import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from kincal.operate import recording
from kincal_shared.errors import BadInput

from .app import Console, make_app
from .bench import Bench
from .clearances import Clearances
from .desk import Desk
from .geometry import Geometry
from .guard import LOOPBACK, Access
from .memory import Memory
from .past import Past
from .patience import Patient, few_files
from .picture import Picture
from .shelf import Shelf
from .sources import Live, Recording
from .spaces import Spaces

PORT = 8674
FOLDER = Path("~/.kincal/console")
_RECENT = 5  # recordings that are looked through for old corrections


@dataclass(frozen=True)
class Options:
    """url: LCM network; log: a recording instead; port: 0: any free one; host: address to listen on; names:
    further names in the Host header; folder: what outlives the console;
    files: further files for the workbench; record: whether the link is recorded, into the folder
    `recordings`; seconds: how long it serves, None: until it is interrupted."""

    url: str
    tables_dir: Path
    key_file: Path | None
    journal: Path | None = None
    log: Path | None = None
    host: str = LOOPBACK[0]
    port: int = PORT
    names: tuple[str, ...] = ()
    timeout_s: float = 10.0
    folder: Path = FOLDER
    files: Path | None = None
    record: bool = True
    recordings: Path | None = None
    seconds: float | None = None


def serve(options: Options, ready: Callable[[Access], None]) -> None:
    """Serve until interrupted; ready: is given the address as soon as somebody listens there. BadInput if
    tables or recording cannot be read, or the port is taken."""
    few_files()
    geometry = Geometry(options.tables_dir)
    listening = _listen(options.host, options.port)
    access = Access(listening.getsockname()[1], (*LOOPBACK, *options.names))
    picture, bench = Picture(geometry), Bench(options.folder / "bench", options.files)
    source: AbstractContextManager[object] = nullcontext()
    recorded: AbstractContextManager[object] = nullcontext()
    clearances: AbstractContextManager[object] = nullcontext()
    home = options.folder.expanduser()
    shelf = Shelf(options.tables_dir, home / "made", home / "tables", None)
    spaces = Spaces(home / "space", shelf, geometry)
    if options.log is not None:
        recorded_log = Recording.read(options.log)
        past = Past("", None, home / "history", picture, shelf, None, (options.log,))
        console = Console(
            str(options.log), geometry, picture, None, recorded_log, bench, "", shelf, spaces, past
        )
    else:
        desk = Desk(
            options.url, options.key_file, options.journal, options.tables_dir, picture, options.timeout_s
        )
        shelf.desk = desk
        desk.clearances = Clearances(home / "clearance", lambda: (shelf.made / "space.toml",))
        clearances = desk.clearances
        desk.elsewhere = lambda: (
            options.tables_dir, shelf.made, shelf.read, *recording.recordings(options.recordings)[:_RECENT]
        )  # fmt: skip
        where = str((options.recordings or recording.FOLDER).expanduser()) if options.record else ""
        past = Past(options.url, options.recordings, home / "history", picture, shelf, desk)
        console = Console(options.url, geometry, picture, desk, None, bench, where, shelf, spaces, past)
        memory = Memory(options.folder, options.url)
        if found := memory.recall(picture):
            picture.note("info", "RECALLED", f"{found} messages of before this console was started")
        source = Live(options.url, picture, memory)
        recorded = _recording(options, picture) if options.record else recorded
    config = uvicorn.Config(
        make_app(console, access), log_level="error", access_log=False, server_header=False,
        proxy_headers=False, ws_max_size=1 << 16, timeout_graceful_shutdown=2, http=Patient,
    )  # fmt: skip
    # uvicorn raises the signal that ended it once more: without this the process would end before the rest
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with listening, recorded, source, bench, spaces, clearances:
        ready(access)
        if console.desk is not None:
            threading.Thread(target=_ask_for_journal, args=(console.desk,), daemon=True).start()
        server = uvicorn.Server(config)
        if options.seconds is not None:
            ends = threading.Timer(options.seconds, lambda: setattr(server, "should_exit", True))
            ends.daemon = True
            ends.start()
        server.run([listening])


def _ask_for_journal(desk: Desk) -> None:
    """As soon as flight is heard: is the journal missing?"""
    while desk.picture.newest("KC_HK") is None:
        time.sleep(1.0)
    desk.journal_missing()


@contextmanager
def _recording(options: Options, picture: Picture) -> Iterator[None]:
    """`kincal record` as long as the console runs; its end is said in the list of events."""
    process = recording.spawn(options.url, options.recordings)
    ends = threading.Event()

    def follow() -> None:
        status = process.wait()
        if not ends.is_set():
            picture.note(
                "error", "NOT_RECORDED", f"`kincal record` ended with status {status}: start it again"
            )

    threading.Thread(target=follow, daemon=True).start()
    try:
        yield
    finally:
        ends.set()
        process.terminate()
        process.wait()


def _listen(host: str, port: int) -> socket.socket:
    found = socket.socket(socket.AF_INET)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((host, port))
    except OSError as error:
        found.close()
        raise BadInput(
            f"nothing can listen there: {error.strerror}",
            f"{host}:{port}",
            "another console may be running; give --port N, 0 for any free one",
        ) from None
    found.listen(64)
    return found
