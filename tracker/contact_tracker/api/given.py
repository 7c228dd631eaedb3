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
Deviations = str | tuple[float, float] | None


def model_from(model: ModelLike, noise: Deviations = None, accuracy: Deviations = None) -> Model:
    """A model given by name, file or value, with the given noise and systematic errors of a pose.

    Raises
    ------
    ModelError
        There is no such model, or it has a wrong value.
    UsageError
        The noise or the accuracy is invalid.
    """
    found = model if isinstance(model, Model) else load_model(os.fspath(model))
    if noise is not None:
        found = found.with_noise(*_deviations_from(noise, "noise"))
    if accuracy is not None:
        found = found.with_systematic_errors(*_deviations_from(accuracy, "accuracy", may_be_zero=True))
    return found


def _deviations_from(
    value: str | tuple[float, float], name: str, may_be_zero: bool = False
) -> tuple[float, float]:
    """A length and an angle in metres and radians; raises UsageError, which ``name`` begins."""
    try:
        if isinstance(value, str):
            return deviations(value, may_be_zero)
        position_m, rotation_rad = map(float, value)
        return plausible((position_m, rotation_rad), value, may_be_zero)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} is '0.3mm,0.15deg' or (metres, radians): {error}") from error


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
    try:
        path = os.fspath(known)
    except TypeError as error:
        raise UsageError(f"known is a file, a table of its keys or a PriorMap, not {known!r}") from error
    return load_knowledge(path, note)
