"""The pages of the site run as written, and the site contains all of them."""

import hashlib
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh

from contact_tracker.motion.poses import Poses
from contact_tracker.recording import read_truth, write_recording
from contact_tracker_lab.simulate import Scenario, Simulated, named_scenario, simulate
from page_steps import FENCED, ROOT, assert_shown, carried_out, loosely, steps
from short_recordings import shipped

DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
RUN_HERE = {
    "assembly.md",
    "beliefs.md",
    "benchmarks.md",
    "contact_motion.md",
    "live_robot.md",
    "map.md",
    "models.md",
    "motion_capture.md",
    "robot_tf.md",
    "tutorial_first_segmentation.md",
    "tutorial_map.md",
}
PARTS_S: dict[str, dict[str, float]] = {
    "assembly.md": {"mug_first_take": 9.0, "mug_second_take": 9.0, "all_states": 60.0},
    "beliefs.md": {"paper_experiment": 30.0},
    "contact_motion.md": {"all_states": 17.0},
    "live_robot.md": {"paper_experiment": 10.5, "robot_1khz": 4.5},
    "models.md": {"robot_1khz": 60.0, "vision_30hz": 60.0},  # which learns from all: two of them
    "motion_capture.md": {"paper_experiment": 28.0},
    "tutorial_map.md": {"mug_first_take": 9.0, "mug_second_take": 9.0},
}
"""The first seconds of recordings on which pages run that need no more to show what they show."""
RUN_IN_TEST_DOCS = {"python.md", "batch.md"}
SET_UP = {"index.md", "formats.md"}  # how to install, which .ci/run does
LONG = {"paper.md", "reliability.md"}  # run on fewer recordings below, and by .ci/run


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def test_every_page_with_commands_is_run_somewhere() -> None:
    with_steps = {
        name for name in PAGES if {"bash", "python"} & {kind for kind, _ in FENCED.findall(page(name))}
    }
    assert with_steps == RUN_HERE | RUN_IN_TEST_DOCS | SET_UP | LONG


def test_every_page_with_the_command_says_how_it_is_found() -> None:
    with_command = {name for name in PAGES if re.search(r"^contact-tracker ", page(name), re.MULTILINE)}
    assert "motion_capture.md" in with_command
    assert {name for name in with_command if "source .venv/bin/activate" not in page(name)} == set()


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(RUN_HERE))
def test_a_page_runs_as_it_is_written(name: str, tmp_path: Path) -> None:
    if name in PARTS_S:
        write_beginnings(tmp_path / "recordings", PARTS_S[name])
    else:
        (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    (tmp_path / "models").symlink_to(ROOT / "models")
    (tmp_path / "docs").symlink_to(DOCS)
    write_samples(name, tmp_path)
    all_steps = list(steps(page(name)))
    assert all_steps
    for step in all_steps:
        done = carried_out(step, tmp_path)
        assert done.returncode == 0, f"{step.code}\n{done.stderr}"
        if step.shown:
            assert_shown(step, done.stdout)


def write_samples(name: str, folder: Path) -> None:
    """The files of the reader that a page assumes."""
    if name == "map.md":
        write_recording(str(folder / "LOG"), recorded(3.0), None, {})
        (toml, *_) = re.findall(r"^```toml\n(.*?)^```$", page(name), re.MULTILINE | re.DOTALL)
        (folder / "bench.toml").write_text(toml, encoding="utf-8")
        trimesh.creation.box((100.0, 100.0, 100.0)).export(folder / "part.stl")


def write_beginnings(folder: Path, seconds: dict[str, float]) -> None:
    """The first seconds of recordings of the repository, with their truth."""
    folder.mkdir()
    for name, most_s in seconds.items():
        poses = shipped(name)
        first = poses[: int(poses.stamp_ns.searchsorted(poses.stamp_ns[0] + most_s * 1e9))]
        truth = read_truth(str(ROOT / "recordings" / f"{name}.mcap"))
        write_recording(str(folder / f"{name}.mcap"), first, truth, {})


def recorded(seconds: float) -> Poses:
    """The paper's experiment after its rest."""
    return shipped("paper_experiment")[1000 : 1000 + round(200 * seconds)]


@pytest.mark.long
def test_the_page_on_the_paper_is_the_output_of_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(DOCS / "examples"))
    import paper
    import paper_replication

    def simulate_shortly(scenario: str | Scenario, seed: int) -> Simulated:
        whole = named_scenario(scenario, seed) if isinstance(scenario, str) else scenario
        phases = tuple(phase._replace(duration_s=0.5 * phase.duration_s) for phase in whole.phases)
        return simulate(replace(whole, phases=phases), seed)

    monkeypatch.setattr(paper_replication, "simulate", simulate_shortly)
    monkeypatch.setattr(paper, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))
    paper.main(["--recordings", "1", "--slsqp-every", "200", "--docs", str(tmp_path)])
    written = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert without_figures(written) == without_figures(page("paper.md"))
    for name in ("geometry", "sequence_white", "sequence_filtered"):
        assert (tmp_path / "images" / f"paper_{name}.png").stat().st_size > 10_000


