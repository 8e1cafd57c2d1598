"""Keys by the command and the client: on this machine, over HTTP, and what a service that asks for one says without."""

import json
import subprocess

import pytest

from client import Client
from client.errors import ForbiddenError, QuotaError, RequestError, UnauthorizedError
from client.local import LocalKeys, LocalServiceError
from schemas.access import Scope
from tests import plain_http
from tests.client import command


def silhouette(*arguments, **options):
    """The command, with what it wrote as text."""
    done = command.silhouette(*arguments, **options)
    return subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())


def test_the_first_key_is_made_where_no_service_runs(tmp_path):
    here = ("--data-dir", tmp_path)
    assert "No keys yet" in silhouette("keys", "list", *here).stderr
    limits = ("--requests-per-minute", 60, "--max-pixels", 10000, "--expires-in-days", 2)
    run = silhouette("keys", "add", "my laptop", "--scope", "read", "--scope", "write", *limits, *here)
    assert run.returncode == 0, run.stderr
    made = json.loads(run.stdout)
    assert made["token"].startswith(f"sil_{made['id']}_") and made["limits"] == {"requests_per_minute": 60, "max_pixels": 10000}
    (listed,) = json.loads(silhouette("keys", "list", "--json", *here).stdout)
    assert listed == {name: value for name, value in made.items() if name != "token"}
    table = silhouette("keys", "list", *here).stdout
    assert "my laptop" in table and made["id"] in table and made["token"] not in table
    assert silhouette("keys", "revoke", made["id"], *here).returncode == 0
    again = silhouette("keys", "revoke", made["id"], *here)
    assert again.returncode == 1 and again.stderr.startswith("error There is no such key")


@pytest.mark.parametrize("verb", ["add", "list", "revoke"])
def test_help_of_the_commands_about_keys_has_an_example(verb):
    assert silhouette("keys", verb, "--help").stdout.count(f"silhouette keys {verb}") >= 2


def test_a_key_that_makes_no_sense_is_one_line(tmp_path):
    with pytest.raises(LocalServiceError, match="name"):
        LocalKeys(tmp_path).add_key("")
    run = silhouette("keys", "add", "x", "--scope", "read", "--max-pixels", 0, "--data-dir", tmp_path)
    assert (run.returncode, len(run.stderr.splitlines())) == (1, 1)
    assert "max_pixels" in run.stderr


def test_keys_are_made_listed_and_revoked_over_http(guarded):
    there = {"SILHOUETTE_URL": guarded.running.url, "SILHOUETTE_API_KEY": guarded.tokens["admin"]}
    run = silhouette("keys", "add", "over HTTP", "--scope", "read", env=there)
    assert run.returncode == 0, run.stderr
    made = json.loads(run.stdout)
    assert made["id"] in [key["id"] for key in json.loads(silhouette("keys", "list", "--json", env=there).stdout)]
    with Client(guarded.running.url, key=made["token"]) as reader:
        list(reader.list(1))
        with pytest.raises(ForbiddenError, match="admin"):
            reader.keys()
    with Client(guarded.running.url, key=guarded.tokens["admin"]) as admin:
        other = admin.add_key("by the client", scopes=[Scope.WRITE], limits={"max_faces": 5})
        assert (other.scopes, other.limits.max_faces) == (["write"], 5)
        admin.revoke_key(other.id)
        assert silhouette("keys", "revoke", made["id"], env=there).returncode == 0
        left = admin.keys()
        assert {made["id"], other.id}.isdisjoint(key.id for key in left)


def test_a_command_takes_its_key_from_the_option_or_the_environment(guarded, guarded_cube, tmp_path):
    url, token = ("--url", guarded.running.url), guarded.tokens["reader"]
    without = silhouette("list", *url)
    assert without.returncode == 1 and "API key" in without.stderr
    assert guarded_cube.id in silhouette("list", "--json", *url, "--key", token).stdout
    drawn = silhouette("render", guarded_cube.id, "-o", tmp_path / "c.png", "--size", 32, *url, env={"SILHOUETTE_API_KEY": token})
    assert drawn.returncode == 0, drawn.stderr
    refused = silhouette("delete", guarded_cube.id, *url, "--key", token)
    assert refused.returncode == 1 and "scope write" in refused.stderr
    assert token not in refused.stderr + without.stderr


def test_a_signed_address_from_command_and_client_works_without_a_key(guarded, guarded_cube):
    address = f"/v1/meshes/{guarded_cube.id}/thumbnail.png?size=32"
    run = silhouette("sign", address, "--expires", 60, "--url", guarded.running.url, "--key", guarded.tokens["reader"])
    assert run.returncode == 0, run.stderr
    with Client(guarded.running.url, key=guarded.tokens["reader"]) as reader:
        for whole in (run.stdout.strip(), reader.sign(address)):
            assert plain_http.get(whole).content[:4] == b"\x89PNG"
        with pytest.raises(RequestError, match="signed"):
            reader.sign("/v1/meshes")


def test_the_clients_errors_are_typed(guarded, monkeypatch):
    monkeypatch.delenv("SILHOUETTE_API_KEY", raising=False)
    with Client(guarded.running.url) as nobody, pytest.raises(UnauthorizedError):
        next(nobody.list())
    with Client(guarded.running.url, key=guarded.tokens["two"]) as hasty, pytest.raises(QuotaError) as over:
        for _ in range(3):
            list(hasty.list(1))
    assert 0 < over.value.retry_after_s <= 60
    monkeypatch.setenv("SILHOUETTE_API_KEY", guarded.tokens["reader"])
    with Client(guarded.running.url) as reader:
        list(reader.list(1))
