"""All figures of the identification benchmark as JSON: by method, then by contact."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker_lab.evaluation.metrics import Tally, quantile
from identification_tables import MeasuredRecording, Sum, in_order, quantiles, summed
from scores import OFFLINE, Method, Score


def to_json(sets: Mapping[str, Sequence[MeasuredRecording]]) -> str:
    """For each set the figures of its recordings and of their sum: by method, then by contact."""
    data = {
        name: {
            "cpu_s": {m.path.name: m.cpu_s for m in measured},
            "recordings": {m.path.name: _figures(Sum(m.scores, m.geometry)) for m in measured},
            "total": _figures(summed(measured)),
        }
        for name, measured in sets.items()
    }
    return json.dumps(data, indent=1, allow_nan=False)


def _figures(total: Sum) -> dict[str, Any]:
    geometry = {"all": total.geometry} | {c.value: total.geometry.of_contact(c) for c in CONTACTS}
    return {
        "methods": {
            f"{method.name} {method.when}": _score_figures(method, total.scores[method])
            for method in in_order(total.scores)
        },
        "geometry": {
            name: {
                "elements": len(errors.rows),
                "angle_deg": _finite(quantile(errors.angle_deg, 0.5)),
                "distance_mm": _finite(quantile(errors.distance_mm, 0.5)),
                "within_3_sd": _finite(errors.within_3_sd),
            }
            for name, errors in geometry.items()
        },
    }


def _score_figures(method: Method, score: Score) -> dict[str, Any]:
    contacts = {
        state.value: _tally_figures(method, score.main, state)
        for state in STATES
        if score.main.seconds_by_state[state.column]
    }
    bands = {"right_5_95": score.phases.accuracy()}
    if method.has_posterior:
        bands["calibration_error_5_95"] = score.phases.calibration_error()
    mean, most = map(_finite, score.phases.calibration_error_if_exact())
    exact = {"calibration_error_if_exact": mean, "calibration_error_if_exact_95": most}
    return {
        **_tally_figures(method, score.main),
        **{name: [_finite(end) for end in band] for name, band in bands.items()},
        **(exact if method.has_posterior else {}),
        "contacts": contacts,
        "apart": _tally_figures(method, score.apart),
    }


def _tally_figures(method: Method, tally: Tally, state: Contact | None = None) -> dict[str, Any]:
    """Figures of all states, or of one."""
    into = slice(None) if state is None else tally.into == state.column
    if state is None:
        label = tally.seconds(), tally.accuracy(), tally.macro_f1
        belief = [tally.log_loss, tally.brier, tally.calibration_error, tally.sure_wrong]
    else:
        c = state.column
        label = tally.seconds_by_state[c], tally.recall[c], tally.f1[c]
        by_state = tally.log_loss_by_state, tally.brier_by_state, tally.calibration_error_by_state
        belief = [float(values[c]) for values in (*by_state, tally.sure_wrong_by_state)]
    figures = dict(zip(("seconds", "right", "f1"), map(_finite, label), strict=True))
    names = ("median", "p90", "unfound")
    figures |= {
        f"boundary_s_{name}": _finite(value)
        for name, value in zip(names, quantiles(tally.boundary_error_s[into]), strict=True)
    }
    if method.wait_s != OFFLINE:
        delays = quantiles(tally.detection_delay_s[into] + method.wait_s)
        figures |= {f"delay_s_{name}": _finite(value) for name, value in zip(names, delays, strict=True)}
    if method.has_posterior:
        keys = ("log_loss", "brier", "calibration_error", "sure_wrong")
        figures |= dict(zip(keys, map(_finite, belief), strict=True))
    return figures


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
