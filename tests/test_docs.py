"""The documentation is correct: its Python runs, and tables agree with the code."""

import ast
import math
import re
from dataclasses import fields, is_dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import document
from contact_tracker.batch.segmenting import SUMMARY_COLUMNS
from contact_tracker.config import preset_names
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, write_recording
from contact_tracker.recording.decoding import POSE_TYPES
from contact_tracker.states import Contact
from page_steps import FENCED, Step, assert_shown, carried_out, steps

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tracker" / "contact_tracker"
LAB = ROOT / "tracker" / "contact_tracker_lab"
CONVENTIONS = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
MODELS = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
EXAMPLES = ROOT / "docs" / "examples"
README = (ROOT / "README.md").read_text(encoding="utf-8")


def with_short_recording(folder: Path, name: str) -> Path:
    """The first two seconds of one of the repository's recordings, under the same name."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    first = Poses.collect(islice(open_log(str(ROOT / name)), 400))
    write_recording(str(folder / name), first, None, {})
    return folder


def test_the_python_of_the_readme_runs(tmp_path: Path) -> None:
    (block,) = [text for language, text in FENCED.findall(README) if language == "python"]
    (name,) = set(re.findall(r"recordings/\w+\.mcap", block))
    done = carried_out(Step("python", block, ""), with_short_recording(tmp_path, name))
    assert done.returncode == 0, done.stderr
    table, ticks = done.stdout.split("\n1700000000", 1)
    assert table.split()[:4] == ["start", "s", "end", "s"]
    lines = [line.split() for line in f"1700000000{ticks}".splitlines()]
    assert len(lines) > 10
    assert all(stamp.isdecimal() and contact in list(Contact) for stamp, contact, _ in lines)


def test_the_first_command_of_the_readme_makes_a_figure(tmp_path: Path) -> None:
    step = next(steps(README))
    names = re.findall(r"\(`(time,\S+)`\)", README)
    first = Poses.collect(islice(open_log(str(ROOT / "recordings/mug_first_take.mcap")), 200, 250))
    turns = Rotation.from_quat(first.quat_xyzw).as_euler("xyz", degrees=True)
    values = np.column_stack([1e-9 * (first.stamp_ns - first.stamp_ns[0]), 1e3 * first.position_m, turns])
    np.savetxt(tmp_path / "take.csv", values, delimiter=",", header=names[0], comments="")
    done = carried_out(step, tmp_path)
    assert (done.returncode, "warning" in done.stderr) == (0, False), done.stderr
    assert (tmp_path / "take.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_the_output_in_the_readme_is_printed() -> None:
    code, shown = next((step.code, step.shown) for step in steps(README) if step.shown)
    (command,) = re.findall(r"contact-tracker live \S+$", code)
    step = Step("bash", command, shown)
    assert_shown(step, str(carried_out(step, ROOT).stdout))
    assert shown.endswith("\n...\n")


@pytest.mark.long
def test_the_page_on_python_runs_from_top_to_bottom(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    code = "\n".join(text for language, text in FENCED.findall(page) if language == "python")
    with_short_recording(tmp_path, "recordings/paper_experiment.mcap")
    done = carried_out(Step("python", code, ""), tmp_path)
    assert done.returncode == 0, done.stderr
    made = {
        "labels.png",
        "ticks.parquet",
        "for_foxglove.mcap",
        "report.html",
        "segments.csv",
        "tracker.state",
    }
    assert made <= {path.name for path in tmp_path.iterdir() if path.stat().st_size > 0}


@pytest.mark.long
def test_the_page_on_batches_runs_from_top_to_bottom(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    for name in ("paper_experiment", "vision_30hz"):
        with_short_recording(tmp_path, f"recordings/{name}.mcap")
    (tmp_path / "recordings").rename(tmp_path / "logs")
    (tmp_path / "logs" / "broken.mcap").write_bytes(b"")
    found = [carried_out(step, tmp_path) for step in steps(page) if step.language == "bash"]
    assert [done.returncode for done in found] == [3, 3], [done.stderr for done in found]
    assert "3 new or changed" in found[0].stderr
    assert "3 unchanged" in found[1].stderr
    code = "\n".join(text for language, text in FENCED.findall(page) if language == "python")
    done = carried_out(Step("python", code, ""), tmp_path)
    assert done.returncode == 0, done.stderr
    assert "broken.mcap: it is empty" in done.stdout
    assert (tmp_path / "segments.parquet").stat().st_size > 0


def test_the_page_on_batches_names_every_column() -> None:
    page = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    table = page.partition("| column of the summary |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", table))
    written = {name for name in SUMMARY_COLUMNS if not re.match(r"(segments|time)_[a-z]{2,4}(_s)?$", name)}
    assert written <= named
    assert {"segments_ff", "segments_free", "time_ff_s", "time_free_s"} <= named & SUMMARY_COLUMNS.keys()


@pytest.mark.long
def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tracker"))
    notebook = nbformat.read(EXAMPLES / "first_steps.ipynb", as_version=4)
    resources = {"metadata": {"path": str(EXAMPLES)}}
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [kind for output in outputs for kind in output.get("data", {})]
    assert "text/html" in shown
    assert "image/png" in shown
    assert float(outputs[-1]["data"]["text/plain"]) > 0.8


def counted_kinds() -> set[str]:
    """The names under which the gate and the reader count what they drop or repair."""
    kinds: set[str] = set()
    for name in (
        "motion/pose_validation.py",
        "motion/excursions.py",
        "recording/log.py",
        "recording/sources.py",
        "recording/transforms.py",
    ):
        for node in ast.walk(ast.parse((PACKAGE / name).read_text(encoding="utf-8"))):
            match node:
                case (
                    ast.Subscript(value=ast.Name("counts"), slice=ast.Constant(kind))
                    | ast.Subscript(value=ast.Attribute(attr="_counts" | "counts"), slice=ast.Constant(kind))
                ):
                    kinds.add(str(kind))
                case ast.Subscript(
                    value=ast.Attribute(attr="counts"),
                    slice=ast.IfExp(body=ast.Constant(one), orelse=ast.Constant(other)),
                ):
                    kinds |= {str(one), str(other)}
    return kinds


def test_the_conventions_name_every_count() -> None:
    table = CONVENTIONS.partition("| kind |")[2]
    by_the_tracker = {"outlier", "late"}
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == counted_kinds() | by_the_tracker


def test_every_input_format_names_existing_tests() -> None:
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if re.match(r"\| (?!---|file|type|encoding)", line)]
    assert len(rows) > 20
    for row in rows:
        named = re.findall(r"`(test_\w+\.py)(?:: (test_\w+))?`", row)
        assert named, row
        for file, test in named:
            (path,) = (ROOT / "tests").rglob(file)
            source = path.read_text(encoding="utf-8")
            assert f"def {test or 'test_'}" in source, row


def test_every_pose_type_is_in_the_table_of_formats() -> None:
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    for name in POSE_TYPES:
        assert re.split(r"[/.]", name)[-1] in text, name


def tables_of(kind: Any, name: str = "") -> dict[str, Any]:
    """A model's tables by their names in the file."""
    tables = {name: kind}
    for f in fields(kind):
        if is_dataclass(f.type):
            tables |= tables_of(f.type, f"{name}.{f.name}".lstrip("."))
    return tables


