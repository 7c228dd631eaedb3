"""The colours of the states, as those who do not see all colours see them."""

from itertools import combinations

import numpy as np
import pytest

from contact_tracker.outputs.text import ANSI_LEVELS, COLOUR, COLOURS, ansi_of

# Machado, Oliveira and Fernandes, 2009: severity 1, on linear RGB
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])


def lab(linear: np.ndarray) -> np.ndarray:
    """CIE L*a*b* (N, 3) of linear RGB (N, 3)."""
    share = linear @ XYZ.T / WHITE
    x, y, z = np.where(share > 216 / 24389, np.cbrt(share), (24389 / 27 * share + 16) / 116).T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


@pytest.mark.parametrize("sight", SIGHT)
def test_any_two_states_differ(sight) -> None:
    share = np.array(COLOURS) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = lab(np.clip(linear @ np.transpose(SIGHT[sight]), 0.0, 1.0))
    assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 33.0


def test_terminals_show_the_nearest_of_their_colours() -> None:
    for contact, colour in COLOUR.items():
        number = int(ansi_of(contact).rpartition(";")[2]) - 16
        shown = np.array(ANSI_LEVELS)[[number // 36, number // 6 % 6, number % 6]]
        assert np.abs(shown - colour).max() <= 48  # half the largest step of the levels
    assert len({ansi_of(contact) for contact in COLOUR}) == len(COLOUR)
