from tests.backend.conftest import connection, redis_url

__all__ = ["connection", "redis_url"]
