"""Tables of the identification benchmark, and their summary."""

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from contact_tracker.states import STATES, Contact
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors
from contact_tracker_lab.evaluation.metrics import Array, quantile
from contact_tracker_lab.evaluation.tables import number, table
from kept_tables import Table
from scores import OFFLINE, Method, Scores
from tracking import NAME as TRACKER

TOTAL: Final = "all sets"
CHANGES: Final = ("bound. s", "90 %", "missed", "delay s", "90 %", "never")
BELIEFS: Final = ("log-loss", "Brier", "ECE", "sure&wrong")
GEOMETRY: Final = ("deg", "mm")
BAND: Final = "5-95 %"
BY_METHOD: Final = (
    "method", "", "right", BAND, "F1", *CHANGES, "log-loss", "Brier", "ECE", BAND, "exact", "sure&wrong",
    *GEOMETRY, "in 3 sd", "| right", "sure&wrong",
)  # fmt: skip
SUMMARY: Final = {
    "mode": 1, "accuracy": 2, "5-95 %": 3, "F1": 4, "delay, s": 8, "log-loss": 11, "ECE": 13,
    "sure and wrong": 16, "angle, deg": 17, "distance, mm": 18, "within 3 sd": 19,
}  # fmt: skip
"""Columns of the summary, with their index in a row of ``BY_METHOD``."""
SHOWN: Final = ("offline", "lag 1 s", "online")
BY_CONTACT: Final = ("contact", "s", "method", "", "right", "F1", *CHANGES, *BELIEFS, *GEOMETRY)
LEGEND: Final = """\
right       share of the time in which the label was right; by contact: of the time in which it was true
5-95 %      interval of the figure before it: bootstrap over the true phases
exact       ECE of exact probabilities with so few phases, if each is right or wrong as a whole: mean and
            95 % quantile
F1          by contact; of a set the mean over the contacts that occur in it
bound. s    from a true change to the nearest found one, median and 90 %; missed: share without one
delay s     from a true onset until the label is right for 0.3 s, plus the lag, median and 90 %;
            never: share without such a time
log-loss    of the posterior, nats: offline smoothed, online filtered; by contact: while it was true
Brier       squared distance of posterior and truth, 0 to 2; by contact: its contribution to the sum
ECE         expected calibration error, 15 bins: of the top probability; by contact: of the contact's own
sure&wrong  share of the time (by contact: in which it was true) with more than 0.9 on a wrong state
deg, mm     angle and distance of the found elements from the true ones, median; in 3 sd: share of the
            elements within 3 standard deviations of their covariance
after |     the same for time that is scored separately: singular motion, and rest before the first motion

smallest objective   windows of 500 frames, the smallest of the paper's six objectives, each over its
                     maximum; its label is never free, and it has no probabilities
HMM on windows       hidden Markov model over the six minima of such windows, calibrated on the same set
BIC on windows       log-likelihood - (parameters + samples x degrees of freedom) / 2 x log(samples) of
                     such windows
BIC, true segments   the same for the true segments, with known boundaries"""


class MeasuredRecording(Protocol):
    """Input of the tables for one recording."""

    @property
    def path(self) -> Path: ...
    @property
    def scores(self) -> Scores: ...
    @property
    def geometry(self) -> GeometryErrors: ...
    @property
    def cpu_s(self) -> float: ...
    @property
    def duration_s(self) -> float: ...


class Block(NamedTuple):
    """The tables of one set."""

    title: str
    by_method: str
    by_contact: str


class Sum(NamedTuple):
    """Sums over recordings."""

    scores: Scores
    geometry: GeometryErrors


def summed(measured: Sequence[MeasuredRecording]) -> Sum:
    """Sums over at least one recording."""
    methods = measured[0].scores
    scores = {method: reduce(add, (m.scores[method] for m in measured)) for method in methods}
    return Sum(scores, reduce(add, (m.geometry for m in measured)))


def blocks(sets: Mapping[str, Sequence[MeasuredRecording]]) -> list[Block]:
    """The tables of each set, and of all together if there are several."""
    return [_block(name, measured) for name, measured in _with_all(sets).items()]


def _with_all(sets: Mapping[str, Sequence[MeasuredRecording]]) -> dict[str, Sequence[MeasuredRecording]]:
    """The sets, and all together if there are several."""
    everything = [m for measured in sets.values() for m in measured]
    return dict(sets) | ({TOTAL: everything} if len(sets) > 1 else {})


def _block(name: str, measured: Sequence[MeasuredRecording]) -> Block:
    total = summed(measured)
    first = next(iter(total.scores.values()))
    cpu_s, duration_s = sum(m.cpu_s for m in measured), sum(m.duration_s for m in measured)
    share = number(cpu_s / duration_s if duration_s else math.nan, 2)
    title = (
        f"{name}: {len(measured)} recordings, {first.main.seconds():.1f} s scored and "
        f"{first.apart.seconds():.1f} s apart; CPU time of the tracker {share} of the recorded time"
    )
    by_method = [_method_row(method, total) for method in in_order(total.scores)]
    by_contact = [row for contact in STATES for row in _contact_rows(contact, total)]
    return Block(
        title, table(BY_METHOD, _named_once(by_method), left=2), table(BY_CONTACT, by_contact, left=4)
    )


