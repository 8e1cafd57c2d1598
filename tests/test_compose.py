"""docker-compose.yml cannot be started everywhere, but it can be checked against the settings it uses."""

import re
from pathlib import Path

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


def test_compose_runs_redis_service_and_worker(compose):
    assert {"redis", "service", "worker"} <= set(compose["services"])


def test_compose_sets_only_settings_that_exist(compose):
    used = {name for service in compose["services"].values() for name in service.get("environment", {})}
    assert used
    assert {name for name in used if name.startswith("SILHOUETTE_")} <= known_settings()


def test_compose_settings_are_valid(compose, monkeypatch):
    from service.settings import ServiceSettings
    from worker.settings import WorkerSettings

    for role, model in (("service", ServiceSettings), ("worker", WorkerSettings)):
        for name, value in compose["services"][role]["environment"].items():
            monkeypatch.setenv(name, str(value))
        settings = model()
        assert settings.redis_url == "redis://redis:6379/0"
        assert str(settings.data_dir) == "/data"


def test_compose_without_keys_starts_and_is_published_on_this_machine_alone(compose, monkeypatch, tmp_path):
    from service.access.policy import startup_fault
    from service.settings import ServiceSettings

    for name, value in compose["services"]["service"]["environment"].items():
        monkeypatch.setenv(name, str(value))
    command = compose["services"]["service"]["command"]
    settings = ServiceSettings(host=command[command.index("--host") + 1], data_dir=tmp_path)
    assert startup_fault(settings) is None
    assert settings.insecure
    assert all(port.startswith("127.0.0.1:") for port in compose["services"]["service"]["ports"])


def test_compose_volumes_are_declared_and_shared_by_service_and_worker(compose):
    mounted = {role: [v.split(":")[0] for v in compose["services"][role]["volumes"]] for role in ("service", "worker", "redis")}
    assert {name for names in mounted.values() for name in names} <= set(compose["volumes"])
    assert set(mounted["service"]) & set(mounted["worker"])


def test_dockerfile_copies_every_package_and_only_what_exists(compose):
    dockerfile = (ROOT / compose["services"]["service"]["build"]["dockerfile"]).read_text()
    copied = {name.rstrip("/") for line in re.findall(r"^COPY (.+)$", dockerfile, re.M) for name in line.split()[:-1]}
    assert {"schemas", "geometry", "backend", "worker", "service", "client"} <= copied
    assert all((ROOT / name).exists() for name in copied)


def test_containers_run_modules_that_exist(compose):
    for role in ("service", "worker"):
        command = compose["services"][role]["command"]
        assert (ROOT / command[command.index("-m") + 1] / "__main__.py").exists()
