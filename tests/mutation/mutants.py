"""Small faults that a source file could have, one at a time."""

import ast
from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

_SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
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
        """As survivors.toml has it: it outlives changes elsewhere in the file."""
        return f"{self.file} {self.place}: {self.change}"


def mutants_of(root: Path, file: str) -> Iterator[Mutant]:
    """Every fault of a file, in the order of its lines."""
    tree = ast.parse((root / file).read_text(encoding="utf-8"))
    counts = Counter[str]()
    for index, (node, place) in enumerate(_places(tree, "")):
        for kind in range(len(list(_changes(deepcopy(node))))):
            faulty = deepcopy(tree)
            target = _places_list(faulty)[index]
            before = _text(target)
            list(_changes(target, kind))
            change = f"{before} -> {_text(target)}"
            counts[f"{place} {change}"] += 1
            if (many := counts[f"{place} {change}"]) > 1:
                change += f" (no. {many})"
            yield Mutant(file, place, change, node.lineno, ast.fix_missing_locations(faulty))


def _text(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split("\n")[0].split())
    return text if len(text) <= _WIDTH else text[:_WIDTH] + "..."


def _places_list(tree: ast.Module) -> list[Any]:
    return [node for node, _ in _places(tree, "")]


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


def _changes(node: Any, chosen: int | None = None) -> Iterator[None]:
    """Yield once for each way to change ``node``; only the ``chosen`` way is carried out."""
    number = -1

    def turn() -> bool:
        nonlocal number
        number += 1
        return number == chosen

    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        if turn():
            node.value = node.value + 1 if type(node.value) is int else 2.0 * node.value or 1.0
        yield
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        if turn():
            node.value = not node.value
        yield
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in _SWAPPED:
        if turn():
            node.op = _SWAPPED[type(node.op)]()
        yield
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            if turn():
                node.ops[i] = _SWAPPED[type(op)]()
            yield
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        if turn():
            node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.Not()
            if chosen is not None and isinstance(node.op, ast.Not):
                node.operand = ast.UnaryOp(ast.Not(), node.operand)
        yield
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        if turn():
            node.test = ast.UnaryOp(ast.Not(), node.test)
        yield
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _CALLS:
        if turn():
            node.func.attr = _CALLS[node.func.attr]
        yield
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _CALLS:
        if turn():
            node.func.id = _CALLS[node.func.id]
        yield
    is_set = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript)
    if is_set or isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and _is_call(node.value)):
        if turn():
            _remove(node)
        yield


def _is_call(node: ast.expr) -> bool:
    return isinstance(node, ast.Call)


def _remove(node: Any) -> None:
    """A statement that does nothing, in its place."""
    nothing = ast.Expr(ast.Constant(None))
    node.__class__ = ast.Expr
    node.__dict__ = nothing.__dict__ | {"lineno": node.lineno, "col_offset": node.col_offset}


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
