import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import redis

from backend.redis_connection import connect
from service.children import Child, Supervisor
from service.embedded import SOCKET_PATH_BYTES, EmbeddedBackend, StartupError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def backend(tmp_path):
    backend = EmbeddedBackend(tmp_path / "data", worker_count=0)
    backend.start()
    yield backend
    backend.stop()


def alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


def wait_until(condition, timeout_s=15.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        with contextlib.suppress(redis.RedisError):
            if result := condition():
                return result
        time.sleep(0.02)
    raise AssertionError("it did not happen in time")


def test_the_server_answers_and_runs_with_exactly_its_options(backend):
    assert connect(backend.redis_url).ping()
    folder = str(backend.data_dir)
    settings = connect(backend.redis_url).config_get("*")
    expected = {
        "port": "0",
        "unixsocket": f"{folder}/v.sock",
        "unixsocketperm": "700",
        "dir": f"{folder}/redis",
        "appendonly": "yes",
        "appendfsync": "everysec",
        "aof-use-rdb-preamble": "no",
        "aof-load-truncated": "yes",
        "save": "",
        "maxmemory": str(256 << 20),
        "maxmemory-policy": "noeviction",
    }
    assert {name: settings[name] for name in expected} == expected


def test_nothing_listens_on_the_network_and_the_socket_is_private(backend):
    socket = backend.data_dir / "v.sock"
    assert socket.is_socket()
    assert socket.stat().st_mode & 0o777 == 0o700


def test_stopping_leaves_no_process_and_keeps_the_data(tmp_path):
    first = EmbeddedBackend(tmp_path, worker_count=0)
    first.start()
    pid = first.pids()["valkey"]
    connect(first.redis_url).set("kept", "yes")
    first.stop()
    assert not alive(pid)
    second = EmbeddedBackend(tmp_path, worker_count=0)
    second.start()
    assert connect(second.redis_url).get("kept") == b"yes"
    second.stop()
    second.stop()


def test_a_folder_has_one_owner(backend):
    with pytest.raises(StartupError, match="another silhouette service"):
        EmbeddedBackend(backend.data_dir, worker_count=0).start()
    assert connect(backend.redis_url).ping()


def test_a_folder_that_cannot_be_made_is_said_in_a_sentence(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(StartupError, match="cannot use the data folder"):
        EmbeddedBackend(tmp_path / "taken" / "data", worker_count=0).start()


def test_a_path_too_long_for_a_socket_gets_another_place(tmp_path):
    folder = tmp_path / ("x" * (SOCKET_PATH_BYTES + 1))
    backend = EmbeddedBackend(folder, worker_count=0)
    backend.start()
    socket = Path(backend.redis_url.removeprefix("unix://"))
    assert len(os.fsencode(socket)) <= SOCKET_PATH_BYTES
    assert connect(backend.redis_url).ping()
    backend.stop()
    assert not socket.parent.exists()


def test_a_killed_server_is_started_again_with_its_data(backend):
    connection = connect(backend.redis_url)
    connection.set("kept", "yes")
    os.kill(backend.pids()["valkey"], signal.SIGKILL)
    assert wait_until(lambda: connection.get("kept")) == b"yes"


def test_a_killed_server_whose_folder_is_gone_is_started_again_empty(backend):
    connection = connect(backend.redis_url)
    connection.set("lost", "yes")
    for _ in range(2):
        server = backend.pids()["valkey"]
        shutil.rmtree(backend.data_dir / "redis")
        os.kill(server, signal.SIGKILL)
        wait_until(lambda server=server: backend.pids().get("valkey", server) != server)
        wait_until(connection.ping)
        assert connection.get("lost") is None
    assert not (backend.data_dir / "redis.unreadable").exists()


def append_only_file(backend):
    return next((backend.data_dir / "redis" / "appendonlydir").glob("*.incr.aof"))


def test_an_unreadable_file_is_moved_aside_and_the_server_starts_empty(tmp_path):
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    backend.start()
    for number in range(100):
        connect(backend.redis_url).set(f"key{number}", "x" * 100)
    file = append_only_file(backend)
    backend.stop()
    data = bytearray(file.read_bytes())
    data[1000:1100] = b"\xff" * 100
    file.write_bytes(data)
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    backend.start()
    assert connect(backend.redis_url).dbsize() == 0
    assert (tmp_path / "redis.unreadable" / "appendonlydir").is_dir()
    backend.stop()


def test_a_file_cut_off_by_a_crash_keeps_what_is_whole(tmp_path):
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    backend.start()
    for number in range(100):
        connect(backend.redis_url).set(f"key{number}", "x" * 100)
    file = append_only_file(backend)
    backend.stop()
    file.write_bytes(file.read_bytes()[:-30])
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    backend.start()
    assert connect(backend.redis_url).dbsize() == 99
    backend.stop()


def test_children_outlive_the_thread_that_started_the_backend(tmp_path):
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    thread = threading.Thread(target=backend.start)
    thread.start()
    thread.join()
    pid = backend.pids()["valkey"]
    time.sleep(0.3)
    assert alive(pid)
    assert backend.pids()["valkey"] == pid
    backend.stop()


OWNER = """
import sys, time
from pathlib import Path
from service.embedded import EmbeddedBackend
backend = EmbeddedBackend(Path(sys.argv[1]), worker_count=1, environment={"SILHOUETTE_WARM_KERNELS": "false", "SILHOUETTE_MEASURE": "0"})
backend.start()
while len(backend.pids()) < 2:
    time.sleep(0.01)
print(*backend.pids().values(), flush=True)
time.sleep(600)
"""


def test_nothing_survives_the_death_of_the_owner(tmp_path):
    owner = subprocess.Popen([sys.executable, "-c", OWNER, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    with owner:
        pids = [int(word) for word in owner.stdout.readline().split()]
        assert len(pids) == 3
        assert all(alive(pid) for pid in pids)
        owner.kill()
        wait_until(lambda: not any(alive(pid) for pid in pids), 5.0)
    backend = EmbeddedBackend(tmp_path, worker_count=0)
    backend.start()
    backend.stop()


def test_a_child_that_fails_at_once_is_started_again_ever_more_slowly(tmp_path):
    starts = tmp_path / "starts"
    supervisor = Supervisor()
    supervisor.start()
    supervisor.add(Child("failing", ("/bin/sh", "-c", f"date +%s.%N >> {starts}; exit 3")))
    time.sleep(2.5)
    supervisor.stop(1.0)
    times = [float(line) for line in starts.read_text().split()]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert 3 <= len(times) <= 6
    assert gaps[-1] > 1.5 * gaps[0]
    time.sleep(0.3)
    assert len(starts.read_text().split()) == len(times)


def test_a_child_that_ignores_the_signal_is_killed_in_time(tmp_path):
    supervisor = Supervisor()
    supervisor.start()
    ready = tmp_path / "ready"
    supervisor.add(Child("deaf", ("/bin/sh", "-c", f"trap '' TERM; touch {ready}; while :; do sleep 0.05; done")))
    wait_until(ready.exists)
    pid = supervisor.pids()["deaf"]
    started = time.monotonic()
    supervisor.stop(0.3)
    assert time.monotonic() - started < 2.0
    assert not alive(pid)
