"""The tables of the identification benchmark, and a summary to be kept."""

import math
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from contact_tracker.evaluation.geometry_errors import GeometryErrors
from contact_tracker.evaluation.metrics import Array, quantile
from contact_tracker.evaluation.tables import number, table
from contact_tracker.states import STATES, Contact
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
    "": 1, "right": 2, "5-95 %": 3, "F1": 4, "delay, s": 8, "log-loss": 11, "ECE": 13, "sure and wrong": 16,
    "angle, deg": 17, "distance, mm": 18, "within 3 sd": 19,
}  # fmt: skip
"""What is kept of a row of ``BY_METHOD``: by its title there, and where it is."""
SHOWN: Final = ("offline", "lag 1 s", "online")
BY_CONTACT: Final = ("contact", "s", "method", "", "right", "F1", *CHANGES, *BELIEFS, *GEOMETRY)
LEGEND: Final = """\
right       share of the time in which the label was right; by contact: of the time in which it was true
5-95 %      interval of the figure before it: bootstrap over the true phases
exact       ECE that exact probabilities would show in so few phases, if each is right or wrong as a whole:
            on average, and what it would be below in 95 of 100 such sets
F1          by contact; of a set the mean over the contacts that occur in it
bound. s    from a true change to the nearest found one, median and 90 %; missed: share without one
delay s     from a true onset until the label stays right for 0.3 s, and the lag, median and 90 %;
            never: share where it does not
log-loss    of the posterior, nats: offline smoothed, online filtered; by contact: while it was true
Brier       squared distance of posterior and truth, 0 to 2; by contact: what it adds to the sum
ECE         expected calibration error, 15 bins: of the top probability; by contact: of the contact's own
sure&wrong  share of the time (by contact: in which it was true) with more than 0.9 on a wrong state
deg, mm     angle and distance of the found elements from the true ones, median; in 3 sd: share of the
            elements within 3 standard deviations of their covariance
after |     the same of what is scored apart: singular motion, and rest before the first motion

smallest objective   windows of 500 frames, the smallest of the paper's six objectives, each over its
                     largest value; it never says free and gives no probability
HMM on windows       hidden Markov model over the six minima of such windows, calibrated on the very set
BIC on windows       log-likelihood - (parameters + samples x degrees of freedom) / 2 x log(samples) of
                     such windows
BIC, true segments   the same of the true segments: it is told the boundaries"""


class Judged(Protocol):
    """What the tables need of a recording."""

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
    """Recordings summed up."""

    scores: Scores
    geometry: GeometryErrors


def summed(measured: Sequence[Judged]) -> Sum:
    """Of at least one recording."""
    methods = measured[0].scores
    scores = {method: reduce(add, (m.scores[method] for m in measured)) for method in methods}
    return Sum(scores, reduce(add, (m.geometry for m in measured)))


def blocks(sets: Mapping[str, Sequence[Judged]]) -> list[Block]:
    """The tables of each set, and of all together where there are several."""
    return [_block(name, measured) for name, measured in _with_all(sets).items()]


def _with_all(sets: Mapping[str, Sequence[Judged]]) -> dict[str, Sequence[Judged]]:
    """The sets, and all together where there are several."""
    everything = [m for measured in sets.values() for m in measured]
    return dict(sets) | ({TOTAL: everything} if len(sets) > 1 else {})


def _block(name: str, measured: Sequence[Judged]) -> Block:
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
    believed = [number(main.log_loss), number(main.brier), number(main.calibration_error)]
    believed += [_between(phases.calibration_error()), _up_to(phases.calibration_error_if_exact())]
    believed += [number(main.sure_wrong)]
    geometry = total.geometry if _has_geometry(method) else None
    return [
        method.name,
        method.when,
        number(main.accuracy()),
        _between(phases.accuracy()),
        number(main.macro_f1),
        *_changes(method, main.boundary_error_s, main.detection_delay_s),
        *(believed if method.believes else ["-"] * len(believed)),
        *_geometry(geometry),
        number(geometry.within_3_sd if geometry else math.nan, 2),
        number(apart.accuracy()),
        number(apart.sure_wrong) if method.believes else "-",
    ]


def _contact_rows(contact: Contact, total: Sum) -> list[list[str]]:
    """A contact's lines, one per method; none where the contact does not occur."""
    rows: list[list[str]] = []
    for method in in_order(total.scores):
        main, column = total.scores[method].main, contact.column
        if not main.seconds_by_state[column]:
            return []
        into = main.into == column
        believed = (
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
                *(number(float(value[column])) if method.believes else "-" for value in believed),
                *_geometry(geometry),
            ]
        )
    return rows


def _has_geometry(method: Method) -> bool:
    return method.name == TRACKER and method.wait_s == OFFLINE


def _changes(method: Method, boundary_s: Array, delay_s: Array) -> list[str]:
    """Boundary errors and delays with nan for those missed; there is no delay offline."""
    shown = [*quantiles(boundary_s)]
    if method.wait_s == OFFLINE:
        return [*(number(v, 2) for v in shown), "-", "-", "-"]
    return [number(v, 2) for v in (*shown, *quantiles(delay_s + method.wait_s))]


def quantiles(values: Array) -> tuple[float, float, float]:
    """Median and 90 % of what is known, and the share of what is not."""
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
    """All by contact, then all by method, so that what matters most is last on the screen."""
    by_contact = [f"{block.title}\n\n{block.by_contact}" for block in shown]
    by_method = [f"{block.title}\n\n{block.by_method}" for block in shown]
    return "\n\n".join([*by_contact, *by_method, LEGEND])


def summary(sets: Mapping[str, Sequence[Judged]]) -> dict[str, Table]:
    """What a reader wants to know first: the tracker by set, and beside the alternatives."""
    totals = {name: summed(measured) for name, measured in _with_all(sets).items()}
    by_set, beside = list[list[str]](), list[list[str]]()
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
        beside.append([name, f"{seconds:.0f}", *accuracies])
    return {
        "tracker": Table(("set", *SUMMARY), by_set),
        "alternatives": Table(tuple(columns), beside),
    }
