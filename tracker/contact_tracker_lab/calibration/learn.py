"""Learn a model from studies of recordings: first closed forms, in turn, then a direct search."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from contact_tracker.config.parameters import Model
from contact_tracker_lab.calibration.contact_errors import learn_contact_errors
from contact_tracker_lab.calibration.floors import Floor, learn_floors
from contact_tracker_lab.calibration.learned import How, Learned, rounded, value_of, with_value
from contact_tracker_lab.calibration.search import Searched, coordinate_search
from contact_tracker_lab.calibration.study import Study
from contact_tracker_lab.calibration.transition_em import learn_transitions


@dataclass(frozen=True)
class LearnedModel:
    """A learned model with its derivation: ``floors`` by contact, log posterior by round of EM (empty if
    transitions were not learned), ``searched`` parameters."""

    model: Model
    floors: tuple[Floor, ...]
    rounds: tuple[float, ...]
    searched: tuple[Searched, ...]


def learn(
    start: Model, studies: Sequence[Study], wanted: Sequence[Learned], loss: Callable[[Model], float]
) -> LearnedModel:
    """Learn ``wanted`` from one or more ``studies``; other parameters stay as in ``start``. A search lowers
    ``loss``."""
    keys = {how: [learned.key for learned in wanted if learned.how is how] for how in How}
    model = start
    floors: tuple[Floor, ...] = ()
    rounds: tuple[float, ...] = ()
    for key in keys[How.STREAM]:
        name = key.rpartition(".")[2]
        model = with_value(model, key, float(np.exp(np.mean([np.log(vars(s)[name]) for s in studies]))))
    segments = [segment for study in studies for segment in study.segments]
    if keys[How.RESIDUALS]:
        model, floors = learn_floors(model, segments, keys[How.RESIDUALS])
    for key in (*keys[How.STREAM], *keys[How.RESIDUALS]):
        model = with_value(model, key, rounded(value_of(model, key)))
    model = learn_contact_errors(model, segments, keys[How.CONTACTS])
    if keys[How.COUNTS]:
        learning = learn_transitions(model, [study.chain for study in studies])
        model, rounds = learning.model, learning.log_posterior
    model, searched = coordinate_search(model, keys[How.SEARCH], loss)
    return LearnedModel(model, floors, rounds, searched)
