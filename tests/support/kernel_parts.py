"""Parts of the kernels, with the interfaces of the numpy functions."""

import pytest

from contact_tracker.hypotheses import compiled, gauss_newton
from contact_tracker.hypotheses.bank import blank, entries
from contact_tracker.hypotheses.compiled.calls import model_of
from contact_tracker.hypotheses.compiled.kernels import parts


def both(function, *args, **options):
    """The results of a function in numpy and compiled."""
    results = []
    for in_use in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(compiled, "in_use", lambda now=in_use: now)
            results.append(function(*args, **options))
    return results


def minimise(model, moments, row_weight, prior, anchors, x, iterations):
    """As ``gauss_newton.minimise``."""
    part = _problem(model, moments, row_weight, prior, anchors)
    x, cost, upper, converged = parts.minimise(*part, iterations, x)
    return gauss_newton.Fit(x, cost, upper[..., entries(model.family.PARAMETERS)], x, converged)


def _problem(model, moments, row_weight, prior, anchors):
    bank = (
        blank(model, len(moments))
        .replace_columns(row_weight=row_weight)
        .replace_onset_columns(second_moment=moments)
    )
    return *_bank(model, 1.0, bank), prior.precision, prior.information, prior.constant, anchors


def _bank(model, reach_m, bank):
    return model_of(model, reach_m), bank.words, bank.onsets.words


def prune(bank, model, now, best, margin):
    """As ``global_search.prune``: rows, words, words of the onsets, log total weight, residual, best row."""
    return parts.keep_best(*_bank(model, 1.0, bank), now, best, margin)
