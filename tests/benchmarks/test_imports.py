"""Benchmarks are not type-checked: what they take from the rest must be there."""

import importlib
import pkgutil

import pytest

import benchmarks

OURS = ("backend", "benchmarks", "client", "geometry", "schemas", "service", "worker")
MODULES = [module.name for module in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.")]


@pytest.mark.parametrize("module", [name for name in MODULES if not name.endswith("__main__")])
def test_every_benchmark_finds_what_it_imports(module):
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as missing:
        if str(missing.name).partition(".")[0] in OURS:
            raise
        pytest.skip(f"{missing.name} is not installed: it comes with the extra bench")
