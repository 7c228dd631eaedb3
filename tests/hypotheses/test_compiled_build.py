"""Presence of the compiled kernels, and the behaviour without them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from contact_tracker.errors import SlowUpdate
from contact_tracker.hypotheses import compiled

SUPPORT = str(Path(__file__).parents[1] / "support")
RECORDING = Path(__file__).parents[2] / "recordings" / "paper_experiment.mcap"


def output_of(program, **environment):
    """The output of a program in a fresh interpreter."""
    found = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return found.stdout.strip()


def test_it_can_be_switched_off_and_is_not_imported_before_it_is_needed():
    program = (
        "import sys; from contact_tracker.hypotheses import compiled;"
        "from contact_tracker.tracking import offline_smoother;"
        "print('contact_tracker.hypotheses.compiled.kernels' in sys.modules, compiled.described())"
    )
    assert output_of(program, CONTACT_TRACKER_COMPILED="0") == "False numpy, CONTACT_TRACKER_COMPILED=0"
    assert output_of(program, CONTACT_TRACKER_COMPILED="1") == "False compiled kernels"


def test_the_filter_of_free_motion_is_filterpy():
    """It is loaded when tracking starts, as that takes half a second."""
    program = (
        f"import sys; sys.path.append({SUPPORT!r}); import short_recordings as short;"
        "print('filterpy' in sys.modules);"
        "short.segment(short.recorded(short.FACE_TO_EDGE).poses[:60], short.MODEL);"
        "print('filterpy' in sys.modules)"
    )
    for in_use in "01":
        assert output_of(program, CONTACT_TRACKER_COMPILED=in_use).split() == ["False", "True"]


@pytest.mark.skipif(not any(map(shutil.which, ("c++", "g++", "clang++", "cl"))), reason="no compiler")
def test_kernels_are_built_where_there_is_a_compiler():
    """So that the tests of kernels are not skipped unnoticed."""
    assert compiled.find_spec(compiled.NAME)
    assert compiled.fault() == ""


def test_missing_kernels_are_reported(monkeypatch):
    monkeypatch.delenv(compiled.SWITCH, raising=False)
    monkeypatch.setattr(compiled, "find_spec", lambda name: None)
    monkeypatch.setattr(compiled, "fault", compiled.fault.__wrapped__)
    with pytest.warns(SlowUpdate, match=r"20 times slower: no kernels were built; install a C\+\+ compiler"):
        assert not compiled.in_use.__wrapped__()
    assert compiled.described().startswith("numpy: no kernels were built")


def test_the_command_line_says_in_one_line_that_it_is_slow(tmp_path):
    """Without compiled kernels."""
    program = (
        "from contact_tracker.hypotheses import compiled;"
        "compiled.find_spec = lambda name: None;"
        "from contact_tracker.cli.main import run;"
        f"run(['segment', {str(RECORDING)!r}, '--duration', '1'])"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    lines = [line for line in found.stderr.splitlines() if "slower" in line]
    assert len(lines) == 1
    assert lines[0].startswith("contact-tracker: warning: runs in numpy, some 20 times slower: no kernels")
    assert "install a C++ compiler" in lines[0]
    assert "Traceback" not in found.stderr


def test_an_unrelated_folder_of_the_same_name_is_ignored(tmp_path, monkeypatch):
    (tmp_path / "__init__.py").write_text("")
    monkeypatch.setattr(compiled, "SOURCES", tmp_path)
    assert compiled.fault.__wrapped__() == compiled.fault()


def test_kernels_of_other_sources_are_not_used(tmp_path, monkeypatch):
    """In a work tree that has changed since the installation."""
    (tmp_path / "python").mkdir()
    (tmp_path / "CMakeLists.txt").write_text("")
    (tmp_path / "python" / "module.cpp").write_text("// another algorithm")
    monkeypatch.setattr(compiled, "SOURCES", tmp_path)
    fault = compiled.fault.__wrapped__()
    assert fault == "their sources have changed since, install the package again"
    monkeypatch.setattr(compiled, "fault", lambda: fault)
    with pytest.warns(SlowUpdate, match="their sources have changed"):
        assert not compiled.in_use.__wrapped__()
    assert compiled.described() == f"numpy: {fault}"


def test_kernels_that_cannot_be_loaded_are_not_used(monkeypatch):
    def broken(name):
        raise ImportError("another\nPython")

    monkeypatch.setattr(compiled, "import_module", broken)
    assert compiled.fault.__wrapped__() == "they cannot be loaded, another Python"


@pytest.mark.parametrize("reason", [KeyboardInterrupt(), SystemExit(143)])
def test_an_interrupt_while_kernels_load_is_one(monkeypatch, reason):
    """Whatever error the interrupt causes during the import."""

    def load(name):
        raise ImportError("initialization failed") from reason

    monkeypatch.setattr(compiled, "import_module", load)
    with pytest.raises(type(reason)):
        compiled.fault.__wrapped__()
