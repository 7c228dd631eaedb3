"""Fits of finished segments: the touching elements, and the contacts that fit as well."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.contact_motion import ContactMotion, contact_motion
from contact_tracker.contacts.task_frame import TaskFrame, task_frame
from contact_tracker.explanations.conditional_contact import ExplainedTicks, KnownContact
from contact_tracker.explanations.curved_contact import FaceNormals
from contact_tracker.explanations.further_contacts import NO_FORMATION, Formation, Ranks, find_formation
from contact_tracker.explanations.joint_evidence import Joint, joint_of
from contact_tracker.explanations.joint_parts import find_joints, rests_in
from contact_tracker.geometry.elements import ContactGeometry, Origins, pack, shifted
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import nearest
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.births import (
    BirthProposals,
    map_evidence,
    propose_births,
    propose_measured,
)
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.hypotheses.observability import FittedContact, element_estimate, fitted_contact
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.map.association import ElementEstimate
from contact_tracker.map.elements import is_same_element
from contact_tracker.map.map import Map
from contact_tracker.map.pairs import Frame
from contact_tracker.motion.free_motion import LONGEST_COAST_S, NOW_TICKS
from contact_tracker.motion.window import Window, at_rest
from contact_tracker.states import STATES, Contact, united
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.ambiguity import (
    CompetingEvidence,
    Freedom,
    curved_probabilities,
    is_mostly_curved,
)
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import BELIEF, Beliefs
from contact_tracker.tracking.state import scales_of
from contact_tracker.wrenches.contact_evidence import WindowEvidence

LONGEST_TICKS: Final = 6000
"""Largest number of ticks of a segment that are fitted."""
MOTION, FLUSH, REST, GAP = range(4)
"""Kinds of ticks: motion in contact or free, with a face that may be flush, at rest, and in a long gap."""
PIECE_TICKS: Final = 60
"""Length, in ticks, of the pieces of a longer segment; those with the most motion are fitted."""


@dataclass(frozen=True, eq=False)
class SegmentTicks:
    """All ticks of a segment, and the parameters of its fit."""

    window: Window
    contact: Contact
    model: Model
    known_map: Map
    origins: Origins
    wrenches: WindowEvidence | None = None
    """The evidence of measured wrenches."""
    touched: tuple[FaceNormals, ...] = ()
    """The normals of faces that touched in the recording."""

    def explained(self, window: Window) -> ExplainedTicks:
        """The ticks of ``window``, whose motion joints or further contacts may explain."""
        model, of = self.model, (self.origins, self.known_map)
        return ExplainedTicks(window, scales_of(model), model.systematic, model.transitions.leave_per_s, *of)


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """The fit of one segment, with fields as in ``Belief``. ``may_touch`` is the probability in each tick
    (n,), or (1,) in all of them, that free motion is a contact: with a curved surface, or of any kind.
    ``share`` (7,) is the share of each indistinguishable contact in their total probability, if wrenches have
    decided it."""

    contact: Contact
    geometry: ContactGeometry | None
    inseparable: tuple[Contact, ...]
    may_touch: Array
    share: Array | None = None
    formation: Formation = NO_FORMATION
    joints: tuple[tuple[int, Joint], ...] = ()
    """Joints that follow one another, each with the number of its first tick."""
    estimate: ElementEstimate | None = None
    """Joint estimate of both elements; None without elements."""
    is_on_map: bool = False
    """Whether elements that are known otherwise have decided it: it shows nothing more of them."""
    tolerance: tuple[float, float] | None = None

    @property
    def touches_listed(self) -> bool:
        """Whether an element is one that is listed with a name."""
        geometry = self.geometry
        return geometry is not None and (geometry.object.name or geometry.environment.name) is not None

    @property
    def leaves_constraints_unnamed(self) -> bool:
        """Whether the motion keeps more constraints than the reported contacts explain."""
        unexplained = any(joint.kind.constraints > self.constraints for _, joint in self.joints)
        return self.formation.is_open or unexplained

    @property
    def with_flush(self) -> tuple[Contact, ...]:
        """The inseparable states, with f-f, in ticks in which the face does not turn."""
        return united(self.inseparable, (Contact.FF,))

    @property
    def constraints(self) -> int:
        """Number of constraints of the reported contacts."""
        return max(self.formation.constraints, self.contact.codimension)


def fit_segment(segment: SegmentTicks) -> SegmentFit:
    """The fit of a segment from scratch: its contact, by the fits of all contacts, and its joint."""
    window = _most_moving(segment.window)
    fits = [_fitted(contact, window, segment) for contact in CONTACT_MODELS]
    fit = _contact_fit(segment, window, fits)
    banks = zip(CONTACT_MODELS, fits, strict=True)
    contacts = [KnownContact(model.contact, bank.x[0]) for model, bank in banks if len(bank)]
    rests = rests_in(segment.window.index, at_rest(segment.window, segment.model.tick_s))
    joints, power = list[tuple[int, Joint]](), segment.model.certainty.posterior_power
    for joint in find_joints(segment.explained(window), rests, contacts, fit.constraints):
        probability = float(expit(power * joint.log_odds))
        joints.append((int(joint.ticks.window.index[0]), joint_of(joint, probability)))
    if not joints:
        return fit
    fit = replace(fit, joints=tuple(joints))
    if not fit.leaves_constraints_unnamed or fit.share is not None:
        return fit
    rivals = tuple(state for state in STATES if state is not fit.contact and segment.known_map.allows(state))
    return replace(fit, inseparable=rivals)


PART_TICKS: Final = 30
"""Ticks of free motion that are tested for contact together. Ten programs of a robot with 0.02 mm of noise
that keep contact for 12 of 18 s are surely free for none of that, with 15 and 30, with 60 for 8 s in all, and
without the test for 69 s; six recordings of everyday handling are surely right for 0.493, 0.500 and 0.509
(measured once)."""


def _rivals(
    label: Contact, window: Window, fits: Sequence[Bank], tick_s: float
) -> tuple[CompetingEvidence, Freedom]:
    """The evidence of the fits of all contacts to a window, and the freedom that its motion uses."""
    evidence = np.array([*(fit.log_likelihood.max(initial=-np.inf) for fit in fits), 0.0])
    rms = np.array([*(fit.rms.min(initial=np.inf) for fit in fits), 1.0])
    freedom = ambiguity.freedom_of(label, window, int(window.index[0]))
    if label is Contact.FF:
        freedom = ambiguity.freedom_by_moves(freedom, window, tick_s)
    return CompetingEvidence(evidence, rms), freedom


def _may_touch_in_parts(segment: SegmentTicks) -> Array:
    """In which ticks (n,) of free motion a contact explains the part around them as well (1 or 0).

    Smooth motion of a machine is hardly larger than the least noise of ticks, which may be larger than that
    of the poses. Then the prior decides, and the whole segment hides a contact in one of its parts.
    """
    window, may_touch = segment.window, np.zeros(len(segment.window))
    if not ambiguity.has_least_noise(window):
        return may_touch
    last = max(len(window) - PART_TICKS, 0)
    for first in {*range(0, last, PART_TICKS // 2), last}:
        part = window.cut(first, first + PART_TICKS)
        fits = [_fitted(contact, part, segment) for contact in CONTACT_MODELS]
        if ambiguity.indistinguishable(
            Contact.FREE, *_rivals(Contact.FREE, part, fits, segment.model.tick_s)
        ):
            may_touch[first : first + PART_TICKS] = 1.0
    return may_touch


def _contact_fit(segment: SegmentTicks, window: Window, fits: Sequence[Bank]) -> SegmentFit:
    model, known_map, label = segment.model, segment.known_map, segment.contact
    rivals, freedom = _rivals(label, window, fits, model.tick_s)
    inseparable = tuple(filter(known_map.allows, ambiguity.indistinguishable(label, rivals, freedom)))
    may_touch, none_fits, share = np.zeros(1), False, None
    if label is Contact.FREE:
        may_touch = curved_probabilities(segment.window, scales_of(model), known_map, segment.touched)
        none_fits = is_mostly_curved(may_touch) and not freedom.one_direction
        inseparable = known_map.allowed if none_fits else inseparable
        if not inseparable and segment.wrenches is None:
            may_touch = np.maximum(may_touch, _may_touch_in_parts(segment))
    if segment.wrenches is not None:
        evidence = segment.wrenches.log_evidence
        label, inseparable, share = ambiguity.decide_by_wrenches(label, inseparable, evidence)
    if label is Contact.FREE or none_fits:  # without elements
        return SegmentFit(label, None, inseparable, may_touch, share)
    contact, scales = CONTACT_MODELS[label.column], scales_of(model)
    fit = fits[label.column] if share is None else _measured_fit(segment, window, contact, fits[label.column])
    extra_variance = model.noise.extra_contact_variance[label.column]
    window = window.with_error(extra_variance)
    fitted, information, located = _located(segment, contact, fit, window)
    formation = find_formation(segment.explained(window), KnownContact(label, fitted.x[0]))
    others = united(*(contact.inseparable for contact in formation.further))
    alike = tuple(filter(known_map.allows, ambiguity.alike_in_formation(label, rivals, others)))
    if formation.further and alike and share is None:
        inseparable = united(inseparable, alike)
    estimate = element_estimate(fitted, contact, scales, window, information)
    geometry = located.geometry
    if ambiguity.may_be_free(label, geometry, window):
        inseparable = united(inseparable, (Contact.FREE,))
    tolerance = _tolerance(contact, fitted.x, window) if any(extra_variance) else None
    parts = label, geometry, inseparable, np.zeros(1), share, formation
    return SegmentFit(*parts, estimate=estimate, tolerance=tolerance)


def fit_on_map(
    segment: SegmentTicks, fit: SegmentFit, pairs: BirthProposals, moved: bool = True
) -> SegmentFit:
    """The fit without those indistinguishable states against which the poses are evidence, since they are on
    one of these ``pairs`` of elements, which are listed or which other contacts of the recording have
    touched; its elements are then the pair's.

    Free motion stays open if the motion keeps more constraints than the contact has, as on a slider just
    above a plane, and if these pairs were not seen to be touched while the object ``moved``, but only where
    it rested, as robots hold still in the air, too; both together leave the fit as it is. So it is if the
    motion itself shows the contact, or if wrenches have decided it.
    """
    if not fit.inseparable or fit.geometry is None or fit.share is not None:
        return fit
    if fit.leaves_constraints_unnamed and not moved:
        return fit
    model, contact, scales = segment.model, CONTACT_MODELS[fit.contact.column], scales_of(segment.model)
    error = model.noise.extra_contact_variance[fit.contact.column]
    against, touched = map_evidence(contact, pairs, segment.window.with_error(error), scales)
    if fit.leaves_constraints_unnamed or not moved:
        against[Contact.FREE.column] = 0.0
    inseparable = tuple(state for state in fit.inseparable if against[state.column] < DECISIVE)
    if inseparable == fit.inseparable:
        return fit
    window = _most_moving(segment.window).with_error(error)
    on_map = fit_window(contact, window, scales, pairs.pick(np.array([touched])))
    fitted, information, located = _located(segment, contact, on_map, window)
    estimate = element_estimate(fitted, contact, scales, window, information)
    tolerance = None if fit.tolerance is None else _tolerance(contact, fitted.x, window)
    decided = replace(fit, inseparable=inseparable, geometry=located.geometry, tolerance=tolerance)
    return replace(decided, estimate=estimate, is_on_map=True)


def _located(
    segment: SegmentTicks, contact: ContactModel, fit: Bank, window: Window
) -> tuple[Bank, Array, FittedContact]:
    """The refined fit of a contact to a window, the information of its motion, and where its elements are."""
    scales = scales_of(segment.model)
    fitted, information = refine(fit, contact, window, scales)
    parts = window, segment.origins, segment.model.systematic, information, segment.known_map
    located = fitted_contact(fitted, 0, contact, scales, *parts)
    return fitted, information, located


def _tolerance(contact: ContactModel, x: Array, window: Window) -> tuple[float, float]:
    """Root mean square errors (m, rad) of a contact with elements x (1, S) in the ticks with frames."""
    assert window.frames is not None
    square = contact.measure(x, window.zeta[window.frames > 0]).residual[0] ** 2
    angle = square[:-1].mean() if len(square) > 1 else 0.0
    return float(np.sqrt(square[-1].mean())), float(np.sqrt(angle))


def _measured_fit(segment: SegmentTicks, window: Window, contact: ContactModel, by_motion: Bank) -> Bank:
    """The best hypothesis of a contact whose elements are those through which the measured forces act.

    Motion that does not determine the contact does not determine its elements either: several minima fit.
    """
    measured = segment.wrenches.elements.get(contact.contact) if segment.wrenches is not None else None
    if measured is None or measured == (None, None):
        return by_motion
    proposals = propose_measured(contact, segment.known_map, measured, _frame(segment, window))
    noisier = window.with_error(segment.model.noise.extra_contact_variance[contact.contact.column])
    return fit_window(contact, noisier, scales_of(segment.model), proposals)


def _frame(segment: SegmentTicks, window: Window) -> Frame:
    return Frame.around(segment.origins, window.zeta[:, T].mean(axis=0))


def _fitted(contact: ContactModel, window: Window, segment: SegmentTicks) -> Bank:
    """The best hypothesis of a contact for a whole segment, if the contact is possible."""
    proposals = propose_births(contact, segment.known_map, None, 0.0, _frame(segment, window))
    noisier = window.with_error(segment.model.noise.extra_contact_variance[contact.contact.column])
    return fit_window(contact, noisier, scales_of(segment.model), proposals)


def _most_moving(window: Window) -> Window:
    """The window, or if it is very long its pieces with the most motion, in order."""
    if len(window) <= LONGEST_TICKS:
        return window
    pieces = len(window) // PIECE_TICKS
    by_piece = window.motion_ratio[: pieces * PIECE_TICKS].reshape(pieces, PIECE_TICKS).sum(axis=1)
    chosen = np.sort(np.argsort(-by_piece, kind="stable")[: LONGEST_TICKS // PIECE_TICKS])
    rows = (chosen[:, None] * PIECE_TICKS + np.arange(PIECE_TICKS)).ravel()
    before = window.before if not rows[0] else window.zeta[rows[0] - 1]
    return replace(window.pick(rows), before=before)


class FinishedSegment(NamedTuple):
    """A segment: the ``column`` of its state, its ``rows`` of n ticks (``start_ns``, ``stamp_ns``,
    ``residual``), when it ends, the ``posterior`` (n, 7), the ``ticks`` that contacts are fitted to, and
    which of them (n,) belong to a rest."""

    column: int
    rows: NDArray[np.void]
    end_ns: int
    posterior: Array
    ticks: SegmentTicks
    resting: NDArray[np.bool_]

    def followed_by(self, following: "FinishedSegment") -> "FinishedSegment":
        """This segment joined with the next one."""
        ticks = replace(self.ticks, window=Window.join([self.ticks.window, following.ticks.window]))
        return FinishedSegment(
            self.column,
            np.concatenate([self.rows, following.rows]),
            following.end_ns,
            np.concatenate([self.posterior, following.posterior]),
            ticks,
            np.concatenate([self.resting, following.resting]),
        )

    def as_free(self, fit: SegmentFit) -> tuple[tuple[Segment, ...], Beliefs]:
        """The same as ``with_fit`` as free motion, which divides the probability with the contact of the
        ``fit``, and is open to it and to what is open beside it."""
        free, rivals = Contact.FREE, united(fit.inseparable, (fit.contact,))
        shared = [ambiguity.shared_with(probability, free, [fit.contact]) for probability in self.posterior]
        segment = self._replace(column=free.column, posterior=np.array(shared))
        rivals = tuple(state for state in rivals if state is not free)
        return segment.with_fit(SegmentFit(free, None, rivals, np.zeros(1)))

    def with_fit(self, fit: SegmentFit) -> tuple[tuple[Segment, ...], Beliefs]:
        """The segment, split where the object rests or is not seen, and the beliefs of its ticks."""
        fit = self._open_to_likelier_states(fit)
        contact, column, known_map = fit.contact, fit.contact.column, self.ticks.known_map
        beliefs = np.zeros(len(self.rows), BELIEF)
        may_touch = np.broadcast_to(fit.may_touch, len(beliefs))
        is_open = (may_touch > 0.5) & (fit.share is None)
        at_rest = ambiguity.others_at_rest(contact, known_map, fit.inseparable)
        elsewhere = tuple(state for state in STATES if state is not contact and known_map.allows(state))
        open_states = fit.inseparable, fit.with_flush, at_rest, elsewhere
        kinds = self._tick_kinds(fit, bool(at_rest))
        for belief, posterior, kind, bends in zip(beliefs, self.posterior, kinds, is_open, strict=True):
            states = fit.with_flush if kind == FLUSH else known_map.allowed if bends else fit.inseparable
            args = states, known_map, fit.leaves_constraints_unnamed, fit.share
            probability = ambiguity.reported(posterior, contact, *args)
            if kind >= REST:
                states = open_states[kind]
                probability = ambiguity.at_most(probability, contact, possible=states)
            belief["probability"] = probability
            belief["inseparable"] = [state in states for state in STATES]
        beliefs["stamp_ns"], beliefs["onset_ns"] = self.rows["stamp_ns"], self.rows["start_ns"][0]
        beliefs["contact"], beliefs["residual"] = column, self.rows["residual"]
        beliefs["geometry"] = -1 if fit.geometry is None else 0
        joints = [joint for _, joint in fit.joints]
        joint_number = np.where(kinds >= REST, -1, self._joint_numbers(fit))
        beliefs["joint"] = joint_number
        further = self._further(fit.formation)
        beliefs["further"], formations = _formations_of(further, self.rows["stamp_ns"], fit.formation.ranks)
        contacts = tuple(contact for _, contact in further)
        change = (np.diff(kinds) != 0) | (np.diff(joint_number) != 0)
        changes = [*np.flatnonzero(change) + 1, len(kinds)]
        at_contact = self._at_contact(fit.contact, fit.geometry)
        spans = [*pairwise([0, *changes])]
        means = [beliefs["probability"][first:end].mean(axis=0) for first, end in spans]
        segments = tuple(
            Segment(
                *self._span(first, end),
                contact,
                float(mean[column]),
                fit.geometry,
                open_states[kinds[first]],
                _within(contacts, *self._span(first, end)),
                None if joint_number[first] < 0 else joints[joint_number[first]],
                *at_contact(first, end),
                fit.tolerance,
                mean,
            )
            for (first, end), mean in zip(spans, means, strict=True)
        )
        geometries = [] if fit.geometry is None else [pack(fit.geometry)]
        return segments, Beliefs(beliefs, geometries, formations, joints)

    def _joint_numbers(self, fit: SegmentFit) -> NDArray[np.int64]:
        """The number (n,) of the joint of each tick among those of the ``fit``, or -1."""
        if not fit.joints:
            return np.full(len(self.rows), -1)
        later = [first for first, _ in fit.joints[1:]]
        return np.searchsorted(later, self.ticks.window.index, side="right")

    def _tick_kinds(self, fit: SegmentFit, opens_at_rest: bool) -> NDArray[np.int64]:
        """What each tick (n,) shows: ``MOTION``, a ``FLUSH`` face, a ``REST``, or nothing, in a ``GAP`` so
        long that the object may have been elsewhere. With wrenches, which show more, only motion and gaps."""
        kinds = np.full(len(self.rows), MOTION)
        if opens_at_rest and fit.share is None:
            kinds[self._flush(fit)] = FLUSH
            kinds[self.resting] = REST
        empty = np.diff(self.rows["count"] == 0.0, prepend=False, append=False)
        for first, end in np.flatnonzero(empty).reshape(-1, 2):
            if (end - first) * self.ticks.model.tick_s > LONGEST_COAST_S:
                kinds[first:end] = GAP
        return kinds

    def _open_to_likelier_states(self, fit: SegmentFit) -> SegmentFit:
        """The fit open to the states that are more probable than the label in the mean over the segment: the
        most probable sequence may have it nevertheless. Not where wrenches have decided."""
        if fit.share is not None:
            return fit
        likelier = ambiguity.likelier_states(self.posterior.mean(axis=0), fit.contact)
        return replace(fit, inseparable=united(fit.inseparable, likelier))

    def _at_contact(
        self, contact: Contact, geometry: ContactGeometry | None
    ) -> Callable[[int, int], tuple[ContactMotion | None, TaskFrame | None]]:
        """A function of a span of ticks that returns the motion of the object at the touching point and the
        task frame in the middle, both from the ticks with frames."""
        ticks, (world_m, body_m) = self.ticks, self.ticks.origins.reversed
        assert ticks.window.frames is not None
        kept = ticks.window.frames.astype(bool)
        filled_before, motion = np.append(0, np.cumsum(kept)), None
        if geometry is not None:
            local = ContactGeometry(shifted(geometry.object, body_m), shifted(geometry.environment, world_m))
            zeta = ticks.window.zeta[kept]
            time_s = np.multiply(ticks.window.index[kept], ticks.model.tick_s, dtype=np.float64)
            quat_xyzw = np.array([nearest(mean) for mean in zeta[:, R]]).reshape(-1, 4)
            stamp_ns, variance = self.rows["stamp_ns"][kept], ticks.window.variance[kept]
            motion = contact_motion(local, stamp_ns, time_s, quat_xyzw, zeta[:, T], variance)

        def within(first: int, end: int) -> tuple[ContactMotion | None, TaskFrame | None]:
            rows = slice(filled_before[first], filled_before[end])
            if geometry is None or rows.start == rows.stop:
                return None, None
            middle, T_local_body = zeta[(rows.start + rows.stop) // 2], np.eye(4)
            T_local_body[:3, :3], T_local_body[:3, 3] = middle[R].reshape(3, 3), middle[T]
            frame = task_frame(contact, local, T_local_body)
            if frame is not None:
                T_world_task = frame.T_world_task.copy()
                T_world_task[:3, 3] -= world_m
                frame = replace(frame, T_world_task=T_world_task)
            return None if motion is None else motion[rows], frame

        return within

    def _flush(self, fit: SegmentFit) -> NDArray[np.bool_]:
        """The ticks (n,) in which f-f explains the motion as well."""
        ticks = self.ticks
        if fit.geometry is None or not ticks.known_map.allows(Contact.FF):
            return np.zeros(len(self.rows), bool)
        flush = ambiguity.may_be_flush(fit.contact, fit.geometry, ticks.window, ticks.model.tick_s)
        return without_short_gaps(flush)

    def _span(self, first: int, end: int) -> tuple[int, int]:
        """Start and end (ns) of the ticks ``first`` to ``end`` (excluded)."""
        begins = np.append(self.rows["start_ns"], self.end_ns + 1)
        return int(begins[first]), int(begins[end] - 1)

    def _further(self, formation: Formation) -> list[tuple[int, FurtherContact]]:
        """The further contacts with times and indices, in the order of their start times."""
        first_tick, power = int(self.ticks.window.index[0]), self.ticks.model.certainty.posterior_power
        contacts = [
            (
                number,
                FurtherContact(
                    contact.known.contact,
                    float(expit(power * contact.log_odds)) * ambiguity.most_beside(len(contact.inseparable)),
                    *self._span(run.first - first_tick, run.end - first_tick),
                    contact.geometry,
                    contact.inseparable,
                    formation.constraints_with(number),
                ),
            )
            for number, contact in enumerate(formation.further)
            for run in contact.runs
        ]
        return sorted(contacts, key=lambda contact: contact[1].start_ns)


def without_short_gaps(within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The ticks ``within`` (n,), with the gaps shorter than ``NOW_TICKS`` closed."""
    within = within.copy()
    edges = np.flatnonzero(np.diff(within, prepend=False, append=False))
    for first, end in pairwise([0, *edges, len(within)]):
        if end - first < NOW_TICKS and within.any():
            within[first:end] = True
    return within


