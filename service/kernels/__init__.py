"""Numba kernels of the runtime; they know arrays only."""
