"""The paper's own objective functions: direct, as Kronecker forms, and minimised as the paper does.

Ishikawa, Shirafuji and Ota, "Objective Functions of Principal Contact Estimation from Motion Based on the
Geometrical Singular Condition". Equation numbers in parentheses are the paper's; four of its equations are
corrected (docs/theory.md, errata). The tracker itself works on moments of the lifted pose; this package is
its reference, with the functions that the fixed-window curves of the paper's Fig. 5 minimise.

Elements are plain arrays: plane ``[n, h]`` (4,) with ``n . x = h``, line ``[d, m]`` (6,) with ``m = q x d``,
point ``[q, 1]`` (4,). Motions are the paper's pair: ``x_body = R x_world + p``.
"""

from contact_tracker.paper.batched import Form, Minimum, form, matrix, minimise_slsqp, value
from contact_tracker.paper.objectives import direct, motion

__all__ = ["Form", "Minimum", "direct", "form", "matrix", "minimise_slsqp", "motion", "value"]
