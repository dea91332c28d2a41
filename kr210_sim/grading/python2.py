"""Python 2 source -> Python 3 that means the same, line by line; the file itself stays as it is."""

from __future__ import annotations

import ast
import bisect
import copy
import functools
import io
import re
import tokenize
import warnings
from pathlib import Path
from typing import Any

from kr210_sim.grading.findings import Finding, Refused, Source

_FIXERS = (
    "apply", "basestring", "dict", "except", "exec", "execfile", "filter", "funcattrs", "getcwdu",
    "has_key", "itertools", "itertools_imports", "map", "methodattrs", "ne", "next",
    "nonzero", "numliterals", "paren", "print", "raise", "raw_input", "renames", "repr",
    "standarderror", "sys_exc", "throw", "tuple_params", "types", "xreadlines",
    "zip",
)  # fmt: skip
"""Those of fissix that keep lines where they are; what others would rename is a builtin here."""

MODULES = {
    "StringIO": "io", "cStringIO": "io", "cPickle": "pickle", "__builtin__": "builtins",
    "Queue": "queue", "ConfigParser": "configparser", "copy_reg": "copyreg",
}  # fmt: skip
"""Modules of Python 2 -> the names they have now."""

_TAB = 8
"""Columns of a tab in Python 2."""

_UNPACKING = re.compile(r"\s*\(.*\) = xxx_todo_changeme\d*\s*$")
"""A line that the conversion adds where a parameter was a tuple."""

_ROS = re.compile(r"^\s*(import|from)\s+(rospy|tf|kuka_arm)\b", re.MULTILINE)


def read_source(content: bytes) -> str:
    """Return the text of a source file; without a declaration it is UTF-8, else Latin-1."""
    try:
        encoding, _ = tokenize.detect_encoding(io.BytesIO(content).readline)
        text = content.decode(encoding)
    except (SyntaxError, UnicodeDecodeError, LookupError):
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").lstrip("\ufeff")


def is_python2(text: str) -> bool:
    """Tell whether a file is meant for Python 2.

    That is a file which Python 3 cannot read, and a node of the course's ROS, unless its first
    line asks for Python 3.
    """
    first = text.partition("\n")[0]
    if first.startswith("#!") and "python3" in first:
        return False
    return python3_error(text) is not None or _ROS.search(text) is not None


def python3_error(text: str) -> SyntaxError | None:
    """Return what Python 3 cannot read in a source text, None if it can."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ast.parse(text)
    except SyntaxError as error:
        return error
    except (ValueError, RecursionError, MemoryError) as error:
        return SyntaxError(str(error) or type(error).__name__)
    return None


def to_python3(text: str) -> str:
    """Convert Python 2 to Python 3 without moving a line.

    Raises:
        Refused: if it is no Python 2 either.
        ModuleNotFoundError: if fissix is not installed.
    """
    from fissix import refactor
    from fissix.pgen2.parse import ParseError
    from fissix.pgen2.tokenize import TokenError

    text = text.expandtabs(_TAB)
    names = [f"fissix.fixes.fix_{name}" for name in _FIXERS]
    known = set(refactor.get_fixers_from_package("fissix.fixes"))
    tool = refactor.RefactoringTool([name for name in names if name in known])
    try:
        tree = tool.refactor_string(text if text.endswith("\n") else text + "\n", "the file")
    except ParseError as error:
        line = error.context[1][0] if error.context else None
        raise Refused(_no_syntax(f"{error.msg} at {error.value!r}", text, line)) from error
    except (TokenError, IndentationError) as error:
        line = error.args[1][0] if isinstance(error, TokenError) else error.lineno
        raise Refused(_no_syntax(str(error.args[0]), text, line)) from error
    return str(tree)


def _no_syntax(detail: str, text: str, line: int | None) -> Finding:
    error = python3_error(text)
    if error is not None and (error.lineno or 0) >= (line or 0):
        detail, line = error.msg, error.lineno  # the language that is understood further is meant
    source = Source(Path("?"), text).line(line)
    detail = f"is neither Python 3 nor Python 2: {detail}"
    return Finding(kind="syntax", detail=detail, line=line, source=source)


# ---- what means something else in Python 2 ---------------------------------------------------


def compile_python2(text: str, path: str) -> Any:
    """Compile converted source such that / of whole numbers is a whole number, as it was."""
    tree = ast.parse(text, path)
    _put_back(tree, text)
    true_division = any(
        isinstance(node, ast.ImportFrom)
        and node.module == "__future__"
        and any(alias.name == "division" for alias in node.names)
        for node in tree.body
    )
    if not true_division:
        tree = ast.fix_missing_locations(_Division().visit(tree))
    return compile(tree, path, "exec", dont_inherit=True)


def _put_back(tree: ast.AST, text: str) -> None:
    """Give every node the line it has in the original, where unpacking has no line of its own."""
    lines = text.split("\n")
    added = [number for number, line in enumerate(lines, 1) if _UNPACKING.match(line)]
    for node in ast.walk(tree) if added else ():
        for name in ("lineno", "end_lineno"):
            number = getattr(node, name, None)
            if number is not None:
                setattr(node, name, number - bisect.bisect_left(added, number))


class _Division(ast.NodeTransformer):
    """Replaces a / b by a call that divides as Python 2 does."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Div):
            return node
        return self._call(node, node.left, node.right)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Div):
            return node
        target = copy.copy(node.target)  # what is in its brackets is evaluated twice
        target.ctx = ast.Load()
        return ast.copy_location(
            ast.Assign([node.target], self._call(node, target, node.value)), node
        )

    @staticmethod
    def _call(node: ast.AST, left: ast.expr, right: ast.expr) -> ast.expr:
        name = ast.Name("__divide_as_python2__", ast.Load())
        return ast.copy_location(ast.Call(name, [left, right], []), node)


def _divide(a: Any, b: Any) -> Any:
    whole = isinstance(a, int) and isinstance(b, int)
    return a // b if whole else a / b


def _compare(a: Any, b: Any) -> int:
    return int(a > b) - int(a < b)


def builtins2() -> dict[str, Any]:
    """Return the builtins of Python 2 that are not in Python 3."""
    return {
        "__divide_as_python2__": _divide,
        "xrange": range,
        "unicode": str,
        "basestring": str,
        "long": int,
        "unichr": chr,
        "reduce": functools.reduce,
        "cmp": _compare,
        "raw_input": input,
        "intern": str,
        "reload": lambda module: module,
    }