def test_the_models_page_names_every_parameter_under_its_table() -> None:
    page = MODELS.partition("## Parameters")[2].partition("\n## ")[0]
    pages = re.split(r"^`\[([\w.]+)\]`", page, flags=re.M)
    named = {"": pages[0], **dict(zip(pages[1::2], pages[2::2], strict=True))}
    tables = tables_of(Model)
    assert named.keys() == tables.keys()
    for name, kind in tables.items():
        wanted = {f.name for f in fields(kind) if not is_dataclass(f.type)}
        rows = re.findall(r"^\| `(\w+)` \|", named[name], re.MULTILINE)
        assert sorted(rows) == sorted(wanted), name or "top"


def test_the_models_page_names_every_preset_and_its_noise() -> None:
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([\d.]+) mm, ([\d.]+) deg \|$", MODELS, re.MULTILINE)
    assert sorted(name for name, *_ in rows) == preset_names()
    for name, sigma_mm, sigma_deg in rows:
        noise = load_model(name).noise
        assert math.isclose(float(sigma_mm), noise.sigma_position_m * 1e3, rel_tol=0.03)
        assert math.isclose(float(sigma_deg), math.degrees(noise.sigma_rotation_rad), rel_tol=0.03)


def test_links_lead_somewhere() -> None:
    for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")]:
        for target in re.findall(r"\]\(([^)#\s]+)", path.read_text(encoding="utf-8")):
            assert "://" in target or (path.parent / target).exists(), f"{path.name} links to {target}"


@pytest.mark.parametrize("page", ["architecture.md", "glossary.md", "theory.md"])
def test_names_in_pages_on_the_code_exist(page):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    named = re.findall(r"`([a-z_0-9/]+(?:\.[a-z]{2,3}|/))(?:: ([a-z_]+))?`", text)
    assert len(named) > 25
    for path, function in named:
        places = [PACKAGE / path, LAB / path, ROOT / "tracker" / path, ROOT / path]
        places += PACKAGE.glob(f"*/{path}")  # in the package that the line is about
        found = [place for place in places if place.exists()]
        assert found, path
        assert not function or f"def {function}(" in found[0].read_text(encoding="utf-8"), function


def test_the_tables_of_the_benchmarks_are_those_of_the_kept_files() -> None:
    assert document.main(["--check"]) == 0
    texts = [one.read_text(encoding="utf-8") for one in document.DOCUMENTS]
    counts = [len(document.SECTION.findall(text)) for text in texts]
    assert counts == [text.count(": begin -->") for text in texts]
    assert counts[0] >= 7
    assert max(len(text.splitlines()) for text in texts) <= 250
