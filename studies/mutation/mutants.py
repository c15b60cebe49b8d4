# SPDX-License-Identifier: Apache-2.0
"""The mutants of a file: a selection of Cosmic Ray's operators and two of our own.

Cosmic Ray replaces every operator by every other one. One or two replacements of each find the same
holes in a tenth of the time.
"""

from __future__ import annotations

import ast
import difflib
import functools
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import parso
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
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


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        path: The file, relative to the root of the project.
        operator: Name of the operator.
        occurrence: Which of the operator's places in the file, from 0.
        line: Where the change is, from 1.
        function: The enclosing function, as in `Class.method`; empty at the top of a module.
    """

    path: str
    operator: str
    occurrence: int
    line: int
    function: str

    def mutated(self, source: str) -> str:
        """Return the changed source."""
        return str(mutate_code(source, operators()[self.operator], self.occurrence))

    def diff(self, source: str) -> str:
        """Return the lines that change, without their surroundings."""
        lines = difflib.unified_diff(source.splitlines(), self.mutated(source).splitlines(), n=0)
        return "\n".join(line for line in lines if line[:3] not in ("---", "+++", "@@ "))

    def key(self, source: str) -> str:
        """Name the mutant so that edits elsewhere in the file do not change the name."""
        removed, added = ([], [])  # type: tuple[list[str], list[str]]
        for line in self.diff(source).splitlines():
            (removed if line.startswith("-") else added).append(line[1:].strip())
        return f"{self.path}:{self.function}: {' '.join(removed)} -> {' '.join(added)}"


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Return all mutants of a file, in the order of its lines."""
    source = path.read_text(encoding="utf-8")
    places = _Places.of(source)
    nodes = list(ast_nodes(get_ast(source)))
    found = [
        Mutant(str(path.relative_to(root)), name, occurrence, line, places.function_at(line))
        for name, operator in operators().items()
        for occurrence, (line, column) in enumerate(
            start for node in nodes for start, _ in operator.mutation_positions(node)
        )
        if not places.is_silent(line, column)
    ]
    return sorted(found, key=lambda each: (each.line, each.operator, each.occurrence))


@dataclass(frozen=True)
class _Places:
    """What the syntax tree says of the lines of a file."""

    functions: tuple[tuple[int, int, str], ...]
    silent: tuple[tuple[tuple[int, int], tuple[int, int]], ...]

    @classmethod
    def of(cls, source: str) -> _Places:
        tree = ast.parse(source)
        return cls(tuple(_functions(tree, "")), tuple(_silent(tree)))

    def function_at(self, line: int) -> str:
        inside = [each for each in self.functions if each[0] <= line <= each[1]]
        return max(inside)[2] if inside else ""

    def is_silent(self, line: int, column: int) -> bool:
        return any(start <= (line, column) < end for start, end in self.silent)


def _functions(node: ast.AST, prefix: str) -> Iterator[tuple[int, int, str]]:
    for child in ast.iter_child_nodes(node):
        name = prefix
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{prefix}.{child.name}".lstrip(".")
            if not isinstance(child, ast.ClassDef):
                yield child.lineno, int(child.end_lineno or 0), name
        yield from _functions(child, name)


_NEVER = ("TYPE_CHECKING", "__name__ == '__main__'")
"""Conditions that are false where tests import a module."""


def _silent(tree: ast.AST) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield what never runs, changes words only, or declares: parameters, what is frozen."""
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _header(node)
        elif isinstance(node, ast.AnnAssign):
            parts = [node.annotation, _declaration(node.value)]
        elif isinstance(node, ast.ClassDef):  # test_architecture.py looks at what is frozen
            parts = [each for each in node.decorator_list if isinstance(each, ast.Call)]
        elif isinstance(node, ast.JoinedStr):
            parts = [node]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "zip":  # an assertion
            parts = [each.value for each in node.keywords if each.arg == "strict"]
        elif isinstance(node, ast.If) and ast.unparse(node.test) in _NEVER:
            parts = [node]
        for part in parts:
            if part is not None:
                start = (part.lineno, part.col_offset)  # type: ignore[attr-defined]
                yield start, (part.end_lineno, part.end_col_offset)  # type: ignore[attr-defined]


def _declaration(value: ast.expr | None) -> ast.expr | None:
    declares = isinstance(value, ast.Call) and ast.unparse(value.func) in ("param", "field")
    return value if declares else None


def _header(
    node: ast.FunctionDef | ast.AsyncFunctionDef,
) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield what stands between `def` and the body, without the defaults: names and types."""
    defaults = [*node.args.defaults, *(each for each in node.args.kw_defaults if each)]
    at = node.lineno, node.col_offset
    for each in sorted(defaults, key=lambda each: (each.lineno, each.col_offset)):
        yield at, (each.lineno, each.col_offset)
        at = int(each.end_lineno or 0), int(each.end_col_offset or 0)
    yield at, (node.body[0].lineno, node.body[0].col_offset)


@functools.cache
def changed_lines(path: str, since: str) -> frozenset[int]:
    """Return the lines of a file that differ from a commit, numbered as they are now.

    Raises:
        subprocess.CalledProcessError: If git does not know the commit.
    """
    command = ["git", "diff", "--unified=0", since, "--", path]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: set[int] = set()
    for line in text.splitlines():
        if line.startswith("@@"):
            first, _, count = line.split("+")[1].split(" ")[0].partition(",")
            found.update(range(int(first), int(first) + int(count or 1)))
    return frozenset(found)


def in_changed_functions(mutants: list[Mutant], root: Path, since: str) -> list[Mutant]:
    """Keep the mutants in functions of which at least one line differs from a commit."""
    return [each for each in mutants if each.function in _changed_functions(root, each.path, since)]


@functools.cache
def _changed_functions(root: Path, path: str, since: str) -> frozenset[str]:
    places = _Places.of((root / path).read_text(encoding="utf-8"))
    return frozenset(places.function_at(line) for line in changed_lines(path, since))
