"""Arithmetic expressions of a recipe's derived columns, such as ``abs(w) * 0.096``."""

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from operators.batch import Reals
from operators.errors import ParameterError

Value: TypeAlias = Reals | np.float64

LIMIT: Final = 300  # characters, which bounds the depth too
LARGEST: Final = 1e12  # of a number
BASELINE: Final = 10  # rows of `first`

_UNARY: Final[Mapping[type[ast.unaryop], Callable[..., Value]]] = MappingProxyType(
    {ast.USub: np.negative, ast.UAdd: np.positive}
)
_BINARY: Final[Mapping[type[ast.operator], Callable[..., Value]]] = MappingProxyType(
    {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide}
)
_COMPARISONS: Final[Mapping[type[ast.cmpop], Callable[..., Value]]] = MappingProxyType(
    {
        ast.Gt: np.greater,
        ast.GtE: np.greater_equal,
        ast.Lt: np.less,
        ast.LtE: np.less_equal,
        ast.Eq: np.equal,
        ast.NotEq: np.not_equal,
    }
)


def _first(values: Value) -> Value:
    return np.float64(np.mean(np.atleast_1d(values)[:BASELINE]))


FUNCTIONS: Final[Mapping[str, Callable[[Value], Value]]] = MappingProxyType(
    {
        "abs": np.abs,
        "round": np.round,  # half to even
        "sqrt": np.sqrt,
        "mean": np.mean,
        "median": np.median,
        "first": _first,  # mean of the first ten rows
    }
)


@dataclass(frozen=True)
class Expression:
    """Arithmetic on columns: numbers, names of columns, ``+ - * /``, comparisons and `FUNCTIONS`.

    Nothing else is accepted, and the text is never executed as Python: a recipe from the internet can neither
    read files nor run code.

    >>> Expression("abs(w) * 0.5 > 1").evaluate({"w": np.array([-4.0, 1.0])})
    array([1., 0.])

    Args:
        text: The expression.

    Attributes:
        names: Columns that it uses.

    Raises:
        ParameterError: on anything else.
    """

    text: str
    names: frozenset[str] = field(init=False, compare=False)
    _tree: ast.expr = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if len(self.text) > LIMIT:
            raise ParameterError("expression", "length", len(self.text), f"at most {LIMIT} characters")
        try:
            tree = ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ParameterError(
                "expression", "text", self.text, "arithmetic such as (e1 + e2) / 2"
            ) from None
        object.__setattr__(self, "_tree", tree)
        object.__setattr__(self, "names", frozenset(self._check(tree)))

    def evaluate(self, columns: Mapping[str, Reals]) -> Reals:
        """Return the value in each row, (n,); comparisons give 1 or 0.

        Args:
            columns: Columns by name, (n,) each; those in `names` at least.
        """
        rows = len(next(iter(columns.values())))
        with np.errstate(divide="ignore", invalid="ignore"):
            found = self._value(self._tree, columns)
        return np.broadcast_to(np.asarray(found, np.float64), (rows,)).copy()

    def _check(self, node: ast.expr) -> set[str]:
        """Return the columns below a node, which must have accepted nodes only."""
        match node:
            case ast.Constant(value=int() | float() as number) if abs(number) < LARGEST:
                return set()
            case ast.Name(id=name):
                return {name}
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                return self._check(operand)
            case ast.BinOp(op=op, left=left, right=right) if type(op) in _BINARY:
                return self._check(left) | self._check(right)
            case ast.Compare(ops=[op], left=left, comparators=[right]) if type(op) in _COMPARISONS:
                return self._check(left) | self._check(right)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
                return self._check(argument)
            case _:
                must_be = f"numbers, columns, + - * /, comparisons and {', '.join(FUNCTIONS)} of one value"
                raise ParameterError("expression", "part", ast.unparse(node), must_be)

    def _value(self, node: ast.expr, columns: Mapping[str, Reals]) -> Value:
        match node:
            case ast.Constant(value=int() | float() as number):
                return np.float64(number)
            case ast.Name(id=name):
                return columns[name]
            case ast.UnaryOp():
                return _UNARY[type(node.op)](self._value(node.operand, columns))
            case ast.BinOp():
                values = self._value(node.left, columns), self._value(node.right, columns)
                return _BINARY[type(node.op)](*values)
            case ast.Compare():
                values = self._value(node.left, columns), self._value(node.comparators[0], columns)
                return np.asarray(_COMPARISONS[type(node.ops[0])](*values), np.float64)
            case ast.Call(func=ast.Name(id=name)):
                return FUNCTIONS[name](self._value(node.args[0], columns))
            case _:
                raise AssertionError(ast.dump(node))  # _check rejects it
