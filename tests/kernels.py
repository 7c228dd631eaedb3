"""The parts of the kernels that fit one window, called as ``fit.minimise`` and ``fit.complete`` are."""

import numpy as np

from contact_tracker import fit
from contact_tracker.compiled.fitting import Problem, complete_one, descend, work_for
from contact_tracker.compiled.jit import SOURCES, kernel
from contact_tracker.contacts.form import shifts, turns


def minimise(family, moments, row_weight, prior, anchors, x, iterations):
    count, each, free = len(x), family.ROWS, family.PARAMETERS
    found = fit.Fit(x.copy(), np.empty(count), np.empty((count, each, free, free)), np.empty(count, bool))
    steps = np.broadcast_to(iterations, count).astype(np.int64)
    columns = found.x, found.cost, found.hessian, found.converged
    _minimise(_problem(family, moments, row_weight, prior, anchors), steps, *columns)
    return found


def complete(family, moments, row_weight, prior, anchors, x):
    completed, cost = x.copy(), np.empty(len(x))
    problem = _problem(family, moments, row_weight, prior, anchors)
    _complete(problem, family.PARAMETERS, completed, cost)
    return completed, cost


def _problem(family, moments, row_weight, prior, anchors):
    known = prior.precision, prior.information, prior.constant
    arrays = turns(family.FORM), shifts(family.FORM), moments, row_weight, *known, anchors
    return Problem(family.FORM, *(np.array(values, order="C") for values in arrays))


def _kernels(sources):
    @kernel
    def _minimise(problem, steps, x, cost, hessian, converged):
        assert sources
        work = work_for(hessian.shape[1], problem.moments.shape[1], x.shape[1], hessian.shape[2])
        for b in range(len(x)):
            cost[b], converged[b] = descend(problem, b, x[b], steps[b], fit_tolerance, hessian[b], work)

    @kernel
    def _complete(problem, free, x, cost):
        assert sources
        work = work_for(problem.row_weight.shape[1], problem.moments.shape[1], x.shape[1], free)
        for b in range(len(x)):
            cost[b] = complete_one(problem, b, x[b], work)

    fit_tolerance = fit.TOLERANCE
    return _minimise, _complete


_minimise, _complete = _kernels(SOURCES)
