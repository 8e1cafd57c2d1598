"""The Python client and the `silhouette` command. Speaks HTTP."""

from client.api import Client, Picture

__all__ = ["Client", "Picture"]
