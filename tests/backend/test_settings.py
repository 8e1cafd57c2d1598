from pathlib import Path

import pytest
from pydantic import ValidationError

from backend.local_store import LocalStore
from backend.s3_store import S3Store
from backend.settings import BackendSettings, setting_faults
from backend.stores import open_store


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


@pytest.mark.parametrize("url", ["http://x", "/plain/path", "gs://bucket"])
def test_a_store_that_is_not_supported_is_refused_clearly(url):
    with pytest.raises(ValidationError, match="not supported"):
        BackendSettings(store_url=url)


@pytest.mark.parametrize(
    "url", ["s3://", "s3://UPPER/x", "s3://key:secret@bucket/x", "s3://bucket:9000/x", "s3://bucket/../x", "s3://bucket/x?y"]
)
def test_an_s3_store_is_named_by_bucket_and_prefix_alone(url):
    with pytest.raises(ValidationError, match="s3://bucket") as refusal:
        BackendSettings(store_url=url)
    assert "secret" not in "".join(setting_faults(refusal.value))


def test_an_s3_store_is_opened_without_asking_it(tmp_path):
    settings = BackendSettings(data_dir=tmp_path, store_url="s3://bucket/some/prefix/", store_endpoint="http://127.0.0.1:1")
    store = open_store(settings)
    assert isinstance(store, S3Store) and store.free_bytes() > 0
    assert isinstance(open_store(BackendSettings(data_dir=tmp_path)), LocalStore)


@pytest.mark.parametrize("url", ["127.0.0.1:9000", "ftp://host", "http://key:secret@host", "http://host/path"])
def test_an_endpoint_is_a_plain_address(url):
    with pytest.raises(ValidationError, match="without credentials") as refusal:
        BackendSettings(store_endpoint=url)
    assert "secret" not in "".join(setting_faults(refusal.value))


def test_a_password_is_given_once_and_its_file_is_there(tmp_path):
    file = tmp_path / "password"
    with pytest.raises(ValidationError, match="no such file"):
        BackendSettings(redis_url="redis://host", redis_password_file=file)
    file.write_text("secret\n")
    assert BackendSettings(redis_url="redis://host", redis_password_file=file).redis_password_file == file
    for url in (None, "redis://:other@host"):
        with pytest.raises(ValidationError, match="needs a redis_url") as refusal:
            BackendSettings(redis_url=url, redis_password_file=file)
        assert "other" not in "".join(setting_faults(refusal.value))


def test_settings_do_not_show_the_password_of_the_queue():
    assert "secret" not in repr(BackendSettings(redis_url="redis://:secret@host:6379/0"))
