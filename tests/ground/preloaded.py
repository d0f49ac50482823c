"""`kincal` forked from a process that has loaded what most commands need: a second of imports once, not for
each command of a page. Nothing here is loaded with the tests: it runs in environments of the wheel.

preloaded.py serve DOOR MODULES...     loads the modules, answers at the socket DOOR
preloaded.py ask DOOR WORDS...         `kincal WORDS`, in this folder, with these variables and streams"""

import json
import os
import socket
import sys


def ask(door, words, folder, env, streams=(0, 1, 2)):
    """The status of a command."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as at:
        at.connect(str(door))
        socket.send_fds(at, [json.dumps([[*words], str(folder), dict(env)]).encode()], streams)
        return at.recv(1)[0]


def end(door):
    """The process ends when its commands have ended."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as at:
        at.connect(str(door))


def serve(door, modules):
    import gc
    from importlib import import_module

    from kincal.cli import main

    for name in modules:
        import_module(name)
    gc.freeze()  # no child goes through what is loaded
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(door)
        listening.listen()
        print("listens", flush=True)
        while True:
            at, _ = listening.accept()
            said, streams, _, _ = socket.recv_fds(at, 1 << 18, 3)
            if not said:
                break
            if os.fork() == 0:
                answer(at, *json.loads(said), streams, main)
            for stream in streams:
                os.close(stream)
            at.close()
    while children():
        pass


def answer(at, words, folder, env, streams, main):
    """In a process of its own: one for the command, this one for its status."""
    child = os.fork()
    if child == 0:
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(env)
        main(words, prog_name="kincal")
        raise SystemExit("kincal returned")
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    at.send(bytes([status if status >= 0 else 128 - status]))
    os._exit(0)


def children():
    """Wait for one; False if there is none."""
    try:
        return os.wait()
    except ChildProcessError:
        return False


if __name__ == "__main__":
    what, door, *more = sys.argv[1:]
    sys.exit(serve(door, more) if what == "serve" else ask(door, more, os.getcwd(), os.environ))
