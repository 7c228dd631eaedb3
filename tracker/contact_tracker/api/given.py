"""Conversion of arguments in several forms: model, noise, prior map."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.config.quantities import deviations, plausible
from contact_tracker.errors import UsageError
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.prior_map_files.loading import knowledge_from, load_knowledge

ModelLike = str | os.PathLike[str] | Model
Known = str | os.PathLike[str] | Mapping[str, Any] | PriorMap | None
Noise = str | tuple[float, float] | None


def model_from(model: ModelLike, noise: Noise = None) -> Model:
    """A model given by name, file or value, with the given noise of a pose.

    Raises
    ------
    ModelError
        There is no such model, or it has a wrong value.
    UsageError
        The noise is invalid.
    """
    found = model if isinstance(model, Model) else load_model(os.fspath(model))
    if noise is None:
        return found
    try:
        if isinstance(noise, str):
            return found.with_noise(*deviations(noise))
        position_m, rotation_rad = map(float, noise)
        return found.with_noise(*plausible((position_m, rotation_rad), noise))
    except (TypeError, ValueError) as error:
        raise UsageError(f"noise is '0.3mm,0.15deg' or (metres, radians): {error}") from error


def knowledge_of(known: Known, note: Callable[[str], None]) -> PriorMap:
    """The prior map from a TOML file, a table of the same keys, or a value; raises KnowledgeError.

    ``note`` is called with one line for each warning.
    """
    if known is None:
        return EMPTY_MAP
    if isinstance(known, PriorMap):
        return known
    if isinstance(known, Mapping):
        return knowledge_from(known, Path(), note)
    return load_knowledge(os.fspath(known), note)
