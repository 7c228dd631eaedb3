"""Builds the kernels as the package is built. Where there is no compiler it is built without them."""

import runpy
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from pybind11.setup_helpers import WIN, Pybind11Extension, build_ext
from setuptools import Distribution
from setuptools.errors import BaseError, CompileError, LinkError

SOURCES = Path("tracker/kernels")
PACKAGE = Path("tracker/contact_tracker/compiled")
# Sums may be taken in another order; what is no number or infinite is treated as the language says.
OPTIONS = (
    ["/O2"]
    if WIN
    else ["-O3", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math"]
)

NOT_BUILT = (BaseError, CompileError, LinkError)


class Kernels(BuildHookInterface):
    """A module beside the Python code that calls it, in a work tree as well as in a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        try:
            built = build(root)
        except NOT_BUILT as error:
            self.app.display_warning(f"numpy will do the work of the kernels, they cannot be built: {error}")
            return
        build_data["artifacts"].append(f"/{PACKAGE.as_posix()}/{built.name}")
        build_data["pure_python"], build_data["infer_tag"] = False, True


def build(root: Path) -> Path:
    """The module; raises one of ``NOT_BUILT`` where that cannot be done."""
    name = "contact_tracker.compiled.kernels"
    told = runpy.run_path(str(root / PACKAGE / "sources.py"))["fingerprint"](root / SOURCES)
    extension = Pybind11Extension(
        name,
        sorted(str(path) for path in (root / SOURCES).glob("*.cpp")),
        cxx_std=17,
        define_macros=[("FINGERPRINT", told)],
        extra_compile_args=OPTIONS,
    )
    with tempfile.TemporaryDirectory() as scratch:
        command = build_ext(Distribution({"name": "contact-tracker", "ext_modules": [extension]}))
        command.build_lib = command.build_temp = scratch
        command.ensure_finalized()
        command.run()
        found = Path(command.get_ext_fullpath(name))
        return Path(shutil.copy(found, root / PACKAGE / found.name))
