"""Builds the kernels as the package is built. Where there is no compiler it is built without them."""

import runpy
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from pybind11.setup_helpers import WIN, ParallelCompile, Pybind11Extension, build_ext
from setuptools import Distribution
from setuptools.errors import BaseError, CompileError, LinkError

SOURCES = Path("tracker/core")
PACKAGE = Path("tracker/contact_tracker/hypotheses/compiled")
# Sums may be taken in another order; what is no number or infinite is treated as the language says.
OPTIONS = (
    ["/O2"]
    if WIN
    else [
        "-O3",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
        "-Wno-psabi",  # nothing that others call takes wide numbers
    ]
)

NOT_BUILT = (BaseError, CompileError, LinkError, OSError)


class Kernels(BuildHookInterface[Any]):
    """A module beside the Python code that calls it: in a wheel, or in a tree that is installed editable."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        self._scratch = tempfile.TemporaryDirectory()
        root = Path(self.root)
        try:
            built = build(root, Path(self._scratch.name))
            if version == "editable":
                put(built, root / PACKAGE)
            else:
                build_data["force_include"][str(built)] = f"contact_tracker/hypotheses/compiled/{built.name}"
        except NOT_BUILT as error:
            self.app.display_warning(f"numpy will do the work of the kernels, they cannot be built: {error}")
            return
        build_data["pure_python"], build_data["infer_tag"] = False, True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        self._scratch.cleanup()


def build(root: Path, scratch: Path) -> Path:
    """The module, in the folder ``scratch``; raises one of ``NOT_BUILT`` where that cannot be done."""
    name = "contact_tracker.hypotheses.compiled.kernels"
    told = runpy.run_path(str(root / PACKAGE / "sources.py"))["fingerprint"](root / SOURCES)
    extension = Pybind11Extension(
        name,
        sorted(str(path) for path in (root / SOURCES).rglob("*.cpp")),
        cxx_std=17,
        define_macros=[("FINGERPRINT", told)],
        include_dirs=[str(root / SOURCES)],
        extra_compile_args=OPTIONS,
    )
    command = build_ext(Distribution({"name": "contact-tracker", "ext_modules": [extension]}))
    command.build_lib = command.build_temp = str(scratch)
    command.ensure_finalized()
    with ParallelCompile():
        command.run()
    return Path(command.get_ext_fullpath(name))


def put(module: Path, folder: Path) -> None:
    """Into a folder, at once: whoever has loaded the one that it replaces keeps that."""
    waiting = Path(shutil.copy(module, folder / f".{module.name}"))
    waiting.replace(folder / module.name)
