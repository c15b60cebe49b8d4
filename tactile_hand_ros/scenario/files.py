# SPDX-License-Identifier: Apache-2.0
"""Scenario files as plain data: find them, merge them with their bases, change values."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tactile_hand_ros.config.paths import scenario_names
from tactile_hand_ros.config.plain_yaml import SUFFIXES, find_file, read_yaml
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.own_law import folder_of

_NOT_INHERITED = ("name", "description")  # they describe the extended scenario
CONTROLLER = "manipulation_controller"
_LAW = f"{CONTROLLER}.law"
_MESH = "plant.object.mesh"


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
    if not isinstance(data, dict):
        raise ConfigurationError(
            f"'{path}' holds {type(data).__name__}; expected a mapping of keys to values"
        )
    if not data:
        raise ConfigurationError(
            f"{path}: the file is empty; write `extends: paper` to run the scenario `paper`"
        )
    data = _complete(data, path)
    base = data.pop("extends", None)
    if base is None:
        return data
    under = read_layers(_find_base(str(base), path), (*seen, path))
    for key in _NOT_INHERITED:
        under.pop(key, None)
    if data.get("hand", under.get("hand")) != under.get("hand"):
        under.pop("layout", None)  # of another hand
    return merged(under, data)


def _find_base(base: str, path: Path) -> Path:
    """Return the scenario that another extends: a file next to it, else one of the package.

    A user's ``paper.yaml`` may extend ``paper``, which is then the one of the package.
    """
    beside = path.parent / os.path.expanduser(base if base.endswith(SUFFIXES) else f"{base}.yaml")
    is_itself = beside.resolve() == path
    if base.endswith(SUFFIXES):
        return beside if beside.is_file() else find_file("scenario", str(beside))
    if beside.is_file() and not (is_itself and base in scenario_names()):
        return beside
    return find_file("scenario", base)


def _complete(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a scenario with paths relative to its file resolved: hand, mesh and own law.

    A ``law`` at the top level is short for that of the controller, and ``law: NAME`` for
    ``law: {name: NAME}``.
    """
    data = dict(data)
    if isinstance(hand := data.get("hand"), str):
        data["hand"] = _beside(hand, path.parent)
    plant = data.get("plant")
    body = plant.get("object") if isinstance(plant, dict) else None
    if isinstance(plant, dict) and isinstance(body, dict) and isinstance(body.get("mesh"), str):
        data["plant"] = {**plant, "object": {**body, "mesh": _mesh(body["mesh"], path.parent)}}
    section = data.get(CONTROLLER, {})
    if not isinstance(section, dict) or "law" not in {*data, *section}:
        return data  # validation reports the error
    if "law" in data and "law" in section:
        raise ConfigurationError(f"{path}: 'law' is given twice, at the top and in '{CONTROLLER}'")
    law = data.pop("law") if "law" in data else section["law"]
    law = {"name": law} if isinstance(law, str) else law
    if isinstance(law, dict) and isinstance(law.get("name"), str):
        law = {"folder": folder_of(law["name"], path.parent), **law}
    data[CONTROLLER] = {**section, "law": law}
    return data


def _beside(hand: str, folder: Path) -> str:
    """Return a hand's file as an absolute path; names of hands stay unchanged."""
    if not hand.endswith(SUFFIXES) or hand.startswith("~"):
        return hand
    return os.path.normpath(folder.resolve() / hand)


def _mesh(file: str, folder: Path) -> str:
    """Return the absolute path of a mesh; empty stays empty."""
    return os.path.normpath(folder.resolve() / os.path.expanduser(file)) if file else ""


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge mappings key by key; replace lists and values completely."""
    out = dict(under)
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict):
            value = merged(out[key], value)
        out[key] = value
    return out


def put_changes(data: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, str]:
    """Put values into `data` by dotted key; files are relative to the working directory.

    Returns:
        The key of `changes` by the place that it sets.

    Raises:
        ConfigurationError: If a path leads through a value that has no keys.
    """
    here, places = Path.cwd(), {}
    # The hand first: a layout that is set together with it must stay.
    for key, value in sorted(changes.items(), key=lambda pair: pair[0] != "hand"):
        place = f"{CONTROLLER}.{key}" if key.split(".")[0] == "law" else key
        if place == "hand" and isinstance(value, str):
            value = _beside(value, here)
            data.pop("layout" if value != data.get("hand") else "", None)
        if place == _MESH and isinstance(value, str):
            value = _mesh(value, here)
        if place == _LAW and isinstance(value, str):
            place = f"{_LAW}.name"
        if place == f"{_LAW}.name" and isinstance(value, str):
            _put(data, f"{_LAW}.folder".split("."), folder_of(value, here))
        _put(data, place.split("."), value)
        places[place] = key
    return places


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