def without_figures(text: str) -> list[str]:
    return [re.sub(r"^\| N ", "| ", line) for line in loosely(text)]


def test_the_gallery_says_what_was_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of nothing that is found, and of a file with another content, beside the page as it is."""
    monkeypatch.syspath_prepend(str(DOCS / "examples"))
    import gallery

    (tmp_path / "examples").symlink_to(DOCS / "examples")
    (tmp_path / "06_drawer.mcap").write_bytes(b"another")
    monkeypatch.setattr(gallery, "DOCS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["gallery.py", str(tmp_path)])
    gallery.main()
    written, published = (tmp_path / "gallery.md").read_text(encoding="utf-8"), page("gallery.md")
    heads = re.findall(r"^## .*", written, re.MULTILINE)
    assert heads == re.findall(r"^## .*", published, re.MULTILINE)
    assert written.count("Not run here.") == len(heads) == len(capsys.readouterr().err.splitlines())
    for kind in ("contact-tracker", "From"):
        lines = re.compile(rf"^{kind} .*", re.MULTILINE)
        assert lines.findall(written) == lines.findall(published)
    command = "contact-tracker segment 06_drawer.mcap --known k.toml"
    entry = {"name": "", "source": "", "asks": "", "command": command}
    entry["sha256"] = hashlib.sha256(b"another").hexdigest()
    assert gallery.section(1, entry, tmp_path).endswith("Not run here.\n")
    assert "k.toml is absent" in capsys.readouterr().err
    for picture in re.findall(r"\(images/(.*)\)", published):
        assert (DOCS / "images" / picture).stat().st_size > 10_000


@pytest.mark.long
def test_the_pictures_of_the_contacts_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS / "examples"))
    import contact_pictures

    for contact in contact_pictures.CONTACTS:
        figure = contact_pictures.draw_contact(contact)
        assert figure.axes
        assert contact_pictures.path_of(contact).exists()


def test_every_page_is_in_the_navigation() -> None:
    listed = re.findall(
        r"(?:: |- )([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert sorted(listed) == PAGES


def test_formulas_become_mathml(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import mkdocs_hooks

    html = mkdocs_hooks.on_page_content(
        r'<span class="arithmatex">\(n\cdot x &lt; h\)</span>', None, None, None
    )
    assert html.startswith("<math")
    assert "&#x0003C;" in html
    assert "arithmatex" not in html
    assert sys.modules["mkdocs_hooks"].OUTWARD.sub(r"\1", "[a](../models/b.toml) [c](d.md)") == "a [c](d.md)"


def test_descriptions_of_parameters_are_no_types(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import docstring_descriptions

    parameters = "a, b : (N, 3), in m;\n    of : all.\nc : one.\n\nReturns\n-------\nd : x"
    before = f"Say.\n\nParameters\n----------\n{parameters}"
    after = docstring_descriptions.with_descriptions_below(before)
    parameters = after.partition("----------\n")[2]
    assert parameters == "a, b\n    (N, 3), in m;\n    of : all.\nc\n    one.\n\nReturns\n-------\nd : x"
