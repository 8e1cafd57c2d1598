"""Whether a service asks for keys at all, and what it holds to check them."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_address

from backend.redis_connection import connection_options
from backend.store import Store
from backend.stores import open_store
from schemas.access import KeyLimits
from schemas.errors import SilhouetteError
from service.access.keys import KeyRing, KeyStore
from service.access.quotas import RenderQuota, RequestQuota
from service.settings import ServiceSettings

NO_KEYS = """{host} is not this machine alone, and there is no key: everyone who reaches the port could use the service.
  Make a key:        silhouette keys add NAME --scope read --scope write --scope admin
  or listen here:    --host 127.0.0.1
  or let everyone:   --insecure (SILHOUETTE_INSECURE=true)"""
NO_REQUIRED_KEYS = """SILHOUETTE_REQUIRE_KEYS is set, and there is no key: nobody could use the service.
  Make a key:        silhouette keys add NAME --scope read --scope write --scope admin"""


@dataclass(frozen=True)
class Access:
    """What the guard of a running service works with.

    always: whether keys are asked for though there be none. limits: those of every key that has no tighter ones. open_limits: those of
    each address where no key is asked for.
    """

    ring: KeyRing
    requests: RequestQuota
    renders: RenderQuota
    always: bool
    limits: KeyLimits
    open_limits: KeyLimits

    async def is_open(self) -> bool:
        """Whether everyone may do everything."""
        return not self.always and not await self.ring.any()


def open_access(settings: ServiceSettings, store: Store) -> Access:
    """What the settings say. Raises ValueError without a Redis URL."""
    if settings.redis_url is None:
        raise ValueError("SILHOUETTE_REDIS_URL is not set")
    limits = KeyLimits(
        requests_per_minute=settings.requests_per_minute or None,
        concurrent_renders=settings.concurrent_renders or None,
        max_pixels=settings.max_pixels,
        max_faces=settings.max_faces,
        max_upload_mib=settings.max_upload_mib,
    )
    of_addresses = {
        "requests_per_minute": settings.address_requests_per_minute or None,
        "concurrent_renders": settings.address_concurrent_renders or None,
    }
    return Access(
        ring=KeyRing(KeyStore(store)),
        requests=RequestQuota(
            settings.redis_url, connection_options(settings.redis_url, settings.redis_password_file, settings.redis_ca_file)
        ),
        renders=RenderQuota(),
        always=needs_keys(settings),
        limits=limits,
        open_limits=limits.model_copy(update=of_addresses),
    )


def needs_keys(settings: ServiceSettings) -> bool:
    """Whether keys are asked for whether or not there are any."""
    return settings.require_keys or not (settings.insecure or is_loopback(settings.host))


def startup_fault(settings: ServiceSettings) -> str | None:
    """Why the service must not start, for people: it needs a key, and there is none. Blocks."""
    try:
        if not needs_keys(settings) or KeyStore(open_store(settings)).any():
            return None
    except SilhouetteError as error:
        return f"it is not known whether there is a key: {error.message}"
    return NO_REQUIRED_KEYS if settings.require_keys else NO_KEYS.format(host=settings.host)


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is reached from this machine only; other names than localhost are taken as public."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
