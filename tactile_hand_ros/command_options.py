# SPDX-License-Identifier: Apache-2.0
"""Commands whose options are the fields of a dataclass."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

Result = TypeVar("Result")


def with_options(command: Callable[..., Result]) -> Callable[..., Result]:
    """Show Typer the fields of a dataclass as the options of a command.

    Annotate each field like a parameter of a Typer command. A command with many options then
    declares them once and takes them as one value::

        @dataclass(frozen=True)
        class Options:
            seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0

        @with_options
        def command(options: Options) -> None: ...

    Other parameters of the command stay unchanged.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        if is_dataclass(parameter.annotation):
            name, options = parameter.name, parameter.annotation
            parameters += _parameters(options)
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> Result:
        own = {field.name: given.pop(field.name) for field in fields(options)}
        return command(**given, **{name: options(**own)})  # type: ignore[operator]

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _parameters(options: Any) -> list[inspect.Parameter]:
    """Return a parameter for each field of a dataclass."""
    hints = get_type_hints(options, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=_default(field),
            annotation=hints[field.name],
        )
        for field in fields(options)
    ]


def _default(field: Field[Any]) -> Any:
    """Return the default of a field, or that of a parameter without one."""
    if field.default_factory is not MISSING:
        return field.default_factory()
    return inspect.Parameter.empty if field.default is MISSING else field.default
