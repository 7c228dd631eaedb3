"""Motion along one leg, smooth and random in all free directions of the contact; smooth signals."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.geometry.polyhedron import Feature, unit
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.plan import SETTLE_S, Anchor, Chart, Leg, Rigid, sample_normal, sample_point
from contact_tracker_lab.simulate.scenarios import Scenario

Weights = tuple[Array, Array, Array]
Ends = tuple[Array, Array]

_TILT_RAMP_S = 0.6  # short, so that a changed constraint is soon observable
_TURN_RAD_S = 1.2
_SLIDE_RAMP_S = 1.0
_LIFT_RAMP_S = 0.8
_MARGIN = 0.8  # share of the room up to a feature's rim that the motion uses
_CROSSING = (np.radians(65.0), np.radians(115.0))  # crossing angle of two edges during the motion
_CROSSING_ROOM_RAD = np.radians(35.0)
_SINUSOIDS = 24
_LOWEST_HZ = 0.2


@dataclass(frozen=True, eq=False)
class Hand:
    """Random motion of the hand at times ``time_s`` (N,) since the start of a leg: its root mean square in
    each free direction, and its bandwidth."""

    rng: np.random.Generator
    time_s: Array
    amplitude_m: float
    amplitude_rad: float
    bandwidth_hz: float

    def waves(self, count: int) -> Array:
        """``count`` independent signals (N, count) of unit power."""
        return band_limited(self.rng, self.time_s, count, self.bandwidth_hz)

    def turn(self, feature: Feature, centre: Array) -> Array:
        """Random normals (N, 3) around ``centre`` within the feature's cone."""
        tangents = feature.tangents(centre)
        wave = self.amplitude_rad * self.waves(len(tangents))
        return _turned(centre, within(wave, _MARGIN * feature.normal_clearance(centre)) @ tangents)

    def slide(self, feature: Feature, centre: Array) -> Array:
        """Random points (N, 3) around ``centre`` within the feature."""
        wave = self.amplitude_m * self.waves(len(feature.span))
        return centre + within(wave, _MARGIN * feature.point_clearance(centre)) @ feature.span


@dataclass(frozen=True, eq=False)
class Path:
    """Poses (object to scene) along a leg, with the touching point on either feature (N, 3) in m."""

    pose: Rigid
    touch_object: Array
    touch_scene: Array


def move(rng: np.random.Generator, leg: Leg, rate_hz: float, scenario: Scenario) -> Path:
    """The motion of ``leg`` at times of this rate, with the amplitudes of ``scenario``."""
    bandwidth_hz = rng.uniform(*scenario.bandwidth_hz)
    time_s = np.linspace(0.0, leg.duration_s, round(leg.duration_s * rate_hz), endpoint=False)
    hand = Hand(rng, time_s, scenario.amplitude_m, scenario.amplitude_rad, bandwidth_hz)
    if leg.contact is Contact.FREE:
        return _free_motion(leg, hand)
    return _touch(leg, hand) if leg.motion == "normal" else _singular(leg, hand)


def _touch(leg: Leg, hand: Hand) -> Path:
    """Motion of all coordinates of the chart: from the start anchor by random motion to the end anchor."""
    chart, start, end, rng, time_s = leg.chart, leg.start, leg.end, hand.rng, hand.time_s
    slide = blend(time_s, leg.duration_s, _SLIDE_RAMP_S)
    drifts = drift(time_s)[:, None], drift(time_s - leg.duration_s)[:, None]

    def turned(feature: Feature, first: Array, last: Array) -> Array:
        centre = sample_normal(rng, feature, unit(first + last))
        farthest = np.arccos(np.clip(min(first @ centre, last @ centre), -1.0, 1.0))
        tilt = blend(time_s, leg.duration_s, max(_TILT_RAMP_S, farthest / _TURN_RAD_S))
        return unit(_mix(tilt, first, hand.turn(feature, centre), last))

    def moved(feature: Feature, ends: Ends, rates: Ends) -> Array:
        middle = hand.slide(feature, sample_point(rng, feature, (ends[0] + ends[1]) / 2.0))
        return _mix(slide, ends[0] + drifts[0] * rates[0], middle, ends[1] + drifts[1] * rates[1])

    normal = turned(chart.environment, start.normal, end.normal)
    object_normal = turned(chart.object, start.object_normal, end.object_normal)
    spin = _spin(leg, hand, slide)
    touch_object = moved(
        chart.object, (start.touch_object, end.touch_object), (start.object_rate, end.object_rate)
    )
    touch_scene = moved(
        chart.environment, (start.touch_scene, end.touch_scene), (start.scene_rate, end.scene_rate)
    )
    return _path(chart.rotation(normal, object_normal, spin), touch_object, touch_scene)


