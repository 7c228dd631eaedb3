"""A plan followed by beliefs, its file, the graph of contacts, and both as outputs."""

import json
import re
from itertools import pairwise
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

import contact_tracker
from command_line import run
from contact_tracker.errors import DIFFERENT, UsageError
from contact_tracker.recording import write_recording
from contact_tracker.sequences import plan as plan_module
from contact_tracker.sequences.plan import Plan, PlanFollower, PlannedStep
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief
from short_recordings import FACE_TO_EDGE, recorded

TICK_NS = 100_000_000
PLAN = """
[[step]]
contact = "f-f"
duration_s = 3
[[step]]
contact = "e-f|v-f"
optional = true
[[step]]
contact = "free"
duration_s = 2
[[step]]
contact = "f-f"
duration_s = 3
"""


@pytest.fixture
def plan(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    return Plan.read(str(tmp_path / "plan.toml"))


def beliefs(*steps, p=0.97, delay=5):
    """Of a tracker that needs ``delay`` ticks to be as sure as ``p`` of each of (contact, seconds)."""
    stamp_ns = 0
    for name, seconds in steps:
        column = Contact(name).column
        for tick in range(round(seconds * 10)):
            share = p if tick >= delay else 1.0 / 7 + (p - 1.0 / 7) * tick / delay
            probability = np.full(7, (1.0 - share) / 6)
            probability[column] = share
            stamp_ns += TICK_NS
            yield Belief(stamp_ns, Contact(name), probability, 0, None, np.full(6, np.nan))


def followed(plan, *steps):
    follower = PlanFollower(plan)
    return [follower.update(belief) for belief in beliefs(*steps)], follower


@pytest.mark.parametrize(
    "steps",
    [
        [("f-f", 3.0), ("e-f", 2.0), ("free", 2.0), ("f-f", 3.0)],
        [("f-f", 2.6), ("v-f", 1.5), ("free", 2.5), ("f-f", 3.5)],
        [("f-f", 3.3), ("free", 1.5), ("f-f", 3.0)],
    ],
)
def test_a_stream_on_the_plan_is_followed(plan, steps) -> None:
    found, follower = followed(plan, *steps)
    assert not follower.has_left
    assert max(one.p_left for one in found) < 0.9
    assert found[-1].step == 4
    assert found[-1].following is None
    certain = [one.step for one in found if one.probability > 0.9]
    assert all(before <= after for before, after in pairwise(certain))


@pytest.mark.parametrize("duration_sd", [0.05, 0.25])
@pytest.mark.parametrize("tick_s", [0.1, 2.0])
def test_time_passes_as_planned_whatever_the_ticks(duration_sd, tick_s) -> None:
    """Also with steps that are short beside the deviation, and over gaps."""
    short = [PlannedStep((Contact(name),), 1.0) for name in ("f-f", "e-f", "free", "v-f")]
    follower = PlanFollower(Plan((*short, PlannedStep(STATES)), duration_sd))
    flat = np.full(7, 1.0 / 7)  # that say nothing
    for tick in range(round(2.0 / tick_s) + 1):
        found = follower.update(Belief(round(tick * tick_s * 1e9), Contact.FREE, flat, 0, None, flat))
    assert found.step in (2, 3)
    for more in range(1, round(4.0 / tick_s) + 1):
        stamp_ns = round((tick + more) * tick_s * 1e9)
        found = follower.update(Belief(stamp_ns, Contact.FREE, flat, 0, None, flat))
    assert (found.step, follower.has_left) == (5, False)


def test_parts_of_one_contact_are_one_step_that_has_to_come(monkeypatch) -> None:
    def step(duration_s: float, is_open: bool) -> SimpleNamespace:
        kept = {"probability": np.eye(7)[0], "segment": SimpleNamespace(inseparable=())}
        return SimpleNamespace(contact=Contact.FF, is_open=is_open, start_s=0.0, end_s=duration_s, **kept)

    for are_open, is_optional in (((False, True), False), ((True, True), True)):
        parts = [step(0.4, one) for one in are_open]
        monkeypatch.setattr(plan_module, "steps_of", lambda _, parts=parts: parts)
        (found,) = Plan.of(None).steps
        assert (found.is_optional, found.duration_s) == (is_optional, 0.8)


@pytest.mark.parametrize(
    ("steps", "since_s"),
    [
        ([("f-f", 3.0), ("e-e", 4.0)], 3.0),  # another contact
        ([("f-f", 3.0), ("e-f", 2.0), ("f-f", 4.0)], 5.0),  # a step is left out
        ([("f-f", 12.0)], 4.0),  # it takes too long
        ([("f-f", 0.6), ("free", 3.0)], 0.6),  # it is too short
    ],
)
def test_leaving_the_plan_is_said_once(plan, steps, since_s) -> None:
    found, follower = followed(plan, *steps)
    (tick,) = (number for number, one in enumerate(found) if one.leaves)
    assert since_s < (tick + 1) * 0.1 <= since_s + 4.0
    assert follower.has_left


def test_a_plan_is_the_same_after_its_file(plan, tmp_path) -> None:
    (tmp_path / "again.toml").write_text(plan.toml, encoding="utf-8")
    assert Plan.read(str(tmp_path / "again.toml")) == plan
    assert [step.name for step in plan.steps] == ["f-f", "e-f|v-f", "free", "f-f"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "1 to 1000 steps"),
        ("[[step]]\ncontact = 'x-f'", "x-f"),
        ("[[step]]\ncontact = 'f-f'\nseconds = 3", "seconds"),
        ("[[step]]\ncontact = 'f-f'\nduration_s = -1", "between"),
        ("duration_sd = 0\n[[step]]\ncontact = 'any'", "duration_sd"),
        ("step = 3", "table"),
        ("[[step]\n", "TOML"),
    ],
)
def test_a_wrong_plan_is_one_line(tmp_path, text, words) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="plan") as caught:
        Plan.read(str(path))
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short recording, with its plan, its graph and a figure of it."""
    folder = tmp_path_factory.mktemp("plans")
    poses = recorded(FACE_TO_EDGE).poses[::4]
    write_recording(str(folder / "log.mcap"), poses, None, {})
    result = contact_tracker.segment(folder / "log.mcap")
    for name in ("plan.toml", "graph.graphml"):
        result.save(folder / name)
    result.plot_graph().savefig(folder / "graph.png")
    return folder, result


def test_the_graph_has_all_segments_and_transitions(folder) -> None:
    path, result = folder
    root = ElementTree.parse(path / "graph.graphml").getroot()
    name = {"g": "http://graphml.graphdrawing.org/xmlns"}
    data = [
        {one.get("key"): one.text for one in node.findall("g:data", name)}
        for node in root.findall("g:graph/g:node", name)
    ]
    assert sum(int(one["count"]) for one in data) == len(result.segments)
    total_s = sum((segment.end_ns - segment.start_ns) * 1e-9 for segment in result.segments)
    assert sum(float(one["seconds"]) for one in data) == pytest.approx(total_s, abs=0.01)
    assert next(one["label"] for one in data).startswith("f-f: face")
    edges = root.findall("g:graph/g:edge", name)
    assert sum(len(times) for times in result.graph.edges.values()) == len(result.segments) - 1
    assert {(edge.get("source"), edge.get("target")) for edge in edges} == {
        (f"n{a}", f"n{b}") for a, b in result.graph.edges
    }


def test_live_says_once_that_a_plan_is_left(folder) -> None:
    path, _ = folder
    (path / "other.toml").write_text("[[step]]\ncontact='f-f'\n[[step]]\ncontact='f-v'\n", encoding="utf-8")
    done = run("live", "log.mcap", "--expect", "other.toml", cwd=path)
    assert done.returncode == DIFFERENT, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "plan: left" in line]
    assert len(line) <= 80
    assert re.search(
        r"plan: left \(p \d\.\d\d\), in or before step \d \(f-.\) of 2, (next is 2 \(f-v\)|the last step)$",
        line,
    )
    done = run("live", "log.mcap", "--expect", "plan.toml", "--state", "s", cwd=path)
    assert (done.returncode, "--state" in done.stderr) == (2, True)


@pytest.mark.long
def test_live_follows_the_plan_of_the_recording(folder) -> None:
    path, _ = folder
    done = run("live", "log.mcap", "--expect", "plan.toml", "--json", cwd=path)
    assert done.returncode == 0, done.stderr
    last = json.loads(done.stdout.splitlines()[-1])["plan"]
    assert (last["step"], last["leaves"]) == (2, False)


def test_a_figure_of_the_graph(folder) -> None:
    path, _ = folder
    assert (path / "graph.png").stat().st_size > 1000
    done = run("segment", "log.mcap", "-o", "x.csv", "--graph", cwd=path)
    assert (done.returncode, "--graph" in done.stderr) == (2, True)
