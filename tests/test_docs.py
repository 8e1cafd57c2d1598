"""Documentation is complete: a route, setting, command or error without a word about it fails here."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from schemas import errors

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"


def test_every_route_is_documented(routes):
    text = (DOCS / "api.md").read_text()
    paths = {path for _, path in routes}
    assert paths
    assert [path for path in sorted(paths) if path not in text] == []


def test_every_setting_is_documented():
    from service.settings import ServiceSettings
    from worker.settings import WorkerSettings

    text = (DOCS / "settings.md").read_text()
    names = {f"SILHOUETTE_{name.upper()}" for model in (ServiceSettings, WorkerSettings) for name in model.model_fields}
    assert [name for name in sorted(names) if f"`{name}`" not in text] == []


def test_documented_settings_exist():
    from service.settings import ServiceSettings
    from worker.settings import WorkerSettings

    names = {f"SILHOUETTE_{name.upper()}" for model in (ServiceSettings, WorkerSettings) for name in model.model_fields}
    assert set(re.findall(r"`(SILHOUETTE_[A-Z_]+)`", (DOCS / "settings.md").read_text())) <= names


def test_every_error_code_class_is_documented():
    text = (DOCS / "api.md").read_text()
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.SilhouetteError)]
    private = {errors.SilhouetteError, errors.CancelledError}
    assert [kind.code for kind in kinds if kind not in private and f"`{kind.code}`" not in text] == []


@pytest.mark.parametrize("page", sorted(p.name for p in [*DOCS.glob("*.md"), ROOT / "README.md"]))
def test_links_and_pictures_of_the_documentation_exist(page):
    path = ROOT / page if page == "README.md" else DOCS / page
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text())
    assert [t for t in targets if not (path.parent / t).exists()] == []


@pytest.mark.parametrize(("page", "fewest"), [("numerics.md", 30), ("hostile.md", 25)])
def test_tests_named_by_a_page_exist(page, fewest):
    named = re.findall(r"`([a-z_/]+\.py)::(test_\w+)`", (DOCS / page).read_text())
    assert len(named) > fewest
    assert [(file, test) for file, test in named if f"def {test}(" not in (ROOT / "tests" / file).read_text()] == []


def test_the_page_about_access_has_every_scope_limit_and_way_to_be_refused():
    from schemas.access import KeyLimits, Scope
    from service.settings import ServiceSettings

    text, api = (DOCS / "access.md").read_text(), (DOCS / "api.md").read_text()
    words = [*(scope.value for scope in Scope), *KeyLimits.model_fields, errors.QuotaError.code]
    settings = [f"SILHOUETTE_{name.upper()}" for name in KeyLimits.model_fields if name in ServiceSettings.model_fields]
    assert len(settings) == len(KeyLimits.model_fields)
    assert [word for word in (*words, *settings) if f"`{word}`" not in text] == []
    assert [name for name in KeyLimits.model_fields if name not in api] == []


def test_every_code_of_a_refusal_is_documented():
    codes = {
        code
        for path in (ROOT / "service" / "access").glob("*.py")
        for code in re.findall(r'Error\([^\n]*code="([a-z-]+)"', path.read_text())
    }
    assert {"missing-scope", "signature-wrong", "signature-expired"} <= codes
    assert [code for code in sorted(codes) if f"`{code}`" not in (DOCS / "api.md").read_text()] == []


@pytest.mark.parametrize("target", ["setup", "demo", "test", "bench", "check", "serve"])
def test_make_targets_named_in_the_readme_exist(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)
    assert f"make {target}" in (ROOT / "README.md").read_text()


def test_command_help_teaches_every_command():
    top = subprocess.run([sys.executable, "-m", "client.cli", "--help"], capture_output=True, text=True, check=True).stdout
    for command in ("serve", "worker", "demo", "doctor", "upload", "render", "silhouette", "keys", "sign"):
        assert command in top


def test_every_code_of_a_refused_upload_is_documented():
    from worker.loading.faults import CODES

    text = (DOCS / "api.md").read_text()
    assert [code for code in sorted(CODES) if f"`{code}`" not in text] == []


def test_the_page_about_operation_has_every_metric_and_no_other():
    sources = [path.read_text() for path in (ROOT / "service" / "observing").glob("*.py")]
    named = {name for text in sources for name in re.findall(r'"(silhouette_[a-z_]+)"', text)}
    documented = set(re.findall(r"`(silhouette_[a-z_]+)`", (DOCS / "observability.md").read_text()))
    assert len(named) > 12
    assert {name.removesuffix("_total") for name in documented} == named


def test_the_page_about_operation_has_every_check_of_readiness():
    from service.routes.health import CHECKS

    text = (DOCS / "observability.md").read_text()
    assert [name for name in CHECKS if name not in text] == []