def joined_by_wrenches(
    fitted: Sequence[tuple[FinishedSegment, SegmentFit]],
) -> list[tuple[FinishedSegment, SegmentFit]]:
    """Segments with their fits, after merging equal neighbours.

    If wrenches have decided the contact of a segment, its neighbour may have the same contact and
    elements: both become one segment, with the elements of the longer part.
    """
    joined = list[tuple[FinishedSegment, SegmentFit]]()
    for segment, fit in fitted:
        if joined and _are_one_segment(joined[-1], (segment, fit)):
            previous, earlier = joined[-1]
            lengths = len(previous.rows), len(segment.rows)
            parts = zip((earlier.may_touch, fit.may_touch), lengths, strict=True)
            may_touch = np.concatenate([np.broadcast_to(*part) for part in parts])
            longer = fit if lengths[1] > lengths[0] else earlier
            joined[-1] = previous.followed_by(segment), replace(longer, may_touch=may_touch)
        else:
            joined.append((segment, fit))
    return joined


def _are_one_segment(*neighbours: tuple[FinishedSegment, SegmentFit]) -> bool:
    """Whether two neighbours have the same contact, decided by wrenches in one of them."""
    a, b = (fit for _, fit in neighbours)
    is_chosen = any(STATES[segment.column] is not fit.contact for segment, fit in neighbours)
    is_complex = any(fit.formation.further or fit.joints for _, fit in neighbours)
    if a.contact is not b.contact or not is_chosen or is_complex:
        return False
    if a.geometry is None or b.geometry is None:
        return a.geometry is b.geometry
    return is_same_element(a.geometry.object, b.geometry.object) and is_same_element(
        a.geometry.environment, b.geometry.environment
    )


