"""Two takes compared: a simulated one and itself with known changes."""

import csv
import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

import contact_tracker
from command_line import run
from contact_tracker.errors import DIFFERENT, ContactTrackerWarning, UsageError
from contact_tracker.exports.sequence_figures import draw_comparison
from contact_tracker.geometry.elements import ContactGeometry, Line, Origins, Plane, Point, shifted
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.recording import write_recording
from contact_tracker.sequences.comparison import Verdict, compare_outcomes
from contact_tracker.sequences.steps import distances, sighting_of, steps_of
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.segmentation import BELIEF, Beliefs
from contact_tracker_lab.simulate import simulate
from contact_tracker_lab.simulate.scenarios import Phase, Scenario
from mcap_logs import poses_topic, smooth_poses, write_log
from pose_tables import NAMES as COLUMNS
from pose_tables import POSE, TURN, P, T

NAMES = ("e-f", "v-f", "e-f", "f-f")
UP_M = 0.02


@pytest.fixture(scope="module")
def simulated():
    return simulate(Scenario(tuple(Phase(Contact(name), 3.5) for name in NAMES), rate_hz=60.0), 8)


@pytest.fixture(scope="module")
def first(simulated):
    columns = simulated.poses.columns
    return contact_tracker.segment(contact_tracker.Trajectory.from_arrays(*columns, time_unit="ns"))


