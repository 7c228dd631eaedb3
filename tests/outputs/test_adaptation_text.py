"""The line on noise says what was found, and what is only assumed."""

from contact_tracker.adaptation.report import Report
from contact_tracker.config.loading import load_model
from contact_tracker.outputs.adaptation import noise_text

MODEL = load_model()


def text_of(*, is_decided, model=MODEL):
    return noise_text(Report(model, model, is_decided, (3e-4, 2e-3), (1e-4, 1e-3), (1e-4, 5e-4), 20.0, ()))


def test_what_too_little_motion_shows_is_assumed_and_not_found():
    """Nothing more is to come when the line is printed."""
    text = text_of(is_decided=False)
    assert "too little motion to tell" in text
    assert text.endswith(
        "0.1 mm 0.057 deg a tick and errors that last 0.1 mm 0.029 deg are assumed (--noise sets it)"
    )
    assert "yet" not in text
    assert "assumed" not in text_of(is_decided=True)
    assert "(as given)" in text_of(is_decided=False, model=MODEL.with_noise(3e-4, 2e-3))


def test_the_point_of_the_noise_is_named_if_it_is_not_the_origin():
    report = Report(MODEL, MODEL, True, (3e-4, 2e-3), (1e-4, 1e-3), (0.0, 0.0), 20.0, ())
    assert noise_text(report).startswith("noise 0.3 mm 0.11 deg a pose, ")
    moved = noise_text(report._replace(point_m=(0.0, 0.104, -9.9)))
    assert moved.startswith("noise 0.3 mm 0.11 deg a pose at the point (0.00 0.10 -9.90) m of the body, ")
