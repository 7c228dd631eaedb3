"""Presence of the compiled kernels, and the behaviour without them."""

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from contact_tracker.cli.main import run
from contact_tracker.errors import SlowUpdate
from contact_tracker.hypotheses import compiled

SUPPORT = str(Path(__file__).parents[1] / "support")
RECORDING = Path(__file__).parents[2] / "recordings" / "paper_experiment.mcap"


@pytest.mark.parametrize("switch", ["0", "1"])
def test_kernels_and_filterpy_are_imported_when_tracking_starts(switch):
    """In a fresh interpreter: filterpy takes half a second, for which no pose waits; kernels can be switched
    off."""
    program = f"""
import sys
sys.path.append({SUPPORT!r})
from contact_tracker.config.loading import load_model
from contact_tracker.hypotheses import compiled
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracker import Tracker
from smooth_motion import moving, np
names = "contact_tracker.hypotheses.compiled.kernels", "filterpy"
show = lambda: print(*(name in sys.modules for name in names))
show()
Tracker.start(load_model())
show()
segment(moving(np.random.default_rng(0), 0.2, 200.0), load_model())
show()
print(compiled.described())
"""
    environment = os.environ | {"CONTACT_TRACKER_COMPILED": switch}
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    described = "compiled kernels" if switch == "1" else "numpy, CONTACT_TRACKER_COMPILED=0"
    assert done.stdout.splitlines() == ["False False", "False True", f"{switch == '1'} True", described]


@pytest.mark.skipif(not any(map(shutil.which, ("c++", "g++", "clang++", "cl"))), reason="no compiler")
def test_kernels_are_built_where_there_is_a_compiler():
    """So that the tests of kernels are not skipped unnoticed."""
    assert compiled.find_spec(compiled.NAME)
    assert compiled.fault() == ""


def test_missing_kernels_are_reported_in_one_line(monkeypatch, capsys):
    monkeypatch.delenv(compiled.SWITCH, raising=False)
    monkeypatch.setattr(compiled, "find_spec", lambda name: None)
    monkeypatch.setattr(compiled, "fault", compiled.fault.__wrapped__)
    monkeypatch.setattr(compiled, "in_use", cache(compiled.in_use.__wrapped__))
    assert run(["segment", str(RECORDING), "--duration", "0.3"]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "slower" in line]
    assert line.startswith("contact-tracker: warning: runs in numpy, some 20 times slower: no kernels were")
    assert "install a C++ compiler" in line
    assert compiled.described().startswith("numpy: no kernels were built")


def test_kernels_of_other_sources_are_not_used(tmp_path, monkeypatch):
    """In a work tree that has changed since the installation; an unrelated folder of that name is ignored."""
    monkeypatch.setattr(compiled, "SOURCES", tmp_path)
    assert compiled.fault.__wrapped__() == compiled.fault()
    (tmp_path / "python").mkdir()
    (tmp_path / "CMakeLists.txt").write_text("")
    (tmp_path / "python" / "module.cpp").write_text("// another algorithm")
    fault = compiled.fault.__wrapped__()
    assert fault == "their sources have changed since, install the package again"
    monkeypatch.setattr(compiled, "fault", lambda: fault)
    with pytest.warns(SlowUpdate, match="their sources have changed"):
        assert not compiled.in_use.__wrapped__()
    assert compiled.described() == f"numpy: {fault}"


@pytest.mark.parametrize("reason", [None, SystemExit(143)])
def test_kernels_that_cannot_be_loaded_are_not_used_and_an_interrupt_meanwhile_is_one(monkeypatch, reason):
    """Whatever error the interrupt causes during the import."""

    def load(name):
        raise ImportError("another\nPython") from reason

    monkeypatch.setattr(compiled, "import_module", load)
    if reason is None:
        assert compiled.fault.__wrapped__() == "they cannot be loaded, another Python"
        return
    with pytest.raises(SystemExit):
        compiled.fault.__wrapped__()
