"""Calibration: learning a model's parameters from recordings, with or without truth.

::

    recording -> Study   (ticks, true or estimated states, fitted segments; one process each)
    studies -> Model     (learn: the stream's noise, floors from residuals, transitions by EM, direct search)
    folds -> Report      (cross-validation: each recording scored by a model learned from others)
    Model -> TOML        (writing)
"""
