"""Every route needs the scope it should: one that is new must be put into a table here."""

from schemas.access import Scope
from service.access.scopes import OPEN, is_picture, scope_of

WRITES = {("POST", "/v1/meshes"), ("DELETE", "/v1/meshes/{mesh_id}"), ("POST", "/v1/render"), ("POST", "/v1/silhouette")}
ADMINISTERS = {
    ("GET", "/v1/keys"),
    ("POST", "/v1/keys"),
    ("GET", "/v1/keys/{key_id}"),
    ("DELETE", "/v1/keys/{key_id}"),
    ("GET", "/metrics"),
}
READS_BY_POST = {
    ("POST", "/v1/meshes/{mesh_id}/render"),
    ("POST", "/v1/meshes/{mesh_id}/silhouette"),
    ("POST", "/v1/meshes/{mesh_id}/frames"),
    ("POST", "/v1/scenes/render"),
    ("POST", "/v1/sign"),
}


def filled(path):
    return path.replace("{mesh_id}", "0" * 32).replace("{key_id}", "0" * 16).replace("{suffix}", "png").replace("{name}", "hull.glb")


def test_each_route_needs_the_scope_that_the_tables_say(routes):
    found = {scope: {(m, p) for m, p in routes if p not in OPEN and scope_of(m, filled(p)) is scope} for scope in Scope}
    assert found[Scope.WRITE] == WRITES
    assert found[Scope.ADMIN] == ADMINISTERS
    assert {(m, p) for m, p in found[Scope.READ] if m != "GET"} == READS_BY_POST


def test_what_no_table_knows_is_not_for_readers():
    assert scope_of("POST", "/v1/anything") is Scope.WRITE
    assert scope_of("PATCH", "/v1/meshes/x/render/more") is Scope.WRITE
    assert scope_of("GET", "/metrics") is Scope.ADMIN
    assert scope_of("GET", "/v1/keys/") is Scope.ADMIN


def test_only_health_is_open():
    assert {"/healthz", "/readyz"} == OPEN


def test_all_that_draws_counts_as_work_and_nothing_else(routes):
    work = {path for _, path in routes if is_picture(filled(path))}
    assert work == {
        *("/v1/render", "/v1/silhouette", "/v1/scenes/render"),
        *(f"/v1/meshes/{{mesh_id}}/{name}" for name in ("render", "render.{suffix}", "thumbnail.{suffix}", "silhouette")),
        *(
            f"/v1/meshes/{{mesh_id}}/{name}"
            for name in ("turntable.{suffix}", "frames", "silhouette.{suffix}", "accuracy", "accuracy.svg", "artifacts/{name}")
        ),
    }
    assert not is_picture("/v1/meshes/x/artifacts/normal.png")
