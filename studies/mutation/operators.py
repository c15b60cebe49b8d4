# SPDX-License-Identifier: Apache-2.0
"""The changes that are made: a selection of Cosmic Ray's operators and two of our own.

Cosmic Ray replaces every operator by every other one. One or two replacements of each find the same
holes in a tenth of the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import parso
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import get_operator

_BINARY = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_Add", "Pow_Mul")
_BITWISE = ("BitAnd_BitOr", "BitOr_BitAnd")
_COMPARISON = (
    *("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Lt_Gt", "LtE_GtE", "Gt_Lt", "GtE_LtE"),
    *("Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is"),
)
_OTHERS = (
    *("ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("AddNot", "ReplaceUnaryOperator_Delete_USub", "ReplaceUnaryOperator_Delete_Not"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ExceptionReplacer"),
    *("NumberReplacer", "ZeroIterationForLoop"),
)


class RemoveTranspose(Operator):  # type: ignore[misc]
    """Replace `A.T` by `A`: R for its inverse, a Jacobian for its transpose."""

    def mutation_positions(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """Yield the place of `.T`."""
        if node.type == "trailer" and node.get_code() == ".T":
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, index: int) -> Any:
        """Drop the two characters."""
        for leaf in node.children:
            leaf.value = ""
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Return one example, as Cosmic Ray asks of each operator."""
        return (Example("a.T @ b", "a @ b"),)


class DeleteStatement(Operator):  # type: ignore[misc]
    """Replace a call whose result is not used, or an assignment to an attribute, by `pass`.

    This is how a reset, a limit or an update is forgotten.
    """

    def mutation_positions(self, node: Any) -> Iterator[tuple[Any, Any]]:
        """Yield the place of each such statement."""
        if node.type == "simple_stmt" and _has_effect(node.children[0]):
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, index: int) -> Any:
        """Put `pass` in its place."""
        prefix = node.children[0].get_first_leaf().prefix
        node.children[0] = parso.parse("pass").children[0]
        node.children[0].prefix = prefix
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Return one example, as Cosmic Ray asks of each operator."""
        return (Example("self.count = 0\n", "pass\n"),)


def _has_effect(statement: Any) -> bool:
    if statement.type == "expr_stmt":
        return bool(statement.children[0].type == "atom_expr")
    called = statement.type == "atom_expr" and statement.children[-1].get_code().startswith("(")
    return bool(called)


def operators() -> dict[str, Operator]:
    """Return every operator by its name."""
    names = [
        *(f"ReplaceBinaryOperator_{each}" for each in (*_BINARY, *_BITWISE)),
        *(f"ReplaceComparisonOperator_{each}" for each in _COMPARISON),
        *_OTHERS,
    ]
    theirs = {name: get_operator(f"core/{name}")() for name in names}
    return theirs | {"RemoveTranspose": RemoveTranspose(), "DeleteStatement": DeleteStatement()}
