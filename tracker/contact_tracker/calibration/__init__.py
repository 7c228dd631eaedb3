"""Learning a model's parameters from recordings, with or without truth.

::

    recording -> Study   (looking: ticks, true or believed states, fitted stretches; one process each)
    studies -> Model     (learn: the stream's noise, floors from residuals, transitions by EM, direct search)
    folds -> Report      (each recording judged by a model that has not seen it)
    Model -> TOML        (writing)
"""
