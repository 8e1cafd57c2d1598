"""The doctor finds what is wrong on purpose, says how to mend it, and is content with this machine."""

import json
import os
import resource
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from service.doctor import backend, machine
from service.doctor.__main__ import CHECKS, examined
from service.settings import ServiceSettings

ROOT = Path(__file__).resolve().parents[3]


def settings(tmp_path, **given):
    return ServiceSettings(data_dir=tmp_path / "data", **{"port": 0, **given})


def run(tmp_path, *arguments, **environment):
    command = [sys.executable, "-m", "service.doctor", "--data-dir", str(tmp_path / "data"), *arguments]
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SILHOUETTE_")}
    return subprocess.run(command, cwd=ROOT, env=kept | environment, capture_output=True, text=True, check=False, timeout=200)


def test_a_sound_machine_is_found_sound(tmp_path):
    done = run(tmp_path, "--json", "--port", "0")
    told = json.loads(done.stdout)
    assert done.returncode == 0, told
    assert told["ok"] and [one["name"] for one in told["checks"]] == list(CHECKS)
    assert all(one["state"] != "failed" and one["found"] for one in told["checks"])


def test_the_table_says_what_is_wrong_and_how_to_mend_it(tmp_path):
    done = run(tmp_path, "--port", "0", SILHOUETTE_REDIS_URL="redis://:secret@127.0.0.1:1/0")
    assert done.returncode == 1
    assert "failed" in done.stdout and "fix: start that server" in " ".join(done.stdout.split())
    assert "secret" not in done.stdout + done.stderr


def test_settings_that_cannot_be_used_are_named(tmp_path):
    done = run(tmp_path, SILHOUETTE_REDIS_URL="http://x")
    assert (done.returncode, done.stderr) == (2, "setting redis_url: a Redis is named by redis://, rediss:// or unix://\n")


def test_a_given_server_is_asked_for_its_version(tmp_path, redis_url):
    found = backend.check_queue(settings(tmp_path, redis_url=redis_url))
    assert found.state == "ok" and "Redis 7" in found.found


def test_a_server_that_drops_keys_is_refused(tmp_path, connection, redis_url):
    connection.config_set("maxmemory-policy", "allkeys-lru")
    try:
        found = backend.check_queue(settings(tmp_path, redis_url=redis_url))
    finally:
        connection.config_set("maxmemory-policy", "noeviction")
    assert found.state == "failed" and "noeviction" in found.fix


def test_a_server_with_another_password_says_so(tmp_path, connection, redis_url):
    connection.config_set("requirepass", "open")
    try:
        found = backend.check_queue(settings(tmp_path, redis_url=redis_url))
    finally:
        connection.execute_command("AUTH", "open")
        connection.config_set("requirepass", "")
    assert found.state == "failed" and "password" in found.fix


def test_a_store_that_is_no_folder_is_found(tmp_path):
    (tmp_path / "data").write_text("a file")
    assert backend.check_store(settings(tmp_path)).state == "failed"


def test_a_store_without_room_is_found(tmp_path):
    assert backend.check_store(settings(tmp_path)).state == "ok"
    found = backend.check_store(settings(tmp_path, keep_free_mib=2**40))
    assert found.state == "failed" and "SILHOUETTE_KEEP_FREE_MIB" in found.fix


def test_checking_the_store_leaves_nothing_in_it(tmp_path):
    where = settings(tmp_path)
    backend.check_store(where)
    assert [path for path in where.store_dir.rglob("*") if path.is_file() and ".locks" not in path.parts] == []


def test_a_port_in_use_is_found_and_a_service_of_ours_is_told_apart(tmp_path, service):
    port = int(service.url.rpartition(":")[2])
    assert backend.check_port(settings(tmp_path, port=port)).found.endswith("a silhouette service answers there")
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(5.0)
        found = backend.check_port(settings(tmp_path, port=other.getsockname()[1]))
    assert found.state == "failed" and "--port" in found.fix


def test_a_public_address_without_a_key_is_found(tmp_path):
    found = backend.check_access(settings(tmp_path, host="0.0.0.0"))
    assert found.state == "failed" and "silhouette keys add" in found.fix


def test_few_open_files_are_a_warning(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, hard))
    try:
        found = machine.check_files(settings(tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert found.state == "warning" and "ulimit" in found.fix


def test_a_kernel_cache_without_a_place_is_a_warning(tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "taken"))
    assert machine.check_kernel_cache(settings(tmp_path)).state == "warning"


@pytest.mark.parametrize("error", [RuntimeError("odd"), OSError("disk"), KeyError("x")])
def test_a_check_that_breaks_is_a_finding(tmp_path, error):
    def breaks(_):
        raise error

    found = examined(breaks, settings(tmp_path))
    assert found.state == "failed" and type(error).__name__ in found.found
