from tests.backend.conftest import connection, redis_url, s3_server

__all__ = ["connection", "redis_url", "s3_server"]
