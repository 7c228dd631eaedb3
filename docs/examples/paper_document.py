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


def document(found: Sequence[SingleContact], sequences: Mapping[str, ContactSequence]) -> str:
    """The whole page."""
    any_one = next(iter(sequences.values()))
    return TEXT.format(
        recordings=len(found) // (len(MOVED) * len(NOISES)),
        every=int(any_one.slsqp_window[1] - any_one.slsqp_window[0]),
        labelled=labelled_sentence(found),
        errors=error_table(found),
        over_bound=over_bound_sentence(found),
        gain=gain_sentence(sequences),
        phases=phase_table(sequences),
        remarks=remark_sentence(sequences),
        labels=label_table(sequences),
    )


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def labelled_sentence(found: Sequence[SingleContact]) -> str:
    shares = [one.labelled for one in found]
    missed = sum(one.tracker is None for one in found)
    none = "it found the contact in every recording" if not missed else f"it missed the contact in {missed}"
    return (
        f"The tracker was not given the contact; {none} of {len(found)}, "
        f"and labelled {np.mean(shares):.3f} of the time right."
    )


def rows_of(found: Sequence[SingleContact], contact: Contact, noise: str) -> list[SingleContact]:
    return [one for one in found if (one.contact, one.noise) == (contact, noise)]


def sizes(errors: Sequence[ElementError], side: str, kind: str) -> list[float]:
    """Angles (deg) or distances (mm) of the elements of one side."""
    key: Callable[[ElementError], float] = (
        (lambda one: one.angle_deg) if kind == "angle" else (lambda one: one.distance_mm)
    )
    return [key(one) for one in errors if one.side == side]


class Compared(NamedTuple):
    """A figure that the paper reports, an ``angle`` (deg) or a ``distance`` (mm) of one side's element.

    ``ours`` has by noise SLSQP's and the tracker's median error, and that at the bound.
    """

    contact: Contact
    side: str
    kind: str
    figure: float
    ours: dict[str, tuple[float, float, float]]


def compared(found: Sequence[SingleContact]) -> list[Compared]:
    """All of them, in the paper's order."""
    lines = []
    for (contact, side), (angle_deg, distance_mm) in REPORTED_ERRORS.items():
        for kind, figure, per in (
            ("angle", angle_deg, float(np.degrees(1.0))),
            ("distance", distance_mm, 1e3),
        ):
            if np.isnan(figure):
                continue
            ours = {}
            for noise in NOISES:
                some = rows_of(found, contact, noise)
                slsqp = [size for one in some for size in sizes(one.slsqp_errors, side, kind)]
                tracker = [size for one in some for size in sizes(one.tracker_errors, side, kind)]
                bounds = np.array([bound for one in some if (bound := one.bound_of(side, kind)) is not None])
                ours[noise] = (
                    float(np.median(slsqp)),
                    float(np.median(tracker)) if tracker else float("nan"),
                    float(np.median(errors_at_bound(bounds)) * per),
                )
            lines.append(Compared(contact, side, kind, figure, ours))
    return lines


def error_table(found: Sequence[SingleContact]) -> str:
    header = ["contact", "element", "error", "paper"]
    header += [f"{method}, {noise}" for noise in NOISES for method in ("SLSQP", "tracker")]
    rows = []
    for contact, side, kind, figure, ours in compared(found):
        name = {"f": "face", "e": "edge", "v": "vertex"}[contact.value[0 if side == "object" else 2]]
        unit, digits = ("deg", 3) if kind == "angle" else ("mm", 2)
        cells = [f"{size:.{digits}f}" for noise in NOISES for size in ours[noise][:2]]
        bound = f"{ours['white'][2]:.{digits}f}"
        rows.append([contact.value, f"{name}, {side}", f"{kind}, {unit}", f"{figure:g}", *cells, bound])
    return markdown([*header, "bound"], rows)


def over_bound_sentence(found: Sequence[SingleContact]) -> str:
    """How far both methods are above the bound."""
    parts = []
    for noise in NOISES:
        ratios = np.array([np.array(ours[noise][:2]) / ours[noise][2] for *_, ours in compared(found)])
        middle, worst = np.nanmedian(ratios, axis=0), np.nanmax(ratios, axis=0)
        parts.append(
            f"with {noise} noise SLSQP's errors are {middle[0]:.1f} times the bound in the median of these rows "
            f"and {worst[0]:.1f} in the worst, the tracker's {middle[1]:.1f} and {worst[1]:.1f}"
        )
    sentence = "; ".join(parts)
    pairs = [one.ours[noise][:2] for one in compared(found) for noise in NOISES]
    worse = sum(tracker > slsqp for slsqp, tracker in pairs)
    return (
        f"{sentence[0].upper()}{sentence[1:]}. The tracker's error is the larger one in {worse} of {len(pairs)} pairs. "
        "The paper's objective adds squares of radians to squares of metres, and its minima for f-f and e-f depend on "
        "where the body frame is; the tracker weighs residuals by their noise."
    )


def gain_sentence(sequences: Mapping[str, ContactSequence]) -> str:
    """Where SLSQP is lower than the batched minimiser."""
    parts = []
    for noise, one in sequences.items():
        lower = one.slsqp_gain > 1e-4
        by = f" (by {one.slsqp_gain.max():.3f} at most)" if lower.any() else ""
        parts.append(f"{int(lower.sum())} of {lower.size} minima with {noise} noise{by}")
    higher = max(float(-one.slsqp_gain.min()) for one in sequences.values())
    return (
        "SLSQP's minimum is lower than the curve by more than 0.0001 of its maximum in "
        f"{' and '.join(parts)}. It is higher by up to {higher:.3f}, where three random starts are not enough."
    )


def within(one: ContactSequence, contact: Contact) -> NDArray[np.bool_]:
    """(W,) the windows that lie within a contact."""
    return np.asarray(one.window_truth == contact.column)


def phase_table(sequences: Mapping[str, ContactSequence]) -> str:
    header = ["noise", "windows in", *(f"curve {contact.value}" for contact in MOVED)]
    rows = []
    for noise, one in sequences.items():
        online = one.segmentation.filtered.probability[one.online]
        offline = one.segmentation.beliefs.probability[one.offline]
        for contact in MOVED:
            some = within(one, contact)
            curves = [f"{level:.4f}" for level in np.median(one.curves[some], axis=0)]
            shares = [f"{p[some, contact.column].mean():.3f}" for p in (online, offline)]
            rows.append([noise, contact.value, *curves, *shares])
    return markdown([*header, "online", "smoothed"], rows)


def remark_sentence(sequences: Mapping[str, ContactSequence]) -> str:
    """The paper's remarks, with the curves with white noise."""
    one = sequences["white"]

    def level(curve: Contact, inside: Contact) -> float:
        return float(np.median(one.curves[within(one, inside), MOVED.index(curve)]))

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
    for noise, one in sequences.items():
        last = one.truth[np.searchsorted(one.poses.stamp_ns, one.windows.stamp_ns)]
        methods = (one.lowest(), one.online_labels(), one.offline_labels())
        columns = [np.array([STATES.index(label) for label in labels]) for labels in methods]
        for name, truth in (("within one contact", one.window_truth), ("all, by the last pose", last)):
            scored = truth >= 0
            shares = [f"{np.mean(column[scored] == truth[scored]):.3f}" for column in columns]
            rows.append([noise, name, str(int(scored.sum())), *shares])
    return markdown(header, rows)
