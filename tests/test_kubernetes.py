"""deploy/kubernetes cannot be applied everywhere, but it can be checked against Kubernetes' schemas, our settings and itself."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from schemas.jobs import LATER_QUEUE, QUEUE, READER_FLAG
from service.settings import ServiceSettings
from tests.custom_resources import CUSTOM
from tests.test_compose import known_settings
from worker.loading.limits import LoadLimits
from worker.settings import WorkerSettings

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "deploy" / "kubernetes"
VERSIONS = ("1.30", "1.37")
"""Of Kubernetes: manifests have to be right for the oldest and the newest that we name in docs/kubernetes.md."""

ROLES = ("service", "worker", "reader")
IMAGE = "silhouette-service"
NOT_OURS = {"HOME", "NUMBA_CACHE_DIR"}
CREDENTIALS = {"silhouette-store": {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"}, "silhouette-redis": {"password"}}
UNITS = {"Ki": 2**10, "Mi": 2**20, "Gi": 2**30}
Manifest = dict[str, Any]


def bytes_of(quantity: str) -> int:
    """Of a quantity of memory as 512Mi."""
    number, unit = quantity[:-2], quantity[-2:]
    return int(number) * UNITS[unit]


def documents(folder: str) -> list[Manifest]:
    """Everything in a folder but patches and what kustomize reads itself."""
    listed = yaml.safe_load((FOLDER / folder / "kustomization.yaml").read_text())
    files = [FOLDER / folder / name for name in listed["resources"] if not name.startswith("..")]
    return [one for file in files for one in yaml.safe_load_all(file.read_text())]


@pytest.fixture(scope="module")
def manifests() -> list[Manifest]:
    return [one for folder in sorted(path.parent.name for path in FOLDER.glob("*/kustomization.yaml")) for one in documents(folder)]


@pytest.fixture(scope="module")
def named(manifests) -> dict[tuple[str, str], Manifest]:
    return {(one["kind"], one["metadata"]["name"]): one for one in manifests}


@pytest.fixture(scope="module")
def settings(named) -> dict[str, str]:
    return named["ConfigMap", "silhouette-settings"]["data"]


def pod_of(named, role: str) -> Manifest:
    return named["Deployment", f"silhouette-{role}"]["spec"]["template"]["spec"]


def container_of(named, role: str) -> Manifest:
    (container,) = pod_of(named, role)["containers"]
    return container


def grace_s(named, role: str) -> float:
    return next(float(v["value"]) for v in container_of(named, role)["env"] if v["name"] == "SILHOUETTE_STOP_GRACE_S")


def check(manifest: Manifest) -> None:
    """Raises the error of a manifest that has something unknown, misses something, or has it of another type."""
    if schema := CUSTOM.get(manifest["kind"]):
        jsonschema.validate(manifest, schema)
        return
    for version in VERSIONS:
        kubernetes_validate.validate(manifest, version, strict=True)


def test_every_manifest_is_what_kubernetes_takes(manifests):
    assert {one["kind"] for one in manifests} >= {"Deployment", "StatefulSet", "Ingress", "NetworkPolicy", "PodDisruptionBudget"}
    for manifest in manifests:
        check(manifest)


def test_a_manifest_with_a_misspelt_field_is_refused(named):
    wrong = yaml.safe_load(yaml.safe_dump(named["Deployment", "silhouette-service"]))
    wrong["spec"]["template"]["spec"]["terminationGracePeriod"] = 30
    with pytest.raises(kubernetes_validate.ValidationError):
        check(wrong)


def test_every_file_is_listed_and_every_listed_file_exists():
    for path in FOLDER.glob("*/kustomization.yaml"):
        listed = yaml.safe_load(path.read_text())
        patches = [patch["path"] for patch in listed.get("patches", []) if "path" in patch]
        names = [*listed["resources"], *listed.get("components", []), *patches]
        assert all((path.parent / name).exists() for name in names)
        assert {file.name for file in path.parent.glob("*.yaml")} == {name for name in names if not name.startswith("..")} | {path.name}


def test_patches_of_the_example_are_of_objects_and_settings_that_exist(named, settings):
    for patch in yaml.safe_load((FOLDER / "example" / "kustomization.yaml").read_text())["patches"]:
        changed = yaml.safe_load((FOLDER / "example" / patch["path"]).read_text())
        assert (changed["kind"], changed["metadata"]["name"]) in named
        assert set(changed.get("data", {})) <= known_settings()


def test_kustomize_makes_the_example(named):
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not on this machine")
    made = subprocess.run(["kubectl", "kustomize", FOLDER / "example"], capture_output=True, text=True, check=True, timeout=120)
    manifests = list(yaml.safe_load_all(made.stdout))
    assert {(one["kind"], one["metadata"]["name"]) for one in manifests} == set(named)
    for manifest in manifests:
        check(manifest)
        assert manifest["kind"] == "Namespace" or manifest["metadata"]["namespace"] == "silhouette"


def test_settings_exist_and_are_valid(named, settings, monkeypatch, tmp_path):
    assert set(settings) <= known_settings() | NOT_OURS
    (password := tmp_path / "password").write_text("secret\n")
    for name, value in {**settings, "SILHOUETTE_REDIS_PASSWORD_FILE": str(password)}.items():
        monkeypatch.setenv(name, value)
    for role, model in (("service", ServiceSettings), ("worker", WorkerSettings), ("reader", WorkerSettings)):
        monkeypatch.setenv("SILHOUETTE_STOP_GRACE_S", str(grace_s(named, role)))
        read = model()
        assert read.redis_password_file == password
        assert read.stop_grace_s == grace_s(named, role)


def test_no_secret_has_its_value_here_and_each_is_one_that_is_described(manifests):
    assert all(one["kind"] != "Secret" for one in manifests)
    text = "\n".join(path.read_text() for path in FOLDER.rglob("*.yaml"))
    known = {*CREDENTIALS, "silhouette-metrics", "silhouette-tls"}
    assert set(re.findall(r"secretName: (\S+)", text)) <= known
    told = (ROOT / "docs" / "kubernetes.md").read_text()
    assert all(name in told for name in known)
    for names in CREDENTIALS.values():
        assert all(name in told for name in names)


@pytest.mark.parametrize("role", ROLES)
def test_services_of_the_cluster_set_no_variables_of_pods(named, role):
    linked = {f"{name.upper()}_PORT" for kind, name in named if kind == "Service"}
    assert linked & known_settings()
    assert pod_of(named, role)["enableServiceLinks"] is False


@pytest.mark.parametrize("role", ROLES)
def test_compose_and_kubernetes_run_the_same_commands(named, role):
    composed = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    assert container_of(named, role)["command"] == composed["service-1" if role == "service" else role]["command"]
    assert (READER_FLAG in container_of(named, role)["command"]) == (role == "reader")


def test_trial_redis_has_the_flags_of_the_one_in_compose(named):
    composed = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]["redis"]
    (container,) = named["StatefulSet", "redis"]["spec"]["template"]["spec"]["containers"]
    assert container["image"] == composed["image"]
    assert " ".join(composed["command"]) in " ".join(container["args"][0].split())


def test_images_are_one_of_this_version(named):
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    pods = [pod_of(named, role) for role in ROLES]
    assert {one["image"] for pod in pods for one in (*pod["containers"], *pod["initContainers"])} == {f"{IMAGE}:{version}"}
    (image,) = yaml.safe_load((FOLDER / "example" / "kustomization.yaml").read_text())["images"]
    assert image["name"] == IMAGE
    assert image["newTag"] == version


def test_selectors_find_the_pods_they_are_for(named):
    for (kind, name), one in named.items():
        spec = one.get("spec", {})
        if kind in ("Deployment", "StatefulSet"):
            assert spec["selector"]["matchLabels"].items() <= spec["template"]["metadata"]["labels"].items()
        elif kind in ("Service", "PodDisruptionBudget", "PodMonitor"):
            selector = spec["selector"].get("matchLabels", spec["selector"])
            assert [found for found in labels_of_pods(named) if selector.items() <= found.items()], name
        elif kind == "NetworkPolicy":
            assert [found for found in labels_of_pods(named) if spec["podSelector"]["matchLabels"].items() <= found.items()], name
        elif kind in ("HorizontalPodAutoscaler", "ScaledObject"):
            assert ("Deployment", spec["scaleTargetRef"]["name"]) in named


def labels_of_pods(named) -> list[dict[str, str]]:
    return [one["spec"]["template"]["metadata"]["labels"] for (kind, _), one in named.items() if kind in ("Deployment", "StatefulSet")]


def test_pods_of_a_role_are_spread_by_their_own_labels(named):
    for role in ROLES:
        own = named["Deployment", f"silhouette-{role}"]["spec"]["selector"]["matchLabels"]
        assert [spread["labelSelector"]["matchLabels"] for spread in pod_of(named, role)["topologySpreadConstraints"]] == [own, own]
        assert named["PodDisruptionBudget", f"silhouette-{role}"]["spec"]["selector"]["matchLabels"] == own


def test_ports_lead_from_the_ingress_to_the_port_that_the_service_listens_on(named):
    container = container_of(named, "service")
    (port,) = container["ports"]
    command = container["command"]
    assert str(port["containerPort"]) == command[command.index("--port") + 1]
    (forwarded,) = named["Service", "silhouette"]["spec"]["ports"]
    assert forwarded["targetPort"] == port["name"]
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert container[probe]["httpGet"]["port"] == port["name"]
    (rule,) = named["Ingress", "silhouette"]["spec"]["rules"]
    backend = rule["http"]["paths"][0]["backend"]["service"]
    assert (backend["name"], backend["port"]["name"]) == ("silhouette", forwarded["name"])
    (endpoint,) = named["PodMonitor", "silhouette"]["spec"]["podMetricsEndpoints"]
    assert endpoint["port"] == port["name"]


def test_probes_ask_what_looks_at_dependencies_only_for_readiness(named):
    container = container_of(named, "service")
    assert container["livenessProbe"]["httpGet"]["path"] == container["startupProbe"]["httpGet"]["path"] == "/healthz"
    assert container["readinessProbe"]["httpGet"]["path"] == "/readyz"


@pytest.mark.parametrize("role", ROLES)
def test_pods_have_longer_to_end_than_they_take(named, role):
    asleep_s = float(container_of(named, role).get("lifecycle", {}).get("preStop", {}).get("exec", {}).get("command", [0])[-1])
    assert pod_of(named, role)["terminationGracePeriodSeconds"] >= asleep_s + grace_s(named, role) + 10


def test_a_service_that_stops_answers_what_it_has_begun(named):
    assert grace_s(named, "service") >= ServiceSettings().render_timeout_s


@pytest.mark.parametrize("role", ROLES)
def test_pods_may_do_nothing_that_they_need_not(named, role):
    pod = pod_of(named, role)
    assert pod["securityContext"]["runAsNonRoot"]
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert not pod["automountServiceAccountToken"]
    for container in (*pod["containers"], *pod["initContainers"]):
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }


def test_the_image_runs_as_the_user_of_the_pods_and_has_the_kernels_they_copy(named):
    dockerfile = (ROOT / "deploy" / "Dockerfile").read_text()
    for role in ROLES:
        pod = pod_of(named, role)
        assert f"--uid {pod['securityContext']['runAsUser']} silhouette" in dockerfile
        (kernels,) = pod["initContainers"]
        assert kernels["command"][-2].startswith(re.findall(r"NUMBA_CACHE_DIR=(\S+)", dockerfile)[0])
    assert "python -m worker.warm && python -m service.warm" in dockerfile


@pytest.mark.parametrize("role", ROLES)
def test_whatever_is_written_has_a_volume(named, settings, role):
    pod, container = pod_of(named, role), container_of(named, role)
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    writable = {mount["mountPath"]: volumes[mount["name"]] for mount in container["volumeMounts"] if not mount.get("readOnly")}
    assert set(writable) == {settings["SILHOUETTE_DATA_DIR"], settings["NUMBA_CACHE_DIR"], settings["HOME"]}
    assert settings["HOME"] == "/tmp"
    data = bytes_of(writable[settings["SILHOUETTE_DATA_DIR"]]["emptyDir"]["sizeLimit"])
    assert data > int(settings["SILHOUETTE_STORE_CACHE_MIB"]) * 2**20
    sizes = sum(bytes_of(volume["emptyDir"]["sizeLimit"]) for volume in writable.values())
    assert bytes_of(container["resources"]["limits"]["ephemeral-storage"]) >= sizes


@pytest.mark.parametrize("role", ["worker", "reader"])
def test_a_hostile_file_meets_the_limits_of_its_child_before_those_of_the_pod(named, role):
    limits = LoadLimits()
    assert bytes_of(container_of(named, role)["resources"]["limits"]["memory"]) > limits.memory_mib * 2**20
    (temporary,) = (volume for volume in pod_of(named, role)["volumes"] if volume["name"] == "temporary")
    assert bytes_of(temporary["emptyDir"]["sizeLimit"]) > limits.result_mib * 2**20


def test_the_number_of_workers_follows_the_queues_that_workers_listen_to(named):
    scaled = named["ScaledObject", "silhouette-worker"]["spec"]
    assert [trigger["metadata"]["listName"] for trigger in scaled["triggers"]] == [f"rq:queue:{QUEUE}", f"rq:queue:{LATER_QUEUE}"]
    for trigger in scaled["triggers"]:
        assert ("TriggerAuthentication", trigger["authenticationRef"]["name"]) in named
        host, _, port = trigger["metadata"]["address"].partition(":")
        assert str(named["Service", host]["spec"]["ports"][0]["port"]) == port


def test_metrics_and_settings_that_the_page_names_exist():
    text, metrics = (ROOT / "docs" / "kubernetes.md").read_text(), (ROOT / "docs" / "observability.md").read_text()
    named = set(re.findall(r"silhouette_[a-z_]+", text))
    assert len(named) > 8
    assert [name for name in sorted(named) if f"`{name}`" not in metrics] == []
    assert set(re.findall(r"SILHOUETTE_[A-Z_]+", text)) <= known_settings()


def test_workers_let_nobody_in(named):
    incoming = [one for (kind, _), one in named.items() if kind == "NetworkPolicy" and one["spec"].get("ingress")]
    opened = [one["spec"]["podSelector"]["matchLabels"] for one in incoming]
    for role in ("worker", "reader"):
        labels = named["Deployment", f"silhouette-{role}"]["spec"]["template"]["metadata"]["labels"]
        assert not [selector for selector in opened if selector.items() <= labels.items()]
    closed = named["NetworkPolicy", "silhouette-closed"]["spec"]
    assert set(closed["policyTypes"]) == {"Ingress", "Egress"}
    assert "ingress" not in closed
    assert "egress" not in closed


def test_the_ingress_passes_on_what_nginx_of_compose_passes_on(named):
    notes = named["Ingress", "silhouette"]["metadata"]["annotations"]
    configuration = (ROOT / "deploy" / "nginx.conf").read_text()
    assert f"client_max_body_size {notes['nginx.org/client-max-body-size']};" in configuration
    assert f"proxy_read_timeout {notes['nginx.org/proxy-read-timeout']};" in configuration
    assert notes["nginx.org/location-snippets"].strip() in configuration
    assert notes["nginx.org/proxy-buffering"] == "False"
