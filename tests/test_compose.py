"""docker-compose.yml cannot be started everywhere, but it can be checked against the settings it uses."""

import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def compose():
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())


def known_settings() -> set[str]:
    """Environment names that the service or a worker reads."""
    from service.settings import ServiceSettings
    from worker.settings import WorkerSettings

    return {f"SILHOUETTE_{name.upper()}" for model in (ServiceSettings, WorkerSettings) for name in model.model_fields}


OURS = ("service-1", "service-2", "worker", "reader")


def test_compose_runs_two_services_two_workers_a_reader_and_what_they_share(compose):
    assert {*OURS, "redis", "s3", "proxy"} <= set(compose["services"])
    assert compose["services"]["worker"]["deploy"]["replicas"] == 2


def test_compose_sets_only_settings_that_exist(compose):
    used = {name for service in compose["services"].values() for name in service.get("environment", {})}
    assert used
    assert {name for name in used if name.startswith("SILHOUETTE_")} <= known_settings()


def test_compose_settings_are_valid_and_alike(compose, monkeypatch, tmp_path):
    from backend.s3_store import S3Store
    from backend.stores import open_store
    from service.settings import ServiceSettings
    from worker.settings import WorkerSettings

    shared = compose["services"]["worker"]["environment"]
    assert all(compose["services"][role]["environment"].items() >= shared.items() for role in OURS)
    for role, model in (("service-1", ServiceSettings), ("worker", WorkerSettings)):
        for name, value in compose["services"][role]["environment"].items():
            monkeypatch.setenv(name, str(value))
        settings = model()
        assert settings.redis_url == "redis://redis:6379/0"
        assert str(settings.data_dir) == "/data"
        assert isinstance(open_store(settings.model_copy(update={"data_dir": tmp_path})), S3Store)


def test_the_s3_store_has_the_bucket_and_takes_the_keys_that_services_use(compose):
    services = compose["services"]
    used = services["worker"]["environment"]
    assert services["s3"]["environment"] == {
        "MINIO_ROOT_USER": used["AWS_ACCESS_KEY_ID"],
        "MINIO_ROOT_PASSWORD": used["AWS_SECRET_ACCESS_KEY"],
    }
    bucket = urlsplit(used["SILHOUETTE_STORE_URL"]).netloc
    assert services["bucket"]["entrypoint"][-1].endswith(f"s3/{bucket}")
    assert urlsplit(used["SILHOUETTE_STORE_ENDPOINT"]).hostname in services
    assert all("bucket" in services[role]["depends_on"] for role in OURS)


def test_volumes_are_declared_and_none_is_shared_by_services_and_workers(compose):
    mounted = {role: [v.split(":")[0] for v in service.get("volumes", []) if ":" in v] for role, service in compose["services"].items()}
    named = {name for names in mounted.values() for name in names if not name.startswith(".")}
    assert named == set(compose["volumes"])
    assert all(mounted[role] == [] and compose["services"][role]["volumes"] == ["/data"] for role in OURS)


def test_the_proxy_passes_on_to_every_service_and_only_it_is_reached_from_outside(compose):
    configuration = (ROOT / "deploy" / "nginx.conf").read_text()
    assert set(re.findall(r"server ([a-z0-9-]+):8000", configuration)) == {
        role for role in compose["services"] if role.startswith("service-")
    }
    assert [role for role, service in compose["services"].items() if "ports" in service] == ["proxy"]
    assert configuration.count("{") == configuration.count("}")
    for line in ("client_max_body_size 0;", "proxy_request_buffering off;", "proxy_buffering off;"):
        assert line in configuration
    source = next(volume.split(":")[0] for volume in compose["services"]["proxy"]["volumes"])
    assert (ROOT / source).is_file()


def test_compose_without_keys_starts_and_is_published_on_this_machine_alone(compose, monkeypatch, tmp_path):
    from service.access.policy import startup_fault
    from service.settings import ServiceSettings

    for name, value in compose["services"]["service-1"]["environment"].items():
        monkeypatch.setenv(name, str(value))
    command = compose["services"]["service-1"]["command"]
    settings = ServiceSettings(host=command[command.index("--host") + 1], data_dir=tmp_path)
    assert startup_fault(settings) is None
    assert settings.insecure
    assert compose["services"]["proxy"]["ports"] == ["127.0.0.1:8000:8000"]


def test_dockerfile_copies_every_package_and_only_what_exists(compose):
    dockerfile = (ROOT / compose["services"]["worker"]["build"]["dockerfile"]).read_text()
    copied = {name.rstrip("/") for line in re.findall(r"^COPY (.+)$", dockerfile, re.M) for name in line.split()[:-1]}
    assert {"schemas", "geometry", "backend", "worker", "service", "client"} <= copied
    assert all((ROOT / name).exists() for name in copied)


def test_containers_run_modules_that_exist(compose):
    for role in OURS:
        command = compose["services"][role]["command"]
        assert (ROOT / command[command.index("-m") + 1] / "__main__.py").exists()
