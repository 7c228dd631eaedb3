"""Colours of the states: one table for terminal, figures, viewer and reports.

Any two of them differ by at least 33 in CIE L*a*b* (1976), for normal sight as for protanopes and
deuteranopes (simulated as by Machado, Oliveira and Fernandes, 2009); tests/outputs/test_colours.py. Terminals
show the nearest of 216 colours, which differ less (5.6 for protanopes): beside these the label is a word.
"""

from typing import Final

from contact_tracker.states import STATES, Contact

Colour = tuple[int, int, int]

COLOUR: Final[dict[Contact, Colour]] = {
    Contact.FF: (79, 222, 255),
    Contact.EF: (53, 238, 196),
    Contact.FE: (178, 203, 111),
    Contact.VF: (254, 203, 51),
    Contact.FV: (156, 83, 62),
    Contact.EE: (201, 94, 255),
    Contact.FREE: (117, 124, 143),
}
ANSI_LEVELS: Final = (0, 95, 135, 175, 215, 255)
"""Levels of red, green and blue in the 216 colours of terminals."""
COLOURS: Final = [COLOUR[state] for state in STATES]


def ansi_of(contact: Contact) -> str:
    """The code of the colour for terminals, of 256 colours."""
    red, green, blue = (min(range(6), key=lambda i: abs(ANSI_LEVELS[i] - part)) for part in COLOUR[contact])
    return f"38;5;{16 + 36 * red + 6 * green + blue}"
