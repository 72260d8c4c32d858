"""`gpdf` and `python` as a reader's shell finds them, forked of a process that has loaded what computes.

A command of a page takes two seconds of a processor, and nearly all of it to load; how long that takes, and that
`gpdf` begins by itself, other tests tell (`tests/packaging`, `tests/test_first_run.py`).
"""

import gc
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module

ASKS = """#!{python} -IS
import json, os, signal, socket, sys
with socket.socket(socket.AF_UNIX) as work:
    work.connect({path!r})
    words = ["-m", "gpdf_service.cli", *sys.argv[1:]] if sys.argv[0].endswith("gpdf") else sys.argv[1:]
    asked = json.dumps([words, os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(work, [len(asked).to_bytes(4, "big")], [0, 1, 2])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: work.sendall(bytes([number])))
    work.sendall(asked)
    sys.exit((work.recv(1) or b"\\x01")[0])
"""
"""Hands words, folder, environment and streams over, then signals, and ends with the exit code."""


@contextmanager
def forking(folder):
    """A folder with a `gpdf` and a `python` for a PATH, while there is somebody to fork them."""
    path = str(folder / "work")
    for name in ("gpdf", "python"):
        (folder / name).write_text(ASKS.format(python=sys.executable, path=path))
        (folder / name).chmod(0o755)
    with socket.socket(socket.AF_UNIX) as asked:
        asked.bind(path)
        asked.listen()
        process = subprocess.Popen([sys.executable, __file__, str(asked.fileno())], pass_fds=[asked.fileno()])
    with process:
        yield folder
        process.kill()


def serve(asked):
    """Fork for each who asks."""
    for name in ("matplotlib.pyplot", "open3d"):
        import_module(name)
    from gpdf_service.service import plan_process

    plan_process.prepare()
    gc.freeze()  # what is here already is nobody's garbage
    attending = set()
    while True:
        work, _ = asked.accept()
        attending -= {pid for pid in attending if os.waitpid(pid, os.WNOHANG) != (0, 0)}
        attending.add(pid := os.fork())
        if pid == 0:
            asked.close()
            return attend(work)
        work.close()


def attend(work):
    """Fork one that runs; hand signals on to it, and tell its end. Who asked and is gone needs it no more."""
    size, streams, _, _ = socket.recv_fds(work, 4, 3)
    said = work.recv(int.from_bytes(size, "big"), socket.MSG_WAITALL)
    child = os.fork()
    if child == 0:
        work.close()
        return run(*json.loads(said), streams)
    ended = os.pidfd_open(child)
    while ended not in select.select([work, ended], [], [])[0]:
        os.kill(child, (work.recv(1) or bytes([signal.SIGKILL]))[0])
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    work.sendall(bytes([code % 256]))
    os._exit(0)


def run(words, folder, environment, streams):
    """As `python WORDS` would, in a folder and an environment, with these as standard streams."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = words[1:]
    if words[0] == "-m":
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})  # python -c


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
