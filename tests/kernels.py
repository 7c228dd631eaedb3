"""The parts of the kernels that fit one window, called as ``fit.minimise`` and ``fit.complete`` are."""

import numpy as np

from contact_tracker import fit
from contact_tracker.bank import blank
from contact_tracker.compiled import calls
from contact_tracker.compiled.fitting import complete_one, descend, work_for
from contact_tracker.compiled.hypothesis import row_of
from contact_tracker.compiled.jit import jit, kernel
from contact_tracker.fit import TOLERANCE


def minimise(model, moments, row_weight, prior, anchors, x, iterations):
    count, each, free = len(x), model.family.ROWS, model.family.PARAMETERS
    found = fit.Fit(x.copy(), np.empty(count), np.empty((count, each, free, free)), np.empty(count, bool))
    steps = np.broadcast_to(iterations, count).astype(np.int64)
    columns = found.x, found.cost, found.hessian, found.converged
    _minimise(*_problem(model, moments, row_weight, prior, anchors), steps, *columns)
    return found


def complete(model, moments, row_weight, prior, anchors, x):
    completed, cost = x.copy(), np.empty(len(x))
    _complete(*_problem(model, moments, row_weight, prior, anchors), completed, cost)
    return completed, cost


def _problem(model, moments, row_weight, prior, anchors):
    bank = blank(model, len(moments)).having(moments=moments, row_weight=row_weight)
    known = prior.precision, prior.information, prior.constant, anchors
    return calls._kind(model, 1.0), bank.words, *(np.array(part, order="C") for part in known)


@jit
def _descend(kind, table, b, x, steps, hessian, work):
    return descend(kind, row_of(kind, table, b), x, steps, TOLERANCE, hessian, work)


@jit
def _complete_one(kind, table, b, x, work):
    return complete_one(kind, row_of(kind, table, b), x, work)


@kernel
def _minimise(kind, table, precision, information, constant, anchors, steps, x, cost, hessian, converged):
    work = work_for(kind)
    for b in range(len(x)):
        work.prior.precision[:], work.prior.information[:] = precision[b], information[b]
        work.prior.constant[0], work.prior.anchors[:] = constant[b], anchors[b]
        cost[b], converged[b] = _descend(kind, table, b, x[b], steps[b], hessian[b], work)


@kernel
def _complete(kind, table, precision, information, constant, anchors, x, cost):
    work = work_for(kind)
    for b in range(len(x)):
        work.prior.precision[:], work.prior.information[:] = precision[b], information[b]
        work.prior.constant[0], work.prior.anchors[:] = constant[b], anchors[b]
        cost[b] = _complete_one(kind, table, b, x[b], work)
