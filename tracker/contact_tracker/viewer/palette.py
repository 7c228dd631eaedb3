"""Colours of the states, the same in all views."""

from typing import Final

from contact_tracker.states import STATES, Contact

Colour = tuple[int, int, int]

COLOUR: Final[dict[Contact, Colour]] = {
    Contact.FF: (78, 161, 255),
    Contact.EF: (61, 214, 160),
    Contact.FE: (184, 224, 80),
    Contact.VF: (255, 196, 61),
    Contact.FV: (255, 128, 82),
    Contact.EE: (222, 116, 255),
    Contact.FREE: (128, 138, 150),
}
COLOURS: Final = [COLOUR[state] for state in STATES]
GREY: Final[Colour] = (170, 176, 186)
OBJECT: Final[Colour] = (244, 240, 228)
"""Colour of the object's elements; those of the surroundings have the colour of the contact."""
