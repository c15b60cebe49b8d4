# SPDX-License-Identifier: Apache-2.0
"""Commands whose options are the fields of a dataclass."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, TypeVar

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
            name: str = parameter.name
            options: Any = parameter.annotation
            own = inspect.signature(options, eval_str=True).parameters
            parameters += map(_option, own.values(), fields(options))
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> Result:
        values = {each: given.pop(each) for each in own}
        return command(**given, **{name: options(**values)})

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _option(parameter: inspect.Parameter, field: Field[Any]) -> inspect.Parameter:
    """Return a keyword parameter for a field, with the value that its default factory makes."""
    found = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    factory = field.default_factory
    return found if factory is MISSING else found.replace(default=factory())
