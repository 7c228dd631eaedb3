"""The search of several hypotheses in batches."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Origins
from contact_tracker.hypotheses import global_search
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.births import Frame, propose_births
from contact_tracker.map.file import map_from
from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact
from contact_tracker.tracking.state import scales_of


def test_batches_of_a_search_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an edge of a box on unknown edges: a hypothesis for each of its twelve edges."""
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(0.4 * rng.standard_normal((30, 3)).cumsum(axis=0) / 5.0).as_matrix()
    places_m = 0.1 * rng.standard_normal((30, 3))
    zeta = np.array([lift(turn, place_m) for turn, place_m in zip(turns, places_m, strict=True)])
    window = Window(np.arange(30), zeta, np.tile([1e-8, 1e-6], (30, 1)), np.tile([1e-4, 1e-2], (30, 1)))
    model, known = (
        CONTACT_MODELS[Contact.EE.column],
        map_from({"object": {"box": {"size_m": [0.1, 0.2, 0.3]}}}),
    )
    begins = propose_births(model, known, None, 0.0, Frame.around(Origins.zero(), zeta[-1, 9:12]))
    assert begins.count == 12
    found = []
    for at_once in (1, 5, 12, 100):
        monkeypatch.setattr(global_search, "AT_ONCE", at_once)
        found.append(fit_window(model, window, scales_of(load_model()), begins))
    for other in found[1:]:
        np.testing.assert_allclose(other.x, found[0].x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(other.log_likelihood, found[0].log_likelihood, rtol=1e-9)