def _within(further: Sequence[FurtherContact], start_ns: int, end_ns: int) -> tuple[FurtherContact, ...]:
    """The parts of further contacts from ``start_ns`` to ``end_ns`` (both included)."""
    spans = [(max(contact.start_ns, start_ns), min(contact.end_ns or end_ns, end_ns)) for contact in further]
    return tuple(
        replace(contact, start_ns=first_ns, end_ns=last_ns)
        for contact, (first_ns, last_ns) in zip(further, spans, strict=True)
        if first_ns <= last_ns
    )


def _formations_of(
    further: Sequence[tuple[int, FurtherContact]],
    stamp_ns: NDArray[np.int64],
    ranks: Ranks,
) -> tuple[NDArray[np.int64], list[tuple[FurtherContact, ...]]]:
    """The number (n,) of each tick's formation, or -1, and the further contacts of each formation."""
    number = np.full(len(stamp_ns), -1)
    if not further:
        return number, []
    is_present = np.array(
        [
            (stamp_ns >= c.start_ns) & (stamp_ns <= (stamp_ns[-1] if c.end_ns is None else c.end_ns))
            for _, c in further
        ]
    )
    patterns, pattern_index = np.unique(is_present, axis=1, return_inverse=True)
    formations = []
    for pattern in patterns.T:
        present = [contact for contact, is_there in zip(further, pattern, strict=True) if is_there]
        numbers = frozenset(number for number, _ in present)
        rank = max((rank for subset, rank in ranks if subset <= numbers), default=0)
        formations.append(tuple(replace(contact, constraints=rank) for _, contact in present))
    number[:] = pattern_index
    number[~is_present.any(axis=0)] = -1
    return number, formations
