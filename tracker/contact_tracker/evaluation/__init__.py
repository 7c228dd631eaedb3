"""How right the tracker was: pure figures from truth and belief, which add over recordings.

::

    truth + poses -> scoring  (what counts: frames, their weight, the true changes)
    scoring + beliefs -> Tally  (offline and online apart)
    truth + segments -> GeometryErrors
    Evaluation = both, of one recording or of a sum of them -> Report (text, JSON)
"""
