"""The HTTP API, the EGL renderer, and runtime silhouette extraction."""
