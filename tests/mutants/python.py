"""Mutants of Python: cosmic-ray's, a statement left out, and the minimum for the maximum."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import parso.python.tree as tree
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator

_COSMIC = [
    *(f"ReplaceBinaryOperator_{pair}" for pair in (
        "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul", "FloorDiv_Div", "Mod_Mul",
        "BitAnd_BitOr", "BitOr_BitAnd",
    )),
    *(f"ReplaceComparisonOperator_{pair}" for pair in (
        "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt", "Eq_NotEq", "NotEq_Eq",
        "Is_IsNot", "IsNot_Is",
    )),
    "ReplaceUnaryOperator_Delete_USub", "ReplaceUnaryOperator_Delete_Not", "ReplaceUnaryOperator_Delete_Invert",
    "AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue",
    "ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "ExceptionReplacer",
    "NumberReplacer",
]  # fmt: skip
_PAIRS = ("minimum maximum", "min max", "any all", "argmin argmax", "floor ceil", "sin cos", "fmin fmax")
_OTHER = {a: b for pair in _PAIRS for a, b in (pair.split(), pair.split()[::-1])}


class _Kind(Operator):  # type: ignore[misc]
    """A kind of mutation with one mutant a place."""

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()

    def fits(self, node: Any) -> bool:
        raise NotImplementedError

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        if self.fits(node):
            yield node.start_pos, node.end_pos


class OtherFunction(_Kind):
    """The minimum for the maximum, and such."""

    def fits(self, node: Any) -> bool:
        return isinstance(node, tree.Name) and node.value in _OTHER and not node.is_definition()

    def mutate(self, node: Any, index: int) -> Any:
        return tree.Name(_OTHER[node.value], node.start_pos, prefix=node.prefix)


class LeaveOut(_Kind):
    """Without a call, or without an assignment to something that is there already."""

    def fits(self, node: Any) -> bool:
        if node.parent is None or node.parent.type != "simple_stmt" or node is not node.parent.children[0]:
            return False
        if node.type == "expr_stmt":
            target, operator = node.children[:2]
            return operator.type != "annassign" and (target.type != "name" or operator.value != "=")
        return node.type == "atom_expr"

    def mutate(self, node: Any, index: int) -> Any:
        return tree.Keyword("pass", node.start_pos, prefix=node.get_first_leaf().prefix)


OPERATORS: dict[str, Operator] = {name: get_operator(f"core/{name}")() for name in _COSMIC}
OPERATORS |= {"OtherFunction": OtherFunction(), "LeaveOut": LeaveOut()}


def annotations(module: Any) -> list[tuple[Any, Any]]:
    """Where types are written, which nothing evaluates."""
    found = []
    for node in ast_nodes(module):
        if node.type == "annassign":
            found.append(node.children[1])
        elif node.type in ("param", "funcdef") and node.annotation is not None:
            found.append(node.annotation)
    return [(node.start_pos, node.end_pos) for node in found]


#: Where a star multiplies nothing.
_STARRED = ("parameters", "typedargslist", "param", "argument", "arglist", "star_expr")


def sites(source: str) -> dict[Any, list[tuple[str, int]]]:
    """The mutants of a module by the place that they change: operator and its occurrence."""
    module = get_ast(source)
    types, found, nodes = annotations(module), defaultdict(list), list(ast_nodes(module))
    for name, operator in OPERATORS.items():
        occurrence = 0
        for node in nodes:
            for start, end in operator.mutation_positions(node):
                huge = node.type == "number" and abs(eval(node.value)) >= 2.0**53  # one more is the same
                starred = node.type == "operator" and node.parent.type in _STARRED
                if not huge and not starred and not any(a <= start and end <= b for a, b in types):
                    found[start].append((name, occurrence))
                occurrence += 1
    return dict(found)


def write(source: str, operator: str, occurrence: int) -> str:
    """The module with one change."""
    mutated: str | None = mutate_code(source, OPERATORS[operator], occurrence)
    assert mutated is not None, (operator, occurrence)
    return mutated
