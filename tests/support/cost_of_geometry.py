"""The cost of geometries in windows, written out: an oracle of fits."""

import numpy as np


def every_cost(family, moments, row_weight, prior, x):
    """Cost (N, B) in nats of each of N geometries x (N, S) on each of B windows."""
    c = family.rows(x)
    squares = np.einsum("nkc,bcd,nkd->nkb", c, moments, c)
    squares[:, -1] /= family.scale_sq(x[:, None], moments[None])
    pull = 0.5 * np.einsum("ns,bst,nt->nb", x, prior.precision, x) - x @ prior.information.T + prior.constant
    return 0.5 * np.einsum("nkb,bk->nb", squares, row_weight) + pull
