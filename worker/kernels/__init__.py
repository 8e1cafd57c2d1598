"""Numba kernels of the preprocessing; they know arrays only."""
