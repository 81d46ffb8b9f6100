"""Servers in processes of their own, and the processes that these start."""

import http.client
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

WORKER = b"drsplat.fronts.serving.worker"


def children_of(pid: int, command: bytes = WORKER) -> list[int]:
    """Those whose command line has `command` in it, of all threads of a process."""
    lists = (tasks.read_text().split() for tasks in Path(f"/proc/{pid}/task").glob("*/children"))
    children = sorted(int(child) for listed in lists for child in listed)
    return [child for child in children if command in Path(f"/proc/{child}/cmdline").read_bytes()]


def wait_for(true: Callable[[], Any]) -> None:
    for _ in range(600):
        if true():
            return
        time.sleep(0.1)
    raise AssertionError("it did not happen within a minute")


@contextmanager
def serving(*command: object, **given: Any) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A server of a verb on a free port, which listens, and its port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    line = [sys.executable, "-W", "ignore", "-m", "drsplat", *map(str, command), "--port", str(port)]
    server = subprocess.Popen(line, stdout=subprocess.DEVNULL, **given)
    try:
        wait_for(lambda: listens(port))
        yield server, port
    finally:
        server.terminate()
        server.wait(60)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def asked(port: int, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes]:
    """Status and body of an answer; 0 where there is none."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    try:
        sent = body if body is None else json.dumps(body)
        connection.request(method, path, sent, {"content-type": "application/json", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read()
    except OSError:
        return 0, b""
    finally:
        connection.close()
