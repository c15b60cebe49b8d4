# SPDX-License-Identifier: Apache-2.0
"""Scenario files as plain data: find them, merge them with their bases, change values."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

from tactile_hand_ros.config.plain_yaml import SUFFIXES, find_file, read_yaml
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.own_law import folder_of

_NOT_INHERITED = ("name", "description")  # they describe the extended scenario
CONTROLLER = "manipulation_controller"
_LAW = f"{CONTROLLER}.law"


def read_layers(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a scenario and merge it over the one that it extends.

    Raises:
        ConfigurationError: If a file cannot be read, or scenarios extend each other in a loop.
    """
    path = path.resolve()
    chain = " -> ".join(each.stem for each in (*seen, path))
    if path in seen:
        raise ConfigurationError(f"{seen[-1]}: 'extends' makes a loop: {chain}; remove one of them")
    data = read_yaml(path)
    if not data or not isinstance(data, dict):
        raise ConfigurationError(
            f"{path}: expected keys with values; write `extends: paper` to run the scenario `paper`"
        )
    _complete(data, path)
    base = data.pop("extends", None)
    if base is None:
        return data
    under = read_layers(_find_base(str(base), path), (*seen, path))
    for key in _NOT_INHERITED:
        under.pop(key, None)
    if data.get("hand", under.get("hand")) != under.get("hand"):
        under.pop("layout", None)  # of another hand
    given = set(_object_of(data))
    if given & {"shape", "size", "vertices", "mesh", "scale"} and "inertia" not in given:
        _object_of(under).pop("inertia", None)  # of another body
    return merged(under, data)


def _object_of(data: Mapping[str, Any]) -> dict[str, Any]:
    plant = data.get("plant")
    found = plant.get("object") if _is_map(plant) else {}
    return found if _is_map(found) else {}


def _find_base(base: str, path: Path) -> Path:
    """Return the scenario that another extends: another file next to it, else one of the package.

    A user's ``paper.yaml`` may extend ``paper``, which is then the one of the package.
    """
    is_file = base.endswith(SUFFIXES)
    beside = path.parent / os.path.expanduser(base if is_file else f"{base}.yaml")
    if beside.is_file() and beside.resolve() != path:
        return beside
    return find_file("scenario", str(beside) if is_file else base)


def _complete(data: dict[str, Any], path: Path) -> None:
    """Resolve what is relative to a scenario's file: hand, mesh and own law.

    A ``law`` at the top level is short for that of the controller, and ``law: NAME`` for
    ``law: {name: NAME}``. Validation reports sections that are not mappings.
    """
    section = data.get(CONTROLLER, {})
    for place, key in ((data, "hand"), (_object_of(data), "mesh")):
        if key in place:
            place[key] = _beside(place[key], path.parent)
    if not _is_map(section) or "law" not in {*data, *section}:
        return
    if "law" in data and "law" in section:
        raise ConfigurationError(f"{path}: 'law' is given twice, at the top and in '{CONTROLLER}'")
    law = data.pop("law") if "law" in data else section["law"]
    law = {"name": law} if isinstance(law, str) else law
    if _is_map(law) and isinstance(law.get("name"), str):
        law = {"folder": folder_of(law["name"], path.parent), **law}
    data[CONTROLLER] = {**section, "law": law}


def _is_map(value: Any) -> TypeGuard[dict[str, Any]]:
    return isinstance(value, dict)


def _beside(file: Any, folder: Path) -> Any:
    """Return the absolute path of a file relative to a folder; names without suffix stay."""
    if not isinstance(file, str) or not Path(file).suffix:
        return file
    home = os.path.expanduser(file)  # unchanged if there is no such user
    return home if file.startswith("~") else os.path.normpath(folder.resolve() / file)


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge mappings key by key; replace lists and values completely."""
    out = dict(under)
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict):
            value = merged(out[key], value)
        out[key] = value
    return out


def put_changes(data: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Put values into `data` by dotted key; files are relative to the working directory.

    Raises:
        ConfigurationError: If a path leads through a value that has no keys.
    """
    here = Path.cwd()
    # The hand first: a layout that is set together with it must stay.
    for key, value in sorted(changes.items(), key=lambda pair: pair[0] != "hand"):
        place = f"{CONTROLLER}.{key}" if key.split(".")[0] == "law" else key
        if place in ("hand", "plant.object.mesh"):
            value = _beside(value, here)
        if place == "hand" and value != data.get("hand"):
            data.pop("layout", None)
        if place in (_LAW, f"{_LAW}.name") and isinstance(value, str):
            _put(data, f"{_LAW}.folder".split("."), folder_of(value, here))
            place = f"{_LAW}.name"
        _put(data, place.split("."), value)


def _put(data: dict[str, Any], keys: list[str], value: Any) -> None:
    """Set a value by its path; a number in the path is an index into a list."""
    place: Any = data
    for index, key in enumerate(keys):
        is_known = isinstance(place, dict)
        if isinstance(place, list) and key.isdigit() and int(key) < len(place):
            is_known, key = True, int(key)  # type: ignore[assignment]
        if not is_known:
            raise ConfigurationError(
                f"'{'.'.join(keys)}' cannot be set: '{'.'.join(keys[:index])}' has no '{key}' in "
                "it; set it as a whole"
            )
        if index == len(keys) - 1:
            place[key] = value
        else:
            place = place.setdefault(key, {}) if isinstance(place, dict) else place[key]
