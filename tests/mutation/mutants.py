"""Small faults that a source file could have, one at a time."""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from itertools import islice
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

_PAIRS = (
    *((ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.BitAnd, ast.BitOr), (ast.And, ast.Or)),
    *((ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)),
)
_SWAPPED = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_SWAPPED |= dict.fromkeys((ast.Pow, ast.FloorDiv, ast.Mod), ast.Mult)
_CALLS = {"maximum": "minimum", "max": "min", "any": "all", "argmax": "argmin"}
_CALLS |= {other: one for one, other in _CALLS.items()}
_WIDTH = 90


class Mutant(NamedTuple):
    """One fault: in which ``file``, function or constant (``place``), from what to what (``change``)."""

    file: str
    place: str
    change: str
    line: int
    tree: ast.Module

    @property
    def name(self) -> str:
        """It outlives changes elsewhere in the file."""
        return f"{self.file} {self.place}: {self.change}"


def mutants_of(root: Path, file: str) -> Iterator[Mutant]:
    """Every fault of a file, in the order of its lines."""
    tree = ast.parse((root / file).read_text(encoding="utf-8"))
    counts = Counter[str]()
    for index, (node, place) in enumerate(_places(tree, "")):
        before = _text(node)
        for kind in range(len(list(_changes(node)))):
            faulty = deepcopy(tree)
            target, _ = next(islice(_places(faulty, ""), index, None))
            list(_changes(target))[kind]()
            change = f"{before} -> {_text(target)}"
            counts[f"{place} {change}"] += 1
            if (many := counts[f"{place} {change}"]) > 1:
                change += f" (no. {many})"
            yield Mutant(file, place, change, node.lineno, ast.fix_missing_locations(faulty))


def _text(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split("\n")[0].split())
    return text if len(text) <= _WIDTH else text[:_WIDTH] + "..."


def _places(node: ast.AST, place: str) -> Iterator[tuple[Any, str]]:
    """All nodes that run, with the name of the function, method or constant that they are in."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params", "bases", "keywords_of_class"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(
                child, ast.JoinedStr | ast.Raise | ast.Assert | ast.Import | ast.ImportFrom
            ):
                continue
            inside = place
            if isinstance(child, ast.FunctionDef | ast.ClassDef) and not _is_in_function(place):
                inside = f"{place}.{child.name}" if place else child.name
                inside += "()" if isinstance(child, ast.FunctionDef) else ""
            elif isinstance(child, ast.Assign | ast.AnnAssign) and not place:
                target = child.targets[0] if isinstance(child, ast.Assign) else child.target
                inside = ast.unparse(target)
            if isinstance(child, ast.expr | ast.stmt):
                yield child, inside
            yield from _places(child, inside)


def _is_in_function(place: str) -> bool:
    return place.endswith("()")


def _changes(node: Any) -> Iterator[Callable[[], None]]:
    """Each way to change ``node``, to be called."""
    match node:
        case ast.Constant(value=bool()):
            yield partial(setattr, node, "value", not node.value)
        case ast.Constant(value=int()):
            yield partial(setattr, node, "value", node.value + 1)
        case ast.Constant(value=float()):
            yield partial(setattr, node, "value", 2.0 * node.value or 1.0)
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() if type(node.op) in _SWAPPED:
            yield partial(setattr, node, "op", _SWAPPED[type(node.op)]())
        case ast.Compare():
            for i, op in enumerate(node.ops):
                yield partial(node.ops.__setitem__, i, _SWAPPED[type(op)]())
        case ast.UnaryOp(op=ast.USub()):
            yield partial(setattr, node, "op", ast.UAdd())
        case ast.UnaryOp(op=ast.Not() | ast.Invert()):
            yield partial(_put, node, ast.UnaryOp(ast.Not(), ast.UnaryOp(ast.Not(), node.operand)))
        case ast.If() | ast.IfExp() | ast.While():
            yield partial(setattr, node, "test", ast.UnaryOp(ast.Not(), node.test))
        case ast.Call(func=ast.Attribute(attr=name)) if name in _CALLS:
            yield partial(setattr, node.func, "attr", _CALLS[name])
        case ast.Call(func=ast.Name(id=name)) if name in _CALLS:
            yield partial(setattr, node.func, "id", _CALLS[name])
    match node:
        case (
            ast.AugAssign()
            | ast.Expr(value=ast.Call())
            | ast.Assign(targets=[ast.Attribute() | ast.Subscript(), *_])
        ):
            yield partial(_put, node, ast.Expr(ast.Constant(None)))


def _put(node: Any, other: ast.AST) -> None:
    """Another node in place of one."""
    place = {"lineno": node.lineno, "col_offset": node.col_offset}
    node.__class__, node.__dict__ = type(other), other.__dict__ | place


def apply(mutant: Mutant, module: ModuleType, others: list[ModuleType]) -> None:
    """Give a loaded module the fault: the code of a function, or a constant also where it was imported."""
    code = compile(mutant.tree, str(module.__file__), "exec")
    namespace = {key: vars(module)[key] for key in ("__name__", "__file__", "__package__", "__spec__")}
    if mutant.place.endswith("()"):
        path = mutant.place.removesuffix("()").split(".")
        function = _function(module, path)
        function.__code__ = _code(code, path)
        if function.__defaults__ or function.__kwdefaults__:
            exec(code, namespace)
            faulty = _function(namespace, path)
            function.__defaults__, function.__kwdefaults__ = faulty.__defaults__, faulty.__kwdefaults__
        for value in [value for other in others for value in vars(other).values()]:
            if hasattr(value, "cache_clear"):
                value.cache_clear()
        return
    exec(code, namespace)
    old = vars(module)
    for name, value in namespace.items():
        if name.startswith("__") or isinstance(value, type | ModuleType) or hasattr(value, "__code__"):
            continue
        for other in others:
            if name in vars(other) and vars(other)[name] is old.get(name) and other is not module:
                setattr(other, name, value)
        setattr(module, name, value)


def _function(module: ModuleType | dict[str, Any], path: list[str]) -> Any:
    found: Any = module
    for name in path:
        found = (found if isinstance(found, dict) else vars(found))[name]
    for inner in ("fget", "func", "__func__", "__wrapped__"):
        found = getattr(found, inner, None) or found
    return found


def _code(code: CodeType, path: list[str]) -> CodeType:
    for name in path:
        code = next(c for c in code.co_consts if isinstance(c, CodeType) and c.co_name == name)
    return code