def with_segments(result, segments):
    """A take with these segments of ``result``, one after another, whose beliefs are as sure as they say."""
    end_ns, moved, sightings, rows = result.segments[0].start_ns, [], [], []
    for number, one in enumerate(segments):
        start_ns, end_ns = end_ns, end_ns + one.end_ns - one.start_ns + 1
        moved.append(replace(one, start_ns=start_ns, end_ns=end_ns - 1))
        part = np.zeros((end_ns - start_ns) // 100_000_000, BELIEF)
        part["stamp_ns"] = start_ns + 100_000_000 * np.arange(len(part))
        part["probability"] = np.full(len(STATES), (1.0 - one.probability) / 6)
        part["probability"][:, one.contact.column] = one.probability
        rows.append(part)
        if (seen := sighting_of(one, result.touched)) is not None:
            sightings.append(replace(seen, first=number, onset_ns=start_ns, stamp_ns=end_ns))
    changed = replace(result.segmentation, segments=tuple(moved), beliefs=Beliefs(np.concatenate(rows)))
    touched = replace(result.touched, sightings=tuple(sightings), pairs={}, elements={})
    return contact_tracker.Result(**vars(result) | {"segmentation": changed, "touched": touched})


def verdicts(found):
    return [step.verdict for step in found.steps]


@pytest.mark.parametrize(
    ("kept", "expected"),
    [
        ((0, 1, 2, 3), ["same"] * 4),
        ((0, 1, 3), ["same", "same", "missing", "same"]),
        ((0, 1, 2, 3, 1), ["same", "same", "same", "same", "new"]),
        ((1, 2, 3), ["missing", "same", "same", "same"]),
    ],
)
def test_steps_that_are_missing_and_new(first, kept, expected) -> None:
    """Where both takes are sure of all steps."""
    sure = [replace(segment, probability=0.99) for segment in first.segments]
    first, second = with_segments(first, sure), with_segments(first, [sure[k] for k in kept])
    result = compare_outcomes(first, second)
    assert verdicts(result) == expected
    turned = compare_outcomes(second, first)
    names = {Verdict.MISSING: Verdict.NEW, Verdict.NEW: Verdict.MISSING}
    assert sorted(verdicts(turned)) == sorted(names.get(one, one) for one in verdicts(result))


def test_a_sure_contact_is_no_part_of_a_step_of_another(first) -> None:
    """It was one step with the free motion before and behind it, as its doubtful boundaries fit both."""
    face = replace(first.segments[3], probability=0.99)
    free = replace(face, contact=Contact.FREE, geometry=None, probability=0.95)
    whole = with_segments(first, [free, face, free, face, free])
    blurred = whole.beliefs.rows.copy()
    before, after = np.roll(blurred["probability"], 1, axis=0), np.roll(blurred["probability"], -1, axis=0)
    blurred["probability"] = (before + blurred["probability"] + after) / 3.0
    whole = contact_tracker.Result(
        **vars(whole) | {"segmentation": replace(whole.segmentation, beliefs=Beliefs(blurred))}
    )
    result = compare_outcomes(with_segments(first, [free, face, free]), whole)
    assert all(len({part.contact for part in step.second}) <= 1 for step in result.steps)
    assert Verdict.OPEN in verdicts(result)  # which of the two it is in the first take


@pytest.mark.parametrize(("factor", "verdict"), [(2.0, "longer"), (0.4, "shorter"), (1.1, "same")])
def test_a_step_that_takes_another_time(first, factor, verdict) -> None:
    own = first.segments[1]
    duration_ns = round(factor * (own.end_ns - own.start_ns))
    changed = replace(own, end_ns=own.start_ns + duration_ns)
    # of the first contact: its sighting is that of its time
    result = compare_outcomes(first, with_segments(first, [first.segments[0], changed, *first.segments[2:]]))
    assert verdicts(result) == ["same", verdict, "same", "same"]
    by_s = (factor - 1.0) * (own.end_ns - own.start_ns) * 1e-9
    assert result.steps[1].longer_s == pytest.approx(by_s, abs=0.01)


def test_moved_surroundings_are_said_and_not_compared(first) -> None:
    touched = first.touched
    away_m = np.array([0.1, 0.05, -0.2])
    origins = Origins(touched.origins.world_m + away_m, touched.origins.body_m)
    moved = contact_tracker.Result(**vars(first) | {"touched": replace(touched, origins=origins)})
    with pytest.warns(ContactTrackerWarning, match="no touched element of the surroundings"):
        result = contact_tracker.compare(first, moved)
    assert Verdict.ELSEWHERE not in verdicts(result)
    assert "warning: no touched element" in str(result)


def test_a_moved_step_is_elsewhere_by_how_far(first) -> None:
    """The vertex touches 2 cm higher, while the other steps are where they were."""
    vertex = first.segments[1]
    up_m = UP_M * vertex.geometry.environment.normal
    sightings = list(first.touched.sightings)
    number = sightings.index(sighting_of(vertex, first.touched))
    seen = sightings[number].estimate
    x = seen.x.copy()
    x[seen.model.family.FORM.h] += UP_M * np.sign(x[seen.model.family.FORM.d2 :][:3] @ up_m)
    sightings[number] = replace(sightings[number], estimate=replace(seen, x=x))
    geometry = ContactGeometry(vertex.geometry.object, shifted(vertex.geometry.environment, up_m))
    segments = (first.segments[0], replace(vertex, geometry=geometry), *first.segments[2:])
    moved = contact_tracker.Result(
        **vars(first)
        | {
            "segmentation": replace(first.segmentation, segments=segments),
            "touched": replace(first.touched, sightings=tuple(sightings)),
        }
    )
    step = compare_outcomes(first, moved).steps[1]
    assert (step.verdict, step.moved) == (Verdict.ELSEWHERE, "surroundings")
    assert step.surroundings.shift_m == pytest.approx(UP_M)
    assert 0.0 < step.surroundings.shift_sd_m < 0.01
    assert step.object.shift_m == pytest.approx(0.0)
    assert f"elsewhere 1.00  {1e3 * UP_M:.1f}+/-" in str(compare_outcomes(first, moved))


@pytest.mark.parametrize("kind", [Plane, Line])
@pytest.mark.parametrize("angle_deg", [0.5, 30.0, 88.0])
def test_the_angle_of_two_elements(first, kind, angle_deg) -> None:
    step, sd_rad = steps_of(first)[1], np.radians(0.1)
    parts = []
    for angle in np.radians([0.0, angle_deg]):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.eye(3) - np.outer(direction, direction)
        covariance = np.zeros((4, 4) if kind is Plane else (6, 6))
        covariance[:3, :3] = sd_rad**2 * across
        rest = (0.0,) if kind is Plane else (np.zeros(3),)
        element = kind(direction, *rest, covariance=covariance)
        segment = replace(step.segment, geometry=ContactGeometry(Point(np.zeros(3)), element))
        parts.append(replace(step, segment=segment, sighting=None))
    world = GrowingMap(0.3)
    _, surroundings = distances(*parts, world, world, (np.zeros(3), np.zeros(3)))
    assert np.degrees(surroundings.turn_rad) == pytest.approx(angle_deg)
    assert surroundings.turn_sd_rad == pytest.approx(np.sqrt(2.0) * sd_rad)


def test_places_are_not_compared_where_elements_are_given(first) -> None:
    result = compare_outcomes(first, contact_tracker.Result(**vars(first) | {"touched": None}))
    assert [note for note in result.notes if "given" in note]
    assert not result.differences


def test_takes_without_a_common_element_have_a_warning(first) -> None:
    """As of another object in another place: contacts alone may be the same."""
    other = contact_tracker.Result(**vars(first) | {"touched": replace(first.touched, sightings=())})
    for takes in ((first, other), (other, first)):
        (note,) = compare_outcomes(*takes).notes
        assert "no touched element in common" in note
    assert not compare_outcomes(first, first).notes


def test_a_step_that_is_probably_missing_is_shown_as_such(first) -> None:
    step = replace(compare_outcomes(first, first).steps[0], verdict=Verdict.OPEN, probability=0.84)
    for sides, shown in (({"second": ()}, "missing?"), ({"first": ()}, "new?"), ({}, "open")):
        row = [*replace(compare_outcomes(first, first), steps=(replace(step, **sides),)).lines()][1]
        assert shown in row.split()


def test_open_segments_are_no_difference(first) -> None:
    others = tuple(state for state in STATES if state is not Contact.VF)
    opened = replace(first.segments[1], inseparable=others, probability=0.4)
    second = with_segments(first, [first.segments[0], opened, *first.segments[2:]])
    name = "a$_{b$c.mcap"
    result = compare_outcomes(first, replace(second, trajectory=replace(first.trajectory, name=name)))
    assert verdicts(result) == ["same", "open", "same", "same"]
    for steps, told in (
        (result.steps, "3 same, 1 open: no step is known to differ"),
        (result.steps[1:2], "1 open: whether steps differ is not known"),
        ((), "neither take has a step"),
    ):
        assert [*replace(result, steps=steps).lines()][-1] == told
    figure = draw_comparison(result)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert shown == ["step same", "step open", "open: others fit"]
    assert axes.get_title("left").splitlines() == [f"A: {first.trajectory.name}", f"B: {name}"]


@pytest.mark.parametrize(("ticks", "probability", "count"), [(1, 0.3, 4), (1, 0.99, 5), (20, 0.3, 5)])
def test_an_unsure_row_of_one_tick_is_no_step(first, ticks, probability, count) -> None:
    """In the second take a flicker between two steps is part of one of them; a sure or long row is a step."""
    sure = [replace(segment, probability=0.99) for segment in first.segments]
    others = tuple(state for state in STATES if state is not Contact.FV)
    flicker = replace(
        sure[1],
        contact=Contact.FV,
        end_ns=sure[1].start_ns + ticks * 100_000_000 - 1,
        probability=probability,
        inseparable=others if probability < 0.9 else (),
        geometry=None,
    )
    takes = with_segments(first, sure), with_segments(first, [*sure[:2], flicker, *sure[2:]])
    assert len(compare_outcomes(*takes).steps) == count
    assert len(compare_outcomes(*takes[::-1]).steps) == count


def test_boundaries_are_as_sure_as_the_beliefs(first, simulated) -> None:
    true_s = [(interval.start_ns - first.origin_ns) * 1e-9 for interval in simulated.truth.intervals]
    for one in steps_of(first)[1:]:
        assert np.abs(np.array(true_s) - one.start_s).min() < 4.0 * one.boundary_sd_s[0] + 0.1


def test_what_python_makes_of_it(first, tmp_path) -> None:
    result = contact_tracker.compare(first, with_segments(first, first.segments[:2]))
    table = result.to_pandas()
    assert list(table.verdict) == [step.verdict for step in result.steps]
    assert all(len(line) <= 80 for line in str(result).splitlines())
    result.save(tmp_path / "steps.csv")
    rows = list(csv.DictReader((tmp_path / "steps.csv").open()))
    assert [row["verdict"] for row in rows] == list(table.verdict)
    assert list(rows[0]) == list(table)
    result.save(tmp_path / "steps.png")
    assert (tmp_path / "steps.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(UsageError, match=r"\.csv"):
        result.save(tmp_path / "steps.txt")
    with pytest.raises(UsageError, match="tolerance"):
        contact_tracker.compare(first, first, tolerance=0.0)


def test_the_command(first, simulated, tmp_path, monkeypatch) -> None:
    takes = iter([first, with_segments(first, first.segments[:2]), first, first])
    monkeypatch.setattr("contact_tracker.cli.source.segmented", lambda *_, **__: next(takes))
    for name in "ab":
        write_recording(str(tmp_path / f"{name}.mcap"), simulated.poses, None, {})
    done = run("compare", "a.mcap", "b.mcap", "--json", cwd=tmp_path)
    assert done.returncode == DIFFERENT, done.stderr
    assert "missing" in [one["verdict"] for one in json.loads(done.stdout)["steps"]]
    done = run("compare", "a.mcap", "b.mcap", "-o", "steps.svg", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "4 same: no step is known to differ"
    assert (tmp_path / "steps.svg").stat().st_size > 1000


def test_saved_results_are_compared(first, simulated, tmp_path) -> None:
    first.save(tmp_path / "a.contacts")
    first.save(tmp_path / "b.contacts")
    done = run("compare", "a.contacts", "b.contacts", "-q", "-o", "steps.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{contact_tracker.compare(first, first)}\n"
    done = run("compare", "a.contacts", "b.contacts", "--start", 5, cwd=tmp_path)
    assert done.returncode == 2
    assert "give options of poses to segment" in done.stderr
    write_recording(str(tmp_path / "c.mcap"), simulated.poses, None, {})
    for command in ("segment", "live", "view", "info", "evaluate", "batch", "calibrate"):
        assert "a.contacts is a saved result" in run(command, "a.contacts", cwd=tmp_path).stderr
    done = run("compare", "a.contacts", "c.mcap", cwd=tmp_path)
    assert done.stdout.splitlines()[-1] == "4 same: no step is known to differ", done.stderr


def proposed(done):
    """The arguments of the commands that an error names."""
    pattern = r"contact-tracker ((?:segment|compare) .*?)(?=; then|, with|\. Orders|\n)"
    return [shlex.split(line) for line in re.findall(pattern, done.stderr)]


@pytest.mark.parametrize("options", [[], ["--unit", "mm", "--euler", "xyz:deg", "--tolerance", 0.5]])
@pytest.mark.parametrize("names", ["ab", "ba"])
def test_takes_that_need_different_options_are_compared_by_the_commands_of_the_error(
    tmp_path, names, options
) -> None:
    rows = {"t,x,y,z,rx,ry,rz": [1e3 * P, TURN.as_euler("xyz", degrees=True)], f"t,{COLUMNS}": [POSE]}
    for name, (header, columns) in zip("ab", rows.items(), strict=True):
        table = np.column_stack([T, *columns])
        np.savetxt(tmp_path / f"{name}.csv", table, "%.9f", ",", header=header, comments="")
    done = run("compare", *(f"{name}.csv" for name in names), *options, "--duration", 1, cwd=tmp_path)
    assert done.returncode == 2
    segment, compare = proposed(done)
    assert "--tolerance" not in segment
    assert run(*segment, cwd=tmp_path).returncode == 0
    assert run(*compare, cwd=tmp_path).returncode == 0


def test_takes_with_different_topics_are_compared_by_the_commands_of_the_error(tmp_path) -> None:
    for name in "ab":
        topics = [poses_topic(smooth_poses(100, seed=seed), f"/{name}{seed}") for seed in range(2)]
        write_log(tmp_path / f"{name}.mcap", topics[: 2 if name == "a" else 1])
    assert "choose by --topic" in run("compare", "a.mcap", "b.mcap", cwd=tmp_path).stderr
    done = run("compare", "a.mcap", "b.mcap", "--topic", "/a1", cwd=tmp_path)
    segment, compare = proposed(done)
    assert run(*segment, cwd=tmp_path).returncode == 0
    assert run(*compare, cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a", "-"], "not -"),
        (["a", "b", "-o", "a.mcap"], "must end"),
        (["a", "b", "--tolerance", "0"], "above"),
    ],
)
def test_wrong_usage_of_the_command(arguments, words) -> None:
    done = run("compare", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
