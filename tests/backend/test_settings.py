from pathlib import Path

import pytest
from pydantic import ValidationError

from backend.settings import BackendSettings


def test_defaults_need_nothing(monkeypatch):
    for name in BackendSettings.model_fields:
        monkeypatch.delenv(f"SILHOUETTE_{name.upper()}", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", "/somewhere")
    settings = BackendSettings()
    assert settings.data_dir == Path("/somewhere/silhouette")
    assert settings.store_dir == Path("/somewhere/silhouette/store")
    assert settings.redis_url is None


def test_the_environment_is_read_when_an_instance_is_made(monkeypatch):
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", "/data")
    monkeypatch.setenv("SILHOUETTE_STORE_URL", "file:///mnt/with%20space")
    settings = BackendSettings()
    assert settings.store_dir == Path("/mnt/with space")
    monkeypatch.setenv("SILHOUETTE_STORE_URL", "")
    assert BackendSettings().store_dir == Path("/data/store")


@pytest.mark.parametrize("url", ["s3://bucket/prefix", "http://x", "/plain/path"])
def test_a_store_that_is_not_supported_is_refused_clearly(url):
    with pytest.raises(ValidationError, match="not supported"):
        BackendSettings(store_url=url)