def _spin(leg: Leg, hand: Hand, weights: Weights) -> Array:
    time_s = hand.time_s
    first, last = (
        leg.chart.spin(anchor.rotation, anchor.normal, anchor.object_normal)
        for anchor in (leg.start, leg.end)
    )
    last = first + (last - first + np.pi) % (2.0 * np.pi) - np.pi
    middle, room = (first + last) / 2.0, _room(leg.contact)
    if leg.contact is Contact.EE:
        middle = np.copysign(np.clip(abs(middle), *_CROSSING), middle)
    wave = within(hand.amplitude_rad * hand.waves(1), room)[:, 0]
    begin = first + leg.start.spin_rate * drift(time_s)
    end = last + leg.end.spin_rate * drift(time_s - leg.duration_s)
    return np.asarray(weights[0] * begin + weights[1] * (middle + wave) + weights[2] * end, float)


def _singular(leg: Leg, hand: Hand) -> Path:
    """Rest, pure translation, or rotation about one axis; ends at the pose of its start."""
    anchor, chart, time_s = leg.start, leg.chart, hand.time_s
    active = blend(time_s, leg.duration_s, _SLIDE_RAMP_S)[1][:, None]
    zeros = np.zeros((len(time_s), 1))
    if leg.motion in ("one-axis", "tilt"):
        return _rotation_about_axis(leg, hand, active * hand.waves(1))
    touch_object, touch_scene = zeros + anchor.touch_object, zeros + anchor.touch_scene
    if leg.motion == "translation":
        touch_object += active * (hand.slide(chart.object, anchor.touch_object) - anchor.touch_object)
        touch_scene += active * (hand.slide(chart.environment, anchor.touch_scene) - anchor.touch_scene)
    return _path(zeros[:, :, None] + anchor.rotation, touch_object, touch_scene)


def _rotation_about_axis(leg: Leg, hand: Hand, wave: Array) -> Path:
    """Rotation by ``wave`` (N, 1) about the normal, or about an axis within one of the features."""
    anchor, chart = leg.start, leg.chart
    sides = (chart.object, anchor.object_normal), (chart.environment, anchor.normal)
    tilts = [(*side, direction) for side in sides for direction in side[0].tangents(side[1])]
    choice = int(hand.rng.integers(0 if leg.motion == "tilt" else -1, len(tilts)))
    if choice < 0:
        axis = anchor.normal
        angle = within(hand.amplitude_rad * wave, _room(leg.contact))
    else:
        feature, normal, direction = tilts[choice]
        axis = np.cross(normal, direction)
        angle = within(hand.amplitude_rad * wave, _MARGIN * feature.normal_clearance(normal))
        if feature is chart.object:  # a turn of the normal in the body is the opposite turn of the body
            axis = -anchor.rotation @ axis
    rotation = Rotation.from_rotvec(angle * axis).as_matrix() @ anchor.rotation
    zeros = np.zeros_like(wave)
    return _path(rotation, zeros + anchor.touch_object, zeros + anchor.touch_scene)


def _room(contact: Contact) -> float:
    """Bound (rad) of the random motion of the spin."""
    return _CROSSING_ROOM_RAD if contact is Contact.EE else float(np.pi)


