"""The classes in a saved state: values, made from their fields, and mutable objects."""

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from contact_tracker.adaptation import (
    clearance,
    comparison,
    contradiction,
    conventions,
    explained,
    impacts,
    online,
    rest,
    side_by_side,
)
from contact_tracker.config import parameters
from contact_tracker.formations import online as online_formations
from contact_tracker.geometry import elements
from contact_tracker.hypotheses import bank, birth, birth_proposals, tick_update
from contact_tracker.inspection import stream_checks, turning_point, whiteness
from contact_tracker.landmarks import prior_map
from contact_tracker.map import elements as map_elements
from contact_tracker.map import sighting, world_map
from contact_tracker.motion import (
    default_poses,
    excursions,
    free_motion,
    pose_steps,
    pose_validation,
    poses,
    sensor_noise,
    stamp_order,
    tick_averaging,
    tick_grid,
    window,
)
from contact_tracker.saved_state.progress import Progress
from contact_tracker.states import Contact
from contact_tracker.tracking import belief, curved_motion, state

VALUES: Final[tuple[type, ...]] = (
    Contact,
    clearance.Clearance,
    comparison.TickEvidence,
    contradiction.Contradiction,
    conventions.Conventions,
    explained.Explained,
    impacts.Impacts,
    online.AdaptiveState,
    rest.Rest,
    side_by_side.FirstTick,
    side_by_side.SideBySide,
    side_by_side.TrackedTick,
    parameters.Certainty,
    parameters.Geometry,
    parameters.Model,
    parameters.Motion,
    parameters.Noise,
    parameters.Search,
    parameters.SystematicErrors,
    parameters.TransitionCounts,
    parameters.Transitions,
    elements.ContactGeometry,
    elements.Line,
    elements.Plane,
    elements.Point,
    elements.Unobserved,
    bank.Bank,
    bank.Onsets,
    birth.BirthProposals,
    birth_proposals.CachedProposals,
    birth_proposals.Frame,
    tick_update.LiveHypotheses,
    stream_checks.Inspection,
    turning_point.TurningPoints,
    whiteness.Whiteness,
    map_elements.MapElement,
    sighting.ElementEstimate,
    sighting.Sighting,
    world_map.Map,
    world_map.MapPrior,
    prior_map.NamedElement,
    prior_map.PriorMap,
    prior_map.Up,
    free_motion.FreeMotion,
    free_motion.InnovationExcess,
    pose_steps.Step,
    poses.Pose,
    poses.Poses,
    sensor_noise.NoiseBuffer,
    sensor_noise.NoiseEstimate,
    stamp_order.Ordered,
    tick_averaging.StreamState,
    tick_averaging.Tick,
    tick_grid.TickState,
    window.SlidingWindow,
    window.Window,
    belief.Belief,
    belief.FurtherContact,
    online_formations.FormationState,
    online_formations.ContactElements,
    online_formations.TrackedContact,
    curved_motion.CurvedMotion,
    state.TrackerState,
    Progress,
)
EMPTY_OBJECTS: Final[tuple[Callable[[], Any], ...]] = (
    pose_validation.PoseGate,
    lambda: stamp_order.StampOrder(Counter()),
    stamp_order.Periods,
    lambda: default_poses.DefaultPoseFilter(Counter()),
    lambda: excursions.ExcursionFilter(Counter()),
)
"""Functions that make empty mutable objects, whose fields are then restored."""
