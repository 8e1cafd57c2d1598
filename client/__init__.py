"""The Python client and the `silhouette` command. Speaks HTTP."""
