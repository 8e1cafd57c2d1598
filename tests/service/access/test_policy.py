"""When a service asks for keys, and when it must not start."""

import asyncio
import subprocess
import sys

import pytest

from backend.local_store import LocalStore
from schemas.access import NewKey
from service.access.keys import KeyStore
from service.access.policy import is_loopback, needs_keys, open_access, startup_fault
from service.settings import ServiceSettings


def settings(tmp_path, **fields):
    return ServiceSettings(data_dir=tmp_path, redis_url="unix:///nowhere", **fields)


def stored(tmp_path):
    return KeyStore(LocalStore(tmp_path / "store"))


@pytest.mark.parametrize(("host", "is_here"), [("127.0.0.1", True), ("127.8.8.8", True), ("::1", True), ("localhost", True)])
def test_addresses_of_this_machine(host, is_here):
    assert is_loopback(host) is is_here


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "8.8.8.8", "myhost", "localhost.example", ""])
def test_all_else_is_public(host):
    assert not is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "10.0.0.1"])
def test_a_public_service_without_keys_does_not_start(tmp_path, host):
    fault = startup_fault(settings(tmp_path, host=host))
    assert fault is not None
    assert host in fault and "silhouette keys add" in fault and "--insecure" in fault


def test_it_starts_with_a_key_or_when_told_or_here(tmp_path):
    assert startup_fault(settings(tmp_path)) is None
    assert startup_fault(settings(tmp_path, host="0.0.0.0", insecure=True)) is None
    assert startup_fault(settings(tmp_path, require_keys=True)) is not None
    stored(tmp_path).add(NewKey(name="first"))
    assert startup_fault(settings(tmp_path, host="0.0.0.0")) is None
    assert startup_fault(settings(tmp_path, require_keys=True)) is None


def test_whether_everyone_may_come_in(tmp_path):
    def is_open(**fields):
        return asyncio.run(open_access(settings(tmp_path, **fields), LocalStore(tmp_path / "store")).is_open())

    assert is_open() and is_open(host="0.0.0.0", insecure=True)
    assert not is_open(host="0.0.0.0") and not is_open(require_keys=True), "revoking the last key opens nothing"
    assert not is_open(require_keys=True, insecure=True)
    stored(tmp_path).add(NewKey(name="first"))
    assert not is_open() and not is_open(host="0.0.0.0", insecure=True), "keys that there are are asked for"


def test_needing_keys_does_not_depend_on_there_being_any(tmp_path):
    assert needs_keys(settings(tmp_path, host="0.0.0.0"))
    stored(tmp_path).add(NewKey(name="first"))
    assert needs_keys(settings(tmp_path, host="0.0.0.0")) and not needs_keys(settings(tmp_path))


def test_the_process_says_so_and_exits_with_2(tmp_path):
    command = [sys.executable, "-m", "service", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stdout) == (2, "")
    assert "silhouette keys add" in run.stderr and "Traceback" not in run.stderr
    assert not (tmp_path / "lock").exists(), "it did not get as far as its queue"


@pytest.mark.parametrize("text", ["shop.example", "https://shop.example/page", "ftp://a", "https://a.example,b"])
def test_an_origin_is_scheme_and_host(text, monkeypatch):
    monkeypatch.setenv("SILHOUETTE_CORS_ORIGINS", text)
    with pytest.raises(ValueError, match="no origin"):
        ServiceSettings()


def test_origins_come_with_commas(monkeypatch):
    monkeypatch.setenv("SILHOUETTE_CORS_ORIGINS", "https://a.example, http://localhost:5173")
    assert ServiceSettings().cors_origins == ("https://a.example", "http://localhost:5173")
    monkeypatch.setenv("SILHOUETTE_CORS_ORIGINS", "*")
    assert ServiceSettings().cors_origins == ("*",)
