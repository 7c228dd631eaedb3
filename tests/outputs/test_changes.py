"""Which beliefs are reported as changes: in the lines of ``live`` and in the live view."""

from dataclasses import replace

import numpy as np
import pytest

from contact_tracker.outputs.text import SAME_NS, SHORTEST_NS, Changes
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief

SETTLED, LIKELY, OPEN = 0.99, 0.8, 0.3
"""Probabilities of labels."""


def belief(stamp_ns: int, contact: Contact, p: float) -> Belief:
    """The belief in a contact, open among all states if it is not even likely."""
    others = tuple(state for state in STATES if state is not contact)
    probability = np.full(len(STATES), (1.0 - p) / len(others))
    probability[contact.column] = p
    return Belief(
        stamp_ns, contact, probability, 0, None, np.zeros(6), inseparable=others if p == OPEN else ()
    )


def reported(labels: str) -> list[tuple[int, str]]:
    """Number and label of the ticks of 0.1 s that are reported: ``FF`` is a label that has settled, ``ff``
    one beside which no other fits, though it is not certain, ``f-`` one that is open."""
    contacts = {"f": Contact.FF, "v": Contact.VF, "o": Contact.FREE}
    changes, found = Changes(), []
    for number, label in enumerate(labels.split()):
        p = OPEN if label[1] == "-" else SETTLED if label.isupper() else LIKELY
        if changes.update(belief(number * SAME_NS // 10, contacts[label[0].lower()], p))[0]:
            found.append((number, label))
    return found


@pytest.mark.parametrize(
    ("labels", "lines"),
    [
        ("f- v- vv f- o-", [(0, "f-"), (2, "vv"), (3, "f-")]),  # another label at once, unless all is open
        ("f- f- FF ff FF v-", [(0, "f-"), (2, "FF"), (5, "v-")]),  # a label that settles, once
        (f"FF{' f-' * 10} FF", [(0, "FF")]),  # doubt of less than a second
        (f"FF{' f-' * 14} FF", [(0, "FF"), (11, "f-"), (15, "FF")]),  # of a second
        (f"FF{' f-' * 8} ff{' f-' * 8} FF", [(0, "FF")]),
        (f"o-{' oo' * 14}", [(0, "o-"), (11, "oo")]),  # decided, though not certain
        (f"o-{' f-' * 14}", [(0, "o-"), (11, "f-")]),  # another label while all is open
        (f"o-{' f- v-' * 7}", [(0, "o-"), (11, "f-")]),
    ],
)
def test_a_report_holds_for_a_second_at_most_while_beliefs_differ_from_it(
    labels: str, lines: list[tuple[int, str]]
) -> None:
    assert reported(labels) == lines


def test_a_short_last_tick_has_no_report_beside_that_of_the_tick_before() -> None:
    changes = Changes()
    given = [(SAME_NS, LIKELY), (SAME_NS + SHORTEST_NS // 2, SETTLED)]
    assert changes.update(belief(0, Contact.FREE, SETTLED))[0]
    assert [changes.update(belief(at, Contact.FF, p))[0] for at, p in given] == [True, False]


def test_another_contact_of_the_same_kind_is_reported_after_a_second() -> None:
    """A box that tilts about its edge is f-f on a wall, and then on the table again."""
    changes, period_ns = Changes(), SAME_NS // 10
    begins_ns = {True: 0, False: 12 * period_ns}
    given = [
        replace(belief(tick * period_ns, Contact.FF, SETTLED), onset_ns=begins_ns[tick < 15])
        for tick in range(40)
    ]
    are_news = [changes.update(state)[0] for state in given]
    assert np.flatnonzero(are_news).tolist() == [0, 25]
