# SPDX-License-Identifier: Apache-2.0
"""The mutants of a file: each changes one operator, number, condition or statement."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_SWAPS: dict[type[ast.AST], tuple[type[Any], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Add,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.Break: (ast.Continue,),
    ast.Continue: (ast.Break,),
}
_DECLARES = ("annotation", "returns", "decorator_list", "type_params")
_NEVER = ("TYPE_CHECKING", "__name__ == '__main__'")
"""Conditions that are false when tests import a module."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        path: The file, relative to the root of the project.
        number: Index among the file's mutants, from 0.
        line: Line of the change, from 1.
        function: The enclosing function, as in `Class.method`; empty at the top of a module.
        change: The statement before and after; only the head of a compound statement.
    """

    path: str
    number: int
    line: int
    function: str
    change: str

    @property
    def key(self) -> str:
        """Name of the mutant, unaffected by edits elsewhere in the file."""
        return f"{self.path}:{self.function}: {self.change}"

    def mutated(self, source: str) -> str:
        """Return the changed source."""
        tree = ast.parse(source)
        for number, (site, other) in enumerate(_changes(tree)):
            if number == self.number:
                site.put(other)
                return ast.unparse(ast.fix_missing_locations(tree))
        raise ValueError(f"{self.path} has no mutant {self.number}")


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Return all mutants of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for number, (site, other) in enumerate(_changes(tree)):
        before = _head(site.statement)
        original = site.node
        site.put(other)
        after = "pass" if isinstance(other, ast.Pass) else _head(site.statement)
        site.put(original)
        name, function = str(path.relative_to(root)), ".".join(site.scope)
        found.append(Mutant(name, number, site.line, function, f"{before} -> {after}"))
    return found


def _head(statement: ast.AST) -> str:
    return ast.unparse(ast.fix_missing_locations(copy.copy(statement))).splitlines()[0]


@dataclass(frozen=True)
class _Site:
    """A node, its place in the tree, and the enclosing statement and functions."""

    node: Any
    parent: ast.AST
    field: str
    index: int | None
    statement: Any
    scope: tuple[str, ...]

    @property
    def line(self) -> int:
        return int(getattr(self.node, "lineno", self.statement.lineno))

    def put(self, node: Any) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


def _changes(tree: ast.AST) -> Iterator[tuple[_Site, Any]]:
    for site in list(_sites(tree, tree, ())):
        for other in _others(site):
            yield site, other


def _sites(node: Any, statement: Any, scope: tuple[str, ...]) -> Iterator[_Site]:
    """Yield all nodes except declarations, texts and code that never runs."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        scope = (*scope, node.name)
    for field, value in ast.iter_fields(node):
        for index, child in enumerate(value) if isinstance(value, list) else ((None, value),):
            if not isinstance(child, ast.AST) or field in _DECLARES or _is_silent(child):
                continue
            inner = child if isinstance(child, ast.stmt) else statement
            yield _Site(child, node, field, index, inner, scope)
            yield from _sites(child, inner, scope)


def _is_silent(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr():
            return True
        case ast.AnnAssign(value=ast.Call(func=ast.Name(id="param" | "field"))):
            return True
        case ast.keyword(arg="strict"):  # of `zip`, an assertion
            return True
        case ast.If(test=test):
            return ast.unparse(test) in _NEVER
    return False


def _others(site: _Site) -> Iterator[Any]:
    """Yield the replacements of a node."""
    node = site.node
    for kind in _SWAPS.get(type(node), ()):
        yield kind()
    match node:
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            yield from (ast.Constant(value + 1), ast.Constant(value - 1))
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.Attribute(attr="T", value=value):  # a rotation matrix for its inverse
            yield value
        case ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()  # as if a reset, limit or update were forgotten
        case ast.AugAssign():
            yield ast.Pass()
    if site.field == "test" and isinstance(site.parent, ast.If | ast.While | ast.IfExp):
        yield ast.UnaryOp(ast.Not(), node)
    if site.field == "iter":
        yield ast.List([], ast.Load())
