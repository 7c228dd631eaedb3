"""The text of docs/paper.md, with the figures of replicated experiments."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.paper.objectives import REPORTED_ERRORS
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.evaluation.bound import errors_at_bound
from contact_tracker_lab.evaluation.geometry_errors import ElementError
from paper_replication import MOVED, NOISES, ContactSequence, SingleContact

Array = NDArray[np.float64]

TEXT: Final = """\
# The paper's experiments

This page repeats both experiments of S. Ishikawa, S. Shirafuji and J. Ota in "Objective Functions of Principal Contact Estimation from Motion Based on the
Geometrical Singular Condition": a cube of 0.2 m is moved by hand on a desk and measured by motion capture, and the contact is estimated from its motion
([theory](theory.md#4-the-papers-objective-functions) has equations and errata). One
command writes the page and its pictures in a few minutes:

```bash
python docs/examples/paper.py
```

**Comparison.** The paper's recordings are not published. Here they are simulated: the same cube, desk, contacts, durations and rate, motion as by
hand, noise of 0.3 mm and 0.15 deg. The paper's errors also have causes that a simulation does not have (errors of the true geometry,
rounded edges, compliance of the desk), so the column *paper* is only an order of magnitude. Compare the columns *SLSQP* (the paper's
method) and *tracker*, on the same poses.
*White* noise is independent from pose to pose. *Filtered* is the same recording after a low-pass of 20 Hz (Butterworth, forward and backward),
which correlates the noise, as motion-capture software does.

## Set-up (Fig. 1 to 3)

Fig. 1 shows the contacts: see [f-f](contacts/ff.md), [e-f](contacts/ef.md) and [f-e](contacts/fe.md), [v-f](contacts/vf.md) and
[f-v](contacts/fv.md), [e-e](contacts/ee.md). Fig. 2 and 3 are photographs of the motion and of the cube.

| | paper | here |
|---|---|---|
| object | cube of 0.2 m, 2.84 kg | cube of 0.2 m |
| measured | motion capture, 200 Hz | simulated, 200 Hz, 0.3 mm, 0.15 deg |
| experiment 1 | one motion in each contact | {recordings} motions of 10 s in each contact, medians |
| minimiser | SLSQP, 10 random starts, given the contact | the same; and the tracker, which is not given the contact |
| experiment 2 | 5 s rest, then f-f, e-f, v-f, e-e for 10 s each | the same; the cube is lifted between v-f and e-e |
| windows | 500 frames, 10 apart, SLSQP from 3 random starts | the same; all windows by batched Levenberg-Marquardt, one of {every} by SLSQP as well |

## Experiment 1: geometry (Fig. 4)

![The cube in four contacts, with the estimated faces, edges and vertices.](images/paper_geometry.png)

As in Fig. 4, the object's element is red, the element of the surroundings blue. Most estimates, of SLSQP and of the tracker, differ from the true elements by less
than the width of a line. Motion does not determine the position of the faces of f-f along their normals: both methods place them at the origin of the body frame.

Median errors. *Bound* is the median error of an estimator that attains the [Cramér-Rao bound](theory.md#12-how-well-geometry-can-be-known) of
white noise; no filter lowers it. {labelled}

{errors}

{over_bound}

## Experiment 2: changes of contact (Fig. 5)

With white noise:

![Four panels over the number of the window: the paper's curves, the online posterior, the smoothed posterior.](images/paper_sequence_white.png)

With filtered noise:

![The same with filtered noise.](images/paper_sequence_filtered.png)

(a) and (b) are the paper's Fig. 5: minima of its objectives, each over its maximum, by batched Levenberg-Marquardt; dots are the minima of SLSQP. (c) and (d) are the
tracker's posteriors at the last pose of each window. Dotted lines are the true changes; the first window ends after 2.5 s. {gain}

Medians of the curves over the windows that lie within one contact, and mean probabilities of the same contact at the ends of these windows:

{phases}

The paper's remarks on its Fig. 5, and the results here with white noise:

{remarks}

Share of the windows that are labelled right, by the lowest curve and by the tracker. The lowest curve seldom belongs to the true contact: the curves of all
contacts that it [contains](theory.md#containment) are as low as its own.

{labels}
"""


def document(contacts: Sequence[SingleContact], sequences: Mapping[str, ContactSequence]) -> str:
    """The whole page."""
    first = next(iter(sequences.values()))
    return TEXT.format(
        recordings=len(contacts) // (len(MOVED) * len(NOISES)),
        every=int(first.slsqp_window[1] - first.slsqp_window[0]),
        labelled=labelled_sentence(contacts),
        errors=error_table(contacts),
        over_bound=over_bound_sentence(contacts),
        gain=gain_sentence(sequences),
        phases=phase_table(sequences),
        remarks=remark_sentence(sequences),
        labels=label_table(sequences),
    )


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def labelled_sentence(contacts: Sequence[SingleContact]) -> str:
    shares = [entry.labelled for entry in contacts]
    missed = sum(entry.tracker is None for entry in contacts)
    none = "it found the contact in every recording" if not missed else f"it missed the contact in {missed}"
    return (
        f"The tracker was not given the contact; {none} of {len(contacts)}, "
        f"and labelled {np.mean(shares):.3f} of the time right."
    )


def rows_of(contacts: Sequence[SingleContact], contact: Contact, noise: str) -> list[SingleContact]:
    return [entry for entry in contacts if (entry.contact, entry.noise) == (contact, noise)]


def sizes(errors: Sequence[ElementError], side: str, kind: str) -> list[float]:
    """Angles (deg) or distances (mm) of the elements of one side."""
    key: Callable[[ElementError], float] = (
        (lambda entry: entry.angle_deg) if kind == "angle" else (lambda entry: entry.distance_mm)
    )
    return [key(entry) for entry in errors if entry.side == side]


class Compared(NamedTuple):
    """A figure that the paper reports, an ``angle`` (deg) or a ``distance`` (mm) of one side's element.

    ``errors`` has by noise SLSQP's and the tracker's median error, and that at the bound.
    """

    contact: Contact
    side: str
    kind: str
    figure: float
    errors: dict[str, tuple[float, float, float]]


def compared(contacts: Sequence[SingleContact]) -> list[Compared]:
    """All of them, in the paper's order."""
    lines = []
    for (contact, side), (angle_deg, distance_mm) in REPORTED_ERRORS.items():
        for kind, figure, per in (
            ("angle", angle_deg, float(np.degrees(1.0))),
            ("distance", distance_mm, 1e3),
        ):
            if np.isnan(figure):
                continue
            errors = {}
            for noise in NOISES:
                recordings = rows_of(contacts, contact, noise)
                slsqp = [size for entry in recordings for size in sizes(entry.slsqp_errors, side, kind)]
                tracker = [size for entry in recordings for size in sizes(entry.tracker_errors, side, kind)]
                bounds = np.array(
                    [bound for entry in recordings if (bound := entry.bound_of(side, kind)) is not None]
                )
                errors[noise] = (
                    float(np.median(slsqp)),
                    float(np.median(tracker)) if tracker else float("nan"),
                    float(np.median(errors_at_bound(bounds)) * per),
                )
            lines.append(Compared(contact, side, kind, figure, errors))
    return lines


def error_table(contacts: Sequence[SingleContact]) -> str:
    header = ["contact", "element", "error", "paper"]
    header += [f"{method}, {noise}" for noise in NOISES for method in ("SLSQP", "tracker")]
    rows = []
    for contact, side, kind, figure, errors in compared(contacts):
        name = {"f": "face", "e": "edge", "v": "vertex"}[contact.value[0 if side == "object" else 2]]
        unit, digits = ("deg", 3) if kind == "angle" else ("mm", 2)
        cells = [f"{size:.{digits}f}" for noise in NOISES for size in errors[noise][:2]]
        bound = f"{errors['white'][2]:.{digits}f}"
        rows.append([contact.value, f"{name}, {side}", f"{kind}, {unit}", f"{figure:g}", *cells, bound])
    return markdown([*header, "bound"], rows)


def over_bound_sentence(contacts: Sequence[SingleContact]) -> str:
    """How far both methods are above the bound."""
    parts = []
    for noise in NOISES:
        ratios = np.array(
            [np.array(errors[noise][:2]) / errors[noise][2] for *_, errors in compared(contacts)]
        )
        middle, worst = np.nanmedian(ratios, axis=0), np.nanmax(ratios, axis=0)
        parts.append(
            f"with {noise} noise SLSQP's errors are {middle[0]:.1f} times the bound in the median of these rows "
            f"and {worst[0]:.1f} in the worst, the tracker's {middle[1]:.1f} and {worst[1]:.1f}"
        )
    sentence = "; ".join(parts)
    pairs = [entry.errors[noise][:2] for entry in compared(contacts) for noise in NOISES]
    worse = sum(tracker > slsqp for slsqp, tracker in pairs)
    return (
        f"{sentence[0].upper()}{sentence[1:]}. The tracker's error is the larger one in {worse} of {len(pairs)} pairs. "
        "The paper's objective adds squares of radians to squares of metres, and its minima for f-f and e-f depend on "
        "where the body frame is; the tracker weighs residuals by their noise."
    )


def gain_sentence(sequences: Mapping[str, ContactSequence]) -> str:
    """Where SLSQP is lower than the batched minimiser."""
    parts = []
    for noise, entry in sequences.items():
        lower = entry.slsqp_gain > 1e-4
        by = f" (by {entry.slsqp_gain.max():.3f} at most)" if lower.any() else ""
        parts.append(f"{int(lower.sum())} of {lower.size} minima with {noise} noise{by}")
    higher = max(float(-entry.slsqp_gain.min()) for entry in sequences.values())
    return (
        "SLSQP's minimum is lower than the curve by more than 0.0001 of its maximum in "
        f"{' and '.join(parts)}. It is higher by up to {higher:.3f}, where three random starts are not enough."
    )


def within(entry: ContactSequence, contact: Contact) -> NDArray[np.bool_]:
    """(W,) the windows that lie within a contact."""
    return np.asarray(entry.window_truth == contact.column)


def phase_table(sequences: Mapping[str, ContactSequence]) -> str:
    header = ["noise", "windows in", *(f"curve {contact.value}" for contact in MOVED)]
    rows = []
    for noise, entry in sequences.items():
        online = entry.segmentation.filtered.probability[entry.online]
        offline = entry.segmentation.beliefs.probability[entry.offline]
        for contact in MOVED:
            inside = within(entry, contact)
            curves = [f"{level:.4f}" for level in np.median(entry.curves[inside], axis=0)]
            shares = [f"{p[inside, contact.column].mean():.3f}" for p in (online, offline)]
            rows.append([noise, contact.value, *curves, *shares])
    return markdown([*header, "online", "smoothed"], rows)


def remark_sentence(sequences: Mapping[str, ContactSequence]) -> str:
    """The paper's remarks, with the curves with white noise."""
    entry = sequences["white"]

    def level(curve: Contact, inside: Contact) -> float:
        return float(np.median(entry.curves[within(entry, inside), MOVED.index(curve)]))

    def ratio(curve: Contact, high: Contact, low: Contact) -> str:
        return f"{level(curve, high) / level(curve, low):.0f}"

    return (
        f"- *f-f and e-f are small in their contact and larger in others*: f-f is "
        f"{ratio(Contact.FF, Contact.EF, Contact.FF)} times larger in e-f than in f-f, e-f is "
        f"{ratio(Contact.EF, Contact.VF, Contact.EF)} times larger in v-f than in e-f.\n"
        f"- *v-f works with some failures*: it is {ratio(Contact.VF, Contact.EE, Contact.VF)} times larger in e-e "
        "than in v-f.\n"
        f"- *e-e hardly differs between e-e and v-f*: it is {ratio(Contact.EE, Contact.VF, Contact.EE)} times larger "
        "in v-f than in e-e."
    )


def label_table(sequences: Mapping[str, ContactSequence]) -> str:
    header = ["noise", "windows", "number", "lowest curve", "tracker, online", "tracker, offline"]
    rows = []
    for noise, entry in sequences.items():
        last = entry.truth[np.searchsorted(entry.poses.stamp_ns, entry.windows.stamp_ns)]
        methods = (entry.lowest(), entry.online_labels(), entry.offline_labels())
        columns = [np.array([STATES.index(label) for label in labels]) for labels in methods]
        for name, truth in (("within one contact", entry.window_truth), ("all, by the last pose", last)):
            scored = truth >= 0
            shares = [f"{np.mean(column[scored] == truth[scored]):.3f}" for column in columns]
            rows.append([noise, name, str(int(scored.sum())), *shares])
    return markdown(header, rows)
