"""The structure of the code: allowed imports and I/O, file sizes, and forbidden names."""

import ast
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tracker" / "contact_tracker"
LAB = ROOT / "tracker" / "contact_tracker_lab"

# Data flows down this table: a package imports only from rows above its own, and from itself.
LAYERS = (
    ("states", "errors", "files", "suggestions", "arrays", "version", "geometry", "hmm", "interrupts"),
    ("config", "contacts", "processes"),
    ("motion", "ground_truth", "map"),
    ("hypotheses", "inspection", "paper", "wrenches"),
    ("explanations", "recording"),
    ("tracking", "trajectory"),
    ("checks", "outputs"),
    ("tracker", "sequences", "viewer"),
    ("segmenting", "saved_state", "exports"),
    ("batch", "saved_result"),
    ("cli", "api"),
)
LAB_LAYERS = (("simulate", "evaluation"), ("calibration",), ("benchmark",), ("cli", "physics"))
"""Of the second package, which imports any of the first one; the first one imports none of it."""
EDGE = {"interrupts", "processes", "recording", "trajectory", "outputs", "sequences", "viewer", "segmenting"}
EDGE |= {"saved_state", "saved_result", "exports", "batch", "cli", "api"}
CORE = {name for row in LAYERS for name in row} - EDGE
# In the core: files that users name, and whether kernels are built from the sources
# beside them.
READS_FILES = {"config/loading.py", "config/keys.py", "config/__init__.py", "hypotheses/compiled/__init__.py"}
READS_FILES |= {"hypotheses/compiled/sources.py", "files.py", "suggestions.py"}
READS_FILES |= {"map/file.py"}
ALONE = {"hmm"}  # it sees arrays only, and imports nothing of ours
SINGLE_IMPORTER = {
    "mcap": "recording",
    "mcap_ros2": "recording/decoding.py",
    "mcap_protobuf": "recording/decoding.py",
    "sqlite3": "recording/bags.py",
    "h5py": "recording/array_files.py",
    "rerun": "viewer",
    "filterpy": "motion/free_motion.py",
    "foxglove": "exports/foxglove_scene.py",
    "matplotlib": ("exports/figure.py", "exports/sequence_figures.py"),
    "pandas": ("exports/columns.py", "api/offline.py"),
    "pyarrow": (
        "exports/parquet.py",
        "recording/binary_tables.py",
        "batch/lerobot.py",
    ),  # output, input, both
    "shtab": "cli/main.py",
    "ruptures": "benchmark/bic.py",
    "tqdm": ("cli", "api", "benchmark/runner.py"),
    "argparse": ("cli", "benchmark/runner.py", "benchmark/benchmark.py", "physics.py"),
    "distributed": "batch/cluster.py",
    "rosbags": (),  # bags are read without it
}
IO_MODULES = {"sys", "os", "io", "pathlib", "logging", "subprocess", "socket", "shutil", "tempfile", "time"}
IO_CALLS = {"open", "print", "input"}
PRINTS = "cli/terminal.py"
MAX_LINES = 700


def sources() -> list[Path]:
    return sorted([*PACKAGE.rglob("*.py"), *LAB.rglob("*.py")])


def package(path: Path) -> Path:
    return LAB if LAB in path.parents else PACKAGE


