# SPDX-License-Identifier: Apache-2.0
"""Laws of users, ``module:Class``.

Importing a module runs its code, and a bag may come from anywhere. Only `take_law` imports. Call it
only with a law that the user has named: in a scenario file, on the command line or as a parameter.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from tactile_hand_ros.control.laws import OWN_LAWS, LawConfig
from tactile_hand_ros.errors import ConfigurationError


def take_law(config: LawConfig) -> None:
    """Import the law that a configuration names, unless it is one of this package.

    Raises:
        ConfigurationError: If there is no such module or class, or it is not a law.
    """
    if ":" not in config.name:
        return
    module, _, attribute = config.name.partition(":")
    found = getattr(_imported(config, module), attribute, None)
    if found is None:
        raise _wrong(config, f"its module has no '{attribute}'", "a class of that name")
    _check_law(config, found)
    OWN_LAWS[config.name, config.folder] = found


def known_law(law: Any) -> str:
    """Register a class of the running program as a law; return its name for `LawConfig.name`.

    Raises:
        ConfigurationError: If it is not a law.
    """
    name = f"{getattr(law, '__module__', '')}:{getattr(law, '__name__', type(law).__name__)}"
    _check_law(LawConfig().model_copy(update={"name": name}), law)
    OWN_LAWS[name, ""] = law
    return name


def folder_of(name: str, candidate: Path) -> str:
    """Return the `candidate` if it has the module of a law, else empty: from PYTHONPATH."""
    top = name.partition(":")[0].partition(".")[0]
    is_there = (candidate / f"{top}.py").is_file() or (candidate / top / "__init__.py").is_file()
    return str(candidate.resolve()) if ":" in name and is_there else ""


def _imported(config: LawConfig, module: str) -> ModuleType:
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names:
        raise _wrong(config, f"'{top}' is a module of Python itself", "another name for yours")
    if config.folder:
        _forget(top, Path(config.folder))
        sys.path.insert(0, config.folder)
        importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name not in (module, top):  # a module that it imports
            raise _wrong(config, f"it needs the module '{error.name}'", "that installed") from None
        raise _wrong(
            config,
            f"there is no module '{module}'",
            "it next to the scenario file or on PYTHONPATH",
        ) from None
    except Exception as error:
        reason = f"its module fails with {type(error).__name__}: {error}"
        raise _wrong(config, reason, "one that can be imported") from error
    finally:
        if config.folder:
            sys.path.remove(config.folder)


def _forget(top: str, folder: Path) -> None:
    """Forget a module of the same name from another folder."""
    loaded = getattr(sys.modules.get(top), "__file__", None)
    if loaded is not None and folder not in Path(loaded).parents:
        for name in [each for each in sys.modules if each.partition(".")[0] == top]:
            del sys.modules[name]


def _check_law(config: LawConfig, factory: Any) -> None:
    """Reject an object without the methods of `Law`; the preflight calls them."""
    if not callable(factory):
        raise _wrong(config, f"it is a {type(factory).__name__}", "a class")
    for name, signature in (("internal_torque", "(self)"), ("drive", "(self, wrench)")):
        # The result of a function is only known when it is called.
        if inspect.isclass(factory) and not callable(getattr(factory, name, None)):
            raise _wrong(config, f"it has no {name}", f"{name}{signature}")


def _wrong(config: LawConfig, problem: str, expected: str) -> ConfigurationError:
    where = f" in {config.folder}" if config.folder else ""
    return ConfigurationError(
        f"the law '{config.name}'{where} cannot be used: {problem}; expected {expected}"
    )
