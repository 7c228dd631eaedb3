"""Comparison of beliefs with ground truth, as figures that add over recordings.

::

    truth + poses -> Scoring  (scored frames, their weights, the true changes)
    scoring + beliefs -> Tally  (offline and online separately)
    truth + segments -> GeometryErrors
    Evaluation = both, of one recording or a sum of several -> Report (text, JSON)
"""