def part(path: Path) -> str:
    """The row entry a file belongs to: its first folder or its own name."""
    return path.relative_to(package(path)).with_suffix("").parts[0]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Absolute dotted names of what a file imports, wherever in the file."""
    found = list[str]()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: import by the full name, not relatively"
            found += (f"{node.module}.{alias.name}" for alias in node.names)
    return tuple(found)


def layer(name: str, layers: tuple[tuple[str, ...], ...]) -> int:
    rows = [i for i, row in enumerate(layers) if name in row]
    assert rows, f"{name} has no row in the table of layers: say where in the data flow it stands"
    return rows[0]


def ids(path: Path) -> str:
    return str(path.relative_to(package(path)))


PARTS = [p for p in sources() if part(p) not in {"__init__", "__main__"}]
LAYERS_OF = {PACKAGE: LAYERS, LAB: LAB_LAYERS}


@pytest.mark.parametrize("root", LAYERS_OF, ids=lambda root: root.name)
def test_the_table_names_nothing_that_is_gone(root: Path) -> None:
    parts = {part(path) for path in PARTS if package(path) == root}
    assert {name for row in LAYERS_OF[root] for name in row} == parts


def test_data_flows_one_way() -> None:
    for path, name in ((one, name) for one in PARTS for name in imports(one)):
        root, layers = package(path), LAYERS_OF[package(path)]
        assert root == LAB or not name.startswith(LAB.name), f"{ids(path)} imports the lab"
        if name.startswith(f"{root.name}."):
            own, other = part(path), name.split(".")[1]
            is_before = other == own or layer(other, layers) < layer(own, layers)
            assert is_before, f"{ids(path)} imports {other}, which comes after it or beside it"
            assert own not in ALONE or other == own, f"{ids(path)} stands alone, but imports {other}"


def module(name: str) -> str:
    """The module that an imported name is in, or is."""
    while not ((PACKAGE.parent / Path(*name.split("."))).with_suffix(".py").is_file()):
        if (PACKAGE.parent / Path(*name.split(".")) / "__init__.py").is_file():
            return name
        name = name.rpartition(".")[0]
    return name


def test_no_modules_import_each_other() -> None:
    graph = {}
    for path in sources():
        own = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        ours = (
            name
            for name in imports(path)
            if name.startswith(("contact_tracker.", "contact_tracker_lab.")) and ".kernels" not in name
        )
        graph[own] = {module(name) for name in ours} - {own, "contact_tracker"}
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_each_foreign_library_has_one_importer() -> None:
    for path, name in ((one, name) for one in PARTS for name in imports(one)):
        importer = SINGLE_IMPORTER.get(name.split(".")[0])
        importers = importer if isinstance(importer, tuple) else (importer,)
        found = {None, part(path), ids(path)} & set(importers)
        assert found, f"{ids(path)} imports {name}, which {importer} does only"


def test_the_core_does_no_io() -> None:
    core = (p for p in PARTS if package(p) == PACKAGE and part(p) in CORE and ids(p) not in READS_FILES)
    for path in core:
        for name in imports(path):
            assert name.split(".")[0] not in IO_MODULES, f"{ids(path)}: the core imports {name}"
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                called = f"{ids(path)}:{node.lineno}: the core calls {node.func.id}"
                assert node.func.id not in IO_CALLS, called


def test_only_one_file_prints() -> None:
    for path in (p for p in PARTS if ids(p) not in READS_FILES | {PRINTS}):
        for node in ast.walk(tree(path)):
            match node:
                case ast.Call(func=ast.Name("print")):
                    pytest.fail(f"{ids(path)}:{node.lineno}: only {PRINTS} prints")
                case ast.Attribute(
                    ast.Attribute(ast.Name("sys"), "stdout" | "stderr"), "write" | "writelines"
                ):
                    pytest.fail(f"{ids(path)}:{node.lineno}: only {PRINTS} prints")


def test_a_file_has_one_reason_to_exist() -> None:
    for path in sources():
        assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_LINES, ids(path)
        assert ast.get_docstring(tree(path)), f"{ids(path)}: the first line of a file says why it exists"
    for path in (ROOT / "tracker/core").rglob("*.?pp"):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= MAX_LINES, path
        assert lines[0].startswith("// "), path


def test_the_package_itself_imports_nothing_heavy() -> None:
    """Imports are on first use, except for type checkers."""
    body = tree(PACKAGE / "__init__.py").body
    assert not [node for node in body if isinstance(node, ast.Import | ast.ImportFrom)]


def tracked_text() -> Iterator[tuple[str, str]]:
    """Name and text of every file that git knows or would add; binary recordings and pictures aside."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git work tree: nothing says which files are the project's")
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        path = ROOT / name
        if path.is_file() and path.suffix not in {".mcap", ".png", ".c3d"}:
            yield name, path.read_text(encoding="utf-8")


def test_nothing_names_a_machine_or_a_package_registry() -> None:
    folders = "|".join(("home", "Users", "root", "work", "tmp", "opt", "mnt"))
    machine_path = re.compile(rf"(?<![\w.:/~-])/(?:{folders})/")
    registry = re.compile(
        r"(?:--|_|-)(?:index-url|find-links)\b|\b(?:py" + r"pi\.org|pythonhosted\.org)", re.I
    )
    for name, text in tracked_text():
        for number, line in enumerate(text.splitlines(), 1):
            assert not machine_path.search(line), f"{name}:{number} names a path of one machine"
            assert not registry.search(line), f"{name}:{number} names a package registry"
