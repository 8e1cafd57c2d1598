"""Benchmarks are not type-checked: what they take from the rest must be there."""

import importlib
import pkgutil

import pytest

import benchmarks

MODULES = [module.name for module in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.")]


@pytest.mark.parametrize("module", [name for name in MODULES if not name.endswith("__main__")])
def test_every_benchmark_can_be_imported(module):
    importlib.import_module(module)