def _free_motion(leg: Leg, hand: Hand) -> Path:
    """Free motion: lift along the normal, transfer and descent, with random motion in all six directions."""
    time_s = hand.time_s
    first = _coast(leg.chart, leg.start, time_s)
    last = _coast(leg.next_chart, leg.end, time_s - leg.duration_s)
    share = smooth_step(time_s / leg.duration_s)[:, None]
    leave, _, land = (weight[:, None] for weight in blend(time_s, leg.duration_s, _LIFT_RAMP_S))
    height = (1.0 if leg.from_air else 1.0 - leave) * (1.0 if leg.to_air else 1.0 - land)
    wave = leg.wander * height * hand.waves(6)
    turn = Rotation.from_matrix(np.swapaxes(first.pose.rotation, 1, 2) @ last.pose.rotation).as_rotvec()
    rotation = first.pose.rotation @ Rotation.from_rotvec(share * turn).as_matrix()
    rotation = rotation @ Rotation.from_rotvec(hand.amplitude_rad * wave[:, :3]).as_matrix()
    over = (1.0 - share) * first.pose.translation + share * last.pose.translation
    up = unit((1.0 - share) * leg.start.normal + share * leg.end.normal)
    translation = over + leg.lift_m * height * up + hand.amplitude_m * wave[:, 3:]
    return Path(Rigid(rotation, translation), first.touch_object, first.touch_scene)


def _coast(chart: Chart, anchor: Anchor, time_s: Array) -> Path:
    """Motion with the velocity of ``anchor`` at time 0, which decays before and after."""
    lasting = drift(time_s)
    spin = chart.spin(anchor.rotation, anchor.normal, anchor.object_normal) + anchor.spin_rate * lasting
    zeros = np.zeros((len(time_s), 1))
    return _path(
        chart.rotation(zeros + anchor.normal, zeros + anchor.object_normal, spin),
        anchor.touch_object + lasting[:, None] * anchor.object_rate,
        anchor.touch_scene + lasting[:, None] * anchor.scene_rate,
    )


def _path(rotation: Array, touch_object: Array, touch_scene: Array) -> Path:
    translation = touch_scene - np.einsum("nij,nj->ni", rotation, touch_object)
    return Path(Rigid(rotation, translation), touch_object, touch_scene)


def _mix(weights: Weights, start: Array, middle: Array, end: Array) -> Array:
    first, inner, last = (weight[:, None] for weight in weights)
    return np.asarray(first * start + inner * middle + last * end, float)


def _turned(centre: Array, displacement: Array) -> Array:
    """Unit vectors reached from ``centre`` along great circles; ``displacement`` (N, 3) in rad."""
    angle = np.linalg.norm(displacement, axis=1, keepdims=True)
    return np.asarray(np.cos(angle) * centre + np.sinc(angle / np.pi) * displacement, float)


def band_limited(rng: np.random.Generator, time_s: Array, count: int, bandwidth_hz: float) -> Array:
    """``count`` independent random signals (N, count) of mean 0 and about unit power below ``bandwidth_hz``.

    Power is normalised over ``time_s`` (N,), so that each signal moves in every leg; in very short legs it
    stays below one.
    """
    shape = (_SINUSOIDS, count)
    frequency = rng.uniform(min(_LOWEST_HZ, bandwidth_hz / 2), bandwidth_hz, shape)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape)
    angle = 2.0 * np.pi * frequency * time_s[:, None, None] + phase
    signal = np.sqrt(2.0 / _SINUSOIDS) * np.sin(angle).sum(axis=1)
    signal -= signal.mean(axis=0)
    return np.asarray(signal / np.maximum(signal.std(axis=0), 0.5), float)


def within(displacement: Array, radius: float) -> Array:
    """Displacements (N, d) softly bounded to less than ``radius``, unchanged where small."""
    length = np.linalg.norm(displacement, axis=-1, keepdims=True)
    return np.asarray(displacement / np.sqrt(1.0 + (length / max(radius, 1e-12)) ** 2), float)


def smooth_step(x: Array) -> Array:
    """0 for x <= 0, 1 for x >= 1, between them with continuous first and second derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2), float)


def blend(time_s: Array, duration_s: float, ramp_s: float) -> tuple[Array, Array, Array]:
    """Weights (N,) of the start, the middle and the end of a leg, which sum to one."""
    ramp = min(ramp_s, duration_s / 2.0)
    start = 1.0 - smooth_step(time_s / ramp)
    end = smooth_step((time_s - duration_s) / ramp + 1.0)
    return start, 1.0 - start - end, end


def drift(time_s: Array) -> Array:
    """Displacement (N,) per unit of speed at time 0; the speed decays before and after."""
    return np.asarray(SETTLE_S * np.tanh(time_s / SETTLE_S), float)
