# SPDX-License-Identifier: Apache-2.0
"""Find the places of a file that can be changed, and change one."""

from __future__ import annotations

import ast
import difflib
import functools
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from mutation.operators import operators


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
