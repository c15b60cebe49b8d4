# SPDX-License-Identifier: Apache-2.0
"""A C extension of a package, loaded without the package around it.

The Python side of a numeric library is often what takes time and memory to load: OSQP alone brings
the sparse matrices of SciPy and a template engine.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from pathlib import Path
from types import ModuleType


def load_extension(package: str, path: str, *, is_shared: bool = False) -> ModuleType:
    """Return a C extension.

    Args:
        package: Name of the package that brings it.
        path: Its file below the package, with slashes and without a suffix.
        is_shared: Whether the package itself, should it be imported later, takes the same module
            and does not load it a second time, which many extensions refuse.

    Raises:
        LookupError: If it is not there.
    """
    full = f"{package}.{path.replace('/', '.')}"
    if full in sys.modules:
        return sys.modules[full]
    file = _file(package, path)
    name = full if is_shared else file.name.split(".")[0]
    loader = importlib.machinery.ExtensionFileLoader(name, str(file))
    spec = importlib.util.spec_from_file_location(name, file, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    if is_shared:
        sys.modules[full] = module
    return module


def _file(package: str, path: str) -> Path:
    spec = importlib.util.find_spec(package)
    for folder in (spec and spec.submodule_search_locations) or ():
        for suffix in importlib.machinery.EXTENSION_SUFFIXES:
            file = Path(folder) / f"{path}{suffix}"
            if file.is_file():
                return file
    raise LookupError(f"{package} has no C extension '{path}'")
