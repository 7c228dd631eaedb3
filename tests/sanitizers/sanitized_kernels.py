"""Replaces the installed kernels by those in the file SANITIZED_KERNELS.

A plugin of pytest, ``-p sanitized_kernels``, or imported first.
"""

import os
import sys
from importlib.util import module_from_spec, spec_from_file_location

from contact_tracker.hypotheses import compiled

spec = spec_from_file_location(compiled.NAME, os.environ["SANITIZED_KERNELS"])
assert spec is not None
assert spec.loader is not None
kernels = module_from_spec(spec)
spec.loader.exec_module(kernels)
sys.modules[compiled.NAME] = kernels
assert compiled.in_use(), compiled.fault()
