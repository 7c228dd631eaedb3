"""Parts of the kernels, called as the functions are that they stand for."""

import numpy as np

from contact_tracker import fit
from contact_tracker.bank import blank
from contact_tracker.compiled import calls
from contact_tracker.compiled.advancing import GROUPS, _lost
from contact_tracker.compiled.fitting import complete_one, descend, work_for
from contact_tracker.compiled.following import grow_one
from contact_tracker.compiled.hypothesis import row_of
from contact_tracker.compiled.jit import jit, kernel
from contact_tracker.compiled.offering import costs_for, offer
from contact_tracker.compiled.relaxing import relax, relaxed_for
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


def grow(bank, model, window, log_stay):
    """As ``following.grow``."""
    grown = bank.copy()
    heard, ticks = float(window.activity[-1]), calls._ticks(window, model.body_in_1)
    _grow(calls._kind(model, 1.0), grown.words, grown.words.view(np.int64), ticks, heard, log_stay)
    return grown


def givers(bank, model, reach_m):
    """Whose geometry each hypothesis takes in ``search.adopted``."""
    giver = np.empty(len(bank), np.int64)
    _offer(calls._kind(model, reach_m), bank.words, giver)
    return giver


def lost(bank, model):
    """As ``search.lost``."""
    which = np.empty(GROUPS, np.int64)
    many = _which_search(calls._kind(model, 1.0), bank.words, bank.words.view(np.int64), which)
    return which[:many]


def starts(model, moments):
    """As ``Family.starts`` of moments (B, C, C), and how many there are (B,)."""
    kind = calls._kind(model, 1.0)
    out, many = np.empty((len(moments), kind.relaxed, kind.size)), np.empty(len(moments), np.int64)
    _relax(kind, moments, out, many)
    return out, many


@kernel
def _relax(kind, moments, out, many):
    memory = relaxed_for(kind)
    for b in range(len(moments)):
        many[b] = relax(kind, moments[b], out[b], memory)


@kernel
def _grow(kind, table, whole, ticks, heard, log_stay):
    work = work_for(kind)
    for b in range(len(table)):
        grow_one(kind, table, whole, b, ticks, heard, log_stay, work)


@kernel
def _offer(kind, table, giver):
    count = len(table)
    offer(kind, table, costs_for(kind, count), np.empty((count, count)), giver, work_for(kind))


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


@kernel
def _which_search(kind, table, whole, which):
    return _lost(kind, table, whole, np.empty(GROUPS, np.int64), which)
