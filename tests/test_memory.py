"""Elements met before: what is kept of them, and what they offer to contacts that begin."""

import numpy as np
import pytest

from contact_tracker.bank import Begins
from contact_tracker.beginnings import beginnings
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry import ContactGeometry, Line, Plane, Point
from contact_tracker.knowledge import NOTHING
from contact_tracker.labels import Contact
from contact_tracker.memory import KEPT, LENGTH_M, Memory

ORIGIN = np.zeros(3)
ALONG = np.array([0.0, 0.6, 0.8])
EDGE = Line(ALONG, np.array([0.1, 0.0, 0.0]), 1e-8 * np.eye(6))
TABLE = Plane(np.array([0.0, 0.0, 1.0]), -0.1, 1e-8 * np.eye(4))
ON_THE_TABLE = ContactGeometry(EDGE, TABLE)


def offers(memory: Memory, contact: Contact) -> Begins:
    model = CONTACT_MODELS[contact.column]
    return beginnings(NOTHING, memory, 0.5, model, np.zeros(6), ORIGIN)


def test_nothing_met_offers_nothing():
    for model in CONTACT_MODELS:
        begins = offers(Memory(), model.contact)
        assert begins.many == 1
        assert begins.source[0] == 0
        assert begins.searched[0]


def test_the_same_elements_are_offered_again_and_shares_add_up():
    memory = Memory().learn(ON_THE_TABLE, 5, ORIGIN)
    begins = offers(memory, Contact.EF)
    assert begins.many == 4  # nothing, the edge, the table, both
    assert np.exp(begins.log_share).sum() == pytest.approx(1.0)
    assert not begins.certain.any()
    assert list(begins.searched) == [True, False, False, False]


def test_a_contact_that_goes_on_teaches_anew_and_only_the_latest_are_kept():
    memory = Memory().learn(ON_THE_TABLE, 5, ORIGIN).learn(ON_THE_TABLE, 5, ORIGIN)
    assert len(memory.object) == 1
    for onset_ns in range(10):
        memory = memory.learn(ON_THE_TABLE, onset_ns, ORIGIN)
    assert [onset for onset, _ in memory.object] == list(range(10 - KEPT, 10))
    assert memory.knows(9)
    assert not memory.knows(0)


def test_a_vertex_may_be_anywhere_on_the_edge_that_turned():
    """From e-f to v-f the plane stays, and the vertex lies on the edge."""
    memory = Memory().learn(ON_THE_TABLE, 5, ORIGIN)
    begins, size = offers(memory, Contact.VF), 7
    assert begins.many == 4
    (both,) = [i for i in range(4) if begins.known_mean[i, :3].any() and begins.known_mean[i, 3:].any()]
    information = begins.known[both]
    assert information.shape == (size, size)
    on_point = np.linalg.inv(information[:3, :3])
    assert np.sqrt(ALONG @ on_point @ ALONG) == pytest.approx(LENGTH_M, rel=0.01)
    assert np.sqrt(on_point[0, 0]) < 2e-3  # across


def test_only_the_last_edge_is_offered_to_a_vertex_beside_those_met():
    corner = ContactGeometry(Point(np.array([0.1, 0.2, 0.3]), 1e-8 * np.eye(3)), TABLE)
    memory = Memory()
    for onset_ns in range(3):
        memory = memory.learn(ON_THE_TABLE, 2 * onset_ns, ORIGIN).learn(corner, 2 * onset_ns + 1, ORIGIN)
    points = 1 + KEPT + 1  # none, those met, one on the edge
    assert offers(memory, Contact.VF).many == points * (1 + KEPT)
