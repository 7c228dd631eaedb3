"""Offline: segments, onsets and geometry against the truth."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import pytest

from contact_tracker.exports.formats import json_line
from contact_tracker.geometry.elements import ContactGeometry, Line, Origins, Point, Unobserved
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.motion.poses import NO_OUTLIERS, Poses, batches
from contact_tracker.motion.window import Window, window_of
from contact_tracker.states import Contact
from contact_tracker.tracking.contact_filter import ContactFilter, ticks_of
from contact_tracker.tracking.offline_smoother import Segmenter, pieces
from contact_tracker.tracking.segment_fit import SegmentTicks, fit_segment
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.tracking.transition_model import tick_transitions
from pose_filter import FilteredTick, forward
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, MODEL, recorded, segmented, true_contacts

each_recording = pytest.mark.parametrize("contacts", [FACE_TO_EDGE, EDGE_TO_EDGES])


def names(segmentation):
    return " ".join(s.contact.value for s in segmentation.segments)


@each_recording
def test_segments_are_the_true_ones_and_cover_the_recording_once(contacts):
    found, simulated = segmented(contacts), recorded(contacts)
    assert names(found) == contacts
    for segment_, interval in zip(found.segments, simulated.truth.intervals, strict=True):
        assert abs(segment_.start_ns - interval.start_ns) < 0.3e9
        assert segment_.probability > 0.9
        # observed in all directions: not ambiguous
        assert segment_.inseparable == found.filtered[-1].inseparable == ()
        assert segment_.geometry.object.unobserved == segment_.geometry.environment.unobserved == ()
    held = true_contacts(simulated, found.stamp_ns)
    assert np.mean([b.contact is c for b, c in zip(found.beliefs, held, strict=True)]) > 0.95
    assert found.segments[0].start_ns == simulated.poses.stamp_ns[0]
    assert found.segments[-1].end_ns == simulated.poses.stamp_ns[-1]
    for before, after in pairwise(found.segments):
        assert before.end_ns + 1 == after.start_ns
    for belief in found.beliefs:
        (mine,) = (s for s in found.segments if s.start_ns <= belief.stamp_ns <= s.end_ns)
        assert (belief.contact, belief.onset_ns) == (mine.contact, mine.start_ns)
        assert belief.probability.sum() == pytest.approx(1.0)


@each_recording
def test_smoothing_is_better_than_filtering(contacts):
    result = segmented(contacts)
    held = true_contacts(recorded(contacts), result.stamp_ns)
    smoothed, filtered = (
        np.mean([np.log(b.probability[c.column] + 1e-12) for b, c in zip(beliefs, held, strict=True)])
        for beliefs in (result.beliefs, result.filtered)
    )
    assert smoothed > filtered
    np.testing.assert_allclose(result.beliefs[-1].probability, result.filtered[-1].probability, atol=0.02)


@cache
def ticks_seen():
    """The forward pass of a recording, tick by tick."""
    return tuple(forward(recorded(FACE_TO_EDGE).poses, MODEL))


def again_and_again(times):
    """The forward pass repeated, with the fields that the segmenter uses."""
    ticks = len(ticks_seen())
    for number in range(times):
        for seen in ticks_seen():
            before, before_ns = number * ticks, number * ticks * MODEL.tick_ns
            alive, tick, change = seen.state.live_hypotheses, seen.tick, seen.state.log_transition
            if number and seen is ticks_seen()[0]:  # hypotheses end with each repetition
                change = tick_transitions(MODEL, 1.0).log_transition
            yield FilteredTick(
                state=seen.state._replace(
                    log_transition=change,
                    outliers=NO_OUTLIERS,
                    live_hypotheses=alive._replace(onset=alive.onset + before),
                ),
                tick=replace(tick, start_ns=tick.start_ns + before_ns, stamp_ns=tick.stamp_ns + before_ns),
                belief=replace(seen.belief, stamp_ns=seen.belief.stamp_ns + before_ns),
            )


def pieces_of(poses):
    return list(pieces(ticks_of(batches(poses), MODEL), ContactFilter.start(MODEL), Segmenter()))


def in_pieces(executor=None, times=1):
    segmenter, found, most = Segmenter(executor), [], 0
    for seen in again_and_again(times):
        segmenter.note(*seen)
        if segmenter.due:
            found.append(segmenter.conclude())
            most = max(most, segmenter.open_ticks)
    return [*found, segmenter.finish()], most


def test_pieces_together_are_the_whole(monkeypatch):
    monkeypatch.setattr("contact_tracker.tracking.offline_smoother.PIECE_TICKS", 10)
    parts, most = in_pieces(times=4)
    monkeypatch.setattr("contact_tracker.tracking.offline_smoother.PIECE_TICKS", 10_000)
    (expected,), _ = in_pieces(times=4)
    result = Segmentation.join(parts)
    assert sum(len(piece.segments) > 0 for piece in parts) >= 3
    assert most < 200
    spans, expected_spans = (
        [(s.contact, s.start_ns, s.end_ns) for s in x.segments] for x in (result, expected)
    )
    assert spans == expected_spans
    np.testing.assert_array_equal(result.filtered.rows["probability"], expected.filtered.probability)
    np.testing.assert_array_equal(result.stamp_ns, expected.stamp_ns)
    np.testing.assert_allclose(result.beliefs.probability, expected.beliefs.probability, atol=1e-5)
    for a, b in zip(result.segments, expected.segments, strict=True):  # the noise estimate was less accurate
        assert a.geometry.environment.normal @ b.geometry.environment.normal > np.cos(2e-3)
    assert len(result.segments) == 8
    (nothing,) = pieces_of(())
    assert len(nothing.segments) == len(nothing.beliefs) == 0


def test_segments_do_not_depend_on_the_number_of_online_beliefs():
    poses = recorded(FACE_TO_EDGE).poses
    result = Segmentation.join(pieces_of(poses))
    expected = segmented(FACE_TO_EDGE)
    assert [b.to_json() for b in result.beliefs] == [b.to_json() for b in expected.beliefs]
    assert [s.start_ns for s in result.segments] == [s.start_ns for s in expected.segments]
    assert len(result.filtered) == 0
    assert len(expected.filtered) > 30


def test_a_full_buffer_releases_its_older_half(monkeypatch):
    monkeypatch.setattr("contact_tracker.tracking.offline_smoother.ROOM_BYTES", 30_000)
    parts, most = in_pieces()
    result = Segmentation.join(parts)
    assert len(parts) > 3
    assert most < 30
    np.testing.assert_array_equal(result.stamp_ns, segmented(FACE_TO_EDGE).stamp_ns)
    assert names(result) == FACE_TO_EDGE  # the path is the same


def test_an_object_that_stays_exactly_at_rest_fills_no_memory(monkeypatch):
    """Its ticks are skipped, and are most of what is open."""
    monkeypatch.setattr("contact_tracker.tracking.offline_smoother.ROOM_BYTES", 60_000)
    moving, sizes = recorded(FACE_TO_EDGE).poses[:600], list[int]()
    conclude = Segmenter.conclude

    def counted(self: Segmenter) -> Segmentation:
        piece = conclude(self)
        sizes.append(self._past.size)
        return piece

    monkeypatch.setattr(Segmenter, "conclude", counted)
    count, period_ns = 2500, 40_000_000
    same = Poses(
        moving.stamp_ns[-1] + period_ns * np.arange(1, count + 1),
        moving.position_m[-1:].repeat(count, axis=0),
        moving.quat_xyzw[-1:].repeat(count, axis=0),
    )
    parts = pieces_of(Poses.join([moving, same]))
    assert 2 < len(parts) < 20
    assert max(sizes) <= 60_000
    assert len(Segmentation.join(parts).stamp_ns) > 900


def test_worker_processes_give_the_same_result(monkeypatch):
    monkeypatch.setattr("contact_tracker.tracking.offline_smoother.PIECE_TICKS", 20)
    alone, _ = in_pieces()
    with ProcessPoolExecutor(1, get_context("spawn")) as executor:
        together, _ = in_pieces(executor)
    ours, theirs = Segmentation.join(alone), Segmentation.join(together)
    assert [b.to_json() for b in ours.beliefs] == [b.to_json() for b in theirs.beliefs]
    assert [s.geometry.to_json() for s in ours.segments] == [s.geometry.to_json() for s in theirs.segments]


def test_of_a_very_long_segment_the_moving_parts_are_fitted(monkeypatch):
    window = window_of([filtered.tick for filtered in ticks_seen()], MODEL).cut(0, 35)
    rest = replace(window, innovation_excess=np.full_like(window.innovation_excess, 1e-12))
    long = Window.join([rest, window, rest])
    long = replace(long, index=np.arange(len(long)))
    stretch = SegmentTicks(long, Contact.FF, MODEL, EMPTY_MAP, Origins.zero())
    monkeypatch.setattr("contact_tracker.tracking.segment_fit.PIECE_TICKS", 5)
    monkeypatch.setattr("contact_tracker.tracking.segment_fit.LONGEST_TICKS", 35)
    some = fit_segment(stretch)
    monkeypatch.setattr("contact_tracker.tracking.segment_fit.LONGEST_TICKS", 1000)
    everything = fit_segment(stretch)
    normals = [fit.geometry.environment.normal for fit in (some, everything)]
    assert abs(normals[0] @ normals[1]) > np.cos(5e-3)  # the sign of the normal is arbitrary
    assert some.inseparable == everything.inseparable


def test_beliefs_in_columns_equal_single_ones():
    expected = list(segmented(FACE_TO_EDGE).filtered[::6])
    one = expected[-1]
    ways = (Unobserved("turns_about", np.array([0.0, 0.6, 0.8])), Unobserved("shifts_along", np.eye(3)[0]))
    named = ContactGeometry(
        Point(np.array([0.1, 0.2, 0.3]), None, ways, ""), Line(np.eye(3)[2], np.ones(3), None, (), "é 中")
    )
    expected += [
        replace(one, contact=Contact.FREE, where=None, residual=np.full(6, np.nan)),
        replace(one, contact=Contact.FE, where=named, inseparable=(Contact.EF,)),
    ]

    def values(belief):
        elements = (belief.geometry.object, belief.geometry.environment) if belief.geometry else ()
        covariances = [None if e.covariance is None else e.covariance.tolist() for e in elements]
        return json_line(belief), belief.residual.tobytes(), belief.touching, covariances

    for parts in (1, 4):
        cuts = np.linspace(0, len(expected), parts + 1).astype(int)
        pieces = [Beliefs.of(expected[a:b]) for a, b in pairwise(cuts)]
        before = [piece.rows.tobytes() for piece in pieces]
        found = Beliefs.join([pieces[0][:0], *pieces])
        assert [values(a) for a in found] == [values(b) for b in expected]
        assert [values(a) for a in found[1:][::2]] == [values(b) for b in expected[1:][::2]]
        assert found.contacts == [b.contact for b in expected]
        np.testing.assert_array_equal(found.stamp_ns, [b.stamp_ns for b in expected])
        assert [piece.rows.tobytes() for piece in pieces] == before, "joining does not change the parts"