def in_order(scores: Scores) -> list[Method]:
    """Each method from offline to online."""
    names = list(dict.fromkeys(method.name for method in scores))
    return sorted(scores, key=lambda m: (names.index(m.name), -m.wait_s))


def _named_once(rows: list[list[str]]) -> list[list[str]]:
    before = ["", *(row[0] for row in rows)]
    return [["" if row[0] == last else row[0], *row[1:]] for last, row in zip(before, rows, strict=False)]


def _up_to(figures: tuple[float, float]) -> str:
    mean, most = figures
    return "-" if math.isnan(mean) else f"{number(mean)} <{number(most)}"


def _method_row(method: Method, total: Sum) -> list[str]:
    main, apart = total.scores[method].main, total.scores[method].apart
    phases = total.scores[method].phases
    posterior = [number(main.log_loss), number(main.brier), number(main.calibration_error)]
    posterior += [_between(phases.calibration_error()), _up_to(phases.calibration_error_if_exact())]
    posterior += [number(main.sure_wrong)]
    geometry = total.geometry if _has_geometry(method) else None
    return [
        method.name,
        method.when,
        number(main.accuracy()),
        _between(phases.accuracy()),
        number(main.macro_f1),
        *_changes(method, main.boundary_error_s, main.detection_delay_s),
        *(posterior if method.has_posterior else ["-"] * len(posterior)),
        *_geometry(geometry),
        number(geometry.within_3_sd if geometry else math.nan, 2),
        number(apart.accuracy()),
        number(apart.sure_wrong) if method.has_posterior else "-",
    ]


def _contact_rows(contact: Contact, total: Sum) -> list[list[str]]:
    """Rows of a contact, one per method; none if the contact does not occur."""
    rows: list[list[str]] = []
    for method in in_order(total.scores):
        main, column = total.scores[method].main, contact.column
        if not main.seconds_by_state[column]:
            return []
        into = main.into == column
        posterior = (
            main.log_loss_by_state,
            main.brier_by_state,
            main.calibration_error_by_state,
            main.sure_wrong_by_state,
        )
        geometry = total.geometry.of_contact(contact) if _has_geometry(method) else None
        rows.append(
            [
                "" if rows else contact.value,
                "" if rows else number(float(main.seconds_by_state[column]), 1),
                method.name,
                method.when,
                number(float(main.recall[column])),
                number(float(main.f1[column])),
                *_changes(method, main.boundary_error_s[into], main.detection_delay_s[into]),
                *(number(float(value[column])) if method.has_posterior else "-" for value in posterior),
                *_geometry(geometry),
            ]
        )
    return rows


def _has_geometry(method: Method) -> bool:
    return method.name == TRACKER and method.wait_s == OFFLINE


def _changes(method: Method, boundary_s: Array, delay_s: Array) -> list[str]:
    """Figures of boundary errors and delays, in which nan is a missed one; offline there are no delays."""
    shown = [*quantiles(boundary_s)]
    if method.wait_s == OFFLINE:
        return [*(number(v, 2) for v in shown), "-", "-", "-"]
    return [number(v, 2) for v in (*shown, *quantiles(delay_s + method.wait_s))]


def quantiles(values: Array) -> tuple[float, float, float]:
    """Median and 90 % quantile of the known values, and the share of unknown ones (nan)."""
    known = values[values == values]
    unknown = 1 - len(known) / len(values) if len(values) else math.nan
    return quantile(known, 0.5), quantile(known, 0.9), unknown


def _between(band: tuple[float, float]) -> str:
    low, high = map(number, band)
    return low if low == high else f"{low}-{high}"


def _geometry(errors: GeometryErrors | None) -> list[str]:
    if errors is None:
        return ["-", "-"]
    return [number(quantile(errors.angle_deg, 0.5), 2), number(quantile(errors.distance_mm, 0.5), 2)]


def to_text(shown: Sequence[Block]) -> str:
    """First the tables by contact, then those by method: the most important ones last on the screen."""
    by_contact = [f"{block.title}\n\n{block.by_contact}" for block in shown]
    by_method = [f"{block.title}\n\n{block.by_method}" for block in shown]
    return "\n\n".join([*by_contact, *by_method, LEGEND])


def summary(sets: Mapping[str, Sequence[MeasuredRecording]]) -> dict[str, Table]:
    """Main figures: those of the tracker by set, and its accuracy beside the alternatives."""
    totals = {name: summed(measured) for name, measured in _with_all(sets).items()}
    by_set, compared = list[list[str]](), list[list[str]]()
    columns = ["set", "scored, s"]
    for name, total in totals.items():
        for method in in_order(total.scores):
            if method.name == TRACKER and method.when in SHOWN:
                cells = _method_row(method, total)
                by_set.append([name, *(cells[i] for i in SUMMARY.values())])
        others = [method for method in in_order(total.scores) if method.when in ("offline", "online")]
        columns[2:] = [f"{method.name} {method.when}" for method in others]
        seconds = next(iter(total.scores.values())).main.seconds()
        accuracies = (number(total.scores[method].main.accuracy()) for method in others)
        compared.append([name, f"{seconds:.0f}", *accuracies])
    return {
        "tracker": Table(("set", *SUMMARY), by_set),
        "alternatives": Table(tuple(columns), compared),
    }
