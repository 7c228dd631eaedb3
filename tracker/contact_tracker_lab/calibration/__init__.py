"""Calibration: learning a model's transitions and noise from recordings with truth.

::

    recording -> Study   (calibrate: counts of the true states, and the stream's noise; one process each)
    studies -> Model     (calibrate; its file: parameters)
    folds -> report      (cross-validation: each recording scored by a model learned from others)
"""
