"""Calibration: learning a model's parameters from recordings, with or without truth.

::

    recording -> Study   (calibrate: true or estimated states, fitted segments; one process each)
    studies -> Model     (parameters from the stream's noise, residuals, transitions and a direct search)
    folds -> report      (cross-validation: each recording scored by a model learned from others)
    Model -> TOML        (parameters)
"""
