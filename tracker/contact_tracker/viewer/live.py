"""Live view: beliefs streamed to the rerun viewer."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Self

import numpy as np

from contact_tracker.errors import ViewerError
from contact_tracker.geometry.elements import Array
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.text import Changes, is_settled
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.informative_motion import InformativeMotion
from contact_tracker.viewer import canvas
from contact_tracker.viewer.canvas import Canvas, caption, event, further_caption, further_event
from contact_tracker.viewer.parts import KnownParts
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Upward, draw
from contact_tracker.viewer.sinks import Sink, close, to_viewer

_CLOSE_S: Final = 5.0
_FRAME_NS: Final = 10_000_000
_REDRAW_NS: Final = 500_000_000


class LiveViewer:
    """Shows the body at up to 100 Hz, and all else by belief; a context manager that closes itself.

    Parameters
    ----------
    vertices_m : (V, 3) of the object in the body frame, where known.
    sink : destination; by default a viewer on this machine, which is started if necessary.
    origin_ns : returns the stamp from which times count, after the first pose; by default the first pose's.
    known_map : what is known of the object and its surroundings.

    Raises
    ------
    ViewerError : the viewer does not start.
    """

    def __init__(
        self,
        vertices_m: Array | None = None,
        sink: Sink | None = None,
        origin_ns: Callable[[], int] | None = None,
        known_map: Map = EMPTY_MAP,
    ) -> None:
        self._known = KnownParts(known_map, vertices_m)
        self._world: GrowingMap | None = None
        self._extent = self._known.object_extent or UNKNOWN_EXTENT
        self._recording = canvas.new_recording()
        self._sheet: Canvas | None = None
        self._origin = origin_ns
        self._origin_ns = self._shown_ns = self._drawn_ns = 0
        self._upward = Upward(self._extent)
        self._changes = Changes()
        self._contact: Contact | None = None
        self._inseparable: tuple[Contact, ...] = ()
        self._is_open = False
        self._waiting: deque[Pose] = deque()
        self._last: Pose | None = None
        (sink or to_viewer())(self._recording, canvas.live_layout(self._upward.eye(self._extent.radius_m)))

    def pose(self, pose: Pose) -> None:
        """Move the body, at up to 100 Hz."""
        if self._sheet is None:
            self._origin_ns = pose.stamp_ns if self._origin is None else self._origin()
            self._sheet = Canvas(self._recording, self._origin_ns, self._extent.radius_m)
            self._sheet.known(self._known.bodies, pose.stamp_ns)
            self._sheet.centre(self._extent.centre_m)
        if pose.stamp_ns - self._shown_ns >= _FRAME_NS:
            self._shown_ns = pose.stamp_ns
            self._sheet.pose(pose)
        self._waiting.append(pose)

    def suggest(self, stamp_ns: int, motion: InformativeMotion | None) -> None:
        """Draw what to move next."""
        if self._sheet is not None:
            self._sheet.suggest(stamp_ns, motion, self._extent.radius_m)

    def belief(self, belief: Belief, world: GrowingMap | None = None) -> None:
        """Draw a belief about earlier poses, and the map where it has changed; without poses nothing is
        drawn."""
        tick = self._take(belief.stamp_ns)
        if self._sheet is None or tick is None:
            return
        self._known.add_poses(tick)
        is_new = self._known.add_contact(belief.onset_ns, belief.stamp_ns, belief.geometry)
        if is_new or world is not self._world:
            self._world = world
            self._sheet.known(self._known.parts(world), belief.stamp_ns)
        sheet, contact, p = self._sheet, belief.contact, belief.probability[belief.contact.column]
        stamp = np.array([belief.stamp_ns], np.int64)
        changed = contact is not self._contact
        sheet.trail(stamp, [tick.position_m], [contact])
        sheet.scalars(canvas.P_FILTERED, stamp, belief.probability[None])
        sheet.scalars(canvas.RESIDUAL, stamp, belief.residual[None])
        self._contact = contact
        sheet.states(canvas.FILTERED, stamp, [contact])
        is_news, joins, leaves = self._changes.update(belief)
        if is_news:
            text = event(belief.stamp_ns - self._origin_ns, p, belief.geometry, belief.inseparable)
            sheet.events(stamp, [contact], [text])
        for one, is_new in [*((one, True) for one in joins), *((one, False) for one in leaves)]:
            text = further_event(belief.stamp_ns - self._origin_ns, one, is_new)
            sheet.events(stamp, [one.contact], [text])
        if belief.inseparable != self._inseparable:
            self._inseparable = belief.inseparable
            sheet.inseparable(stamp, [belief.inseparable])
        if changed or joins or leaves or belief.stamp_ns - self._drawn_ns >= _REDRAW_NS:
            self._draw(sheet, belief, tick)
            self._drawn_ns = belief.stamp_ns
        text = caption(contact, p, belief.inseparable, self._is_open)
        sheet.fade(stamp, [contact], np.array([p]), [text])
        for number, one in enumerate(belief.further, 1):
            sheet.fade(stamp, [one.contact], np.array([one.probability]), [further_caption(one)], number)
        sheet.have_further(len(belief.further))
        now = dict(enumerate((one.contact for one in belief.further), 1))
        for number in range(1, sheet.most_further + 1):
            sheet.states(canvas.further_lane(number), stamp, [now.get(number)])

    def _draw(self, sheet: Canvas, belief: Belief, tick: Poses) -> None:
        geometry, lasted_ns = belief.geometry, belief.stamp_ns - (self._drawn_ns or belief.stamp_ns)
        if geometry is not None and is_settled(belief) and self._upward.add(geometry, tick, lasted_ns):
            self._recording.send_blueprint(canvas.live_layout(self._upward.eye(self._extent.radius_m)))
        up = self._upward.direction
        drawing = None if geometry is None else draw(geometry, tick, self._extent, up)
        self._is_open = drawing is not None and drawing.is_open
        stamp = np.array([belief.stamp_ns], np.int64)
        sheet.drawings(stamp, [drawing])
        further = [draw(one.geometry, tick, self._extent, up) for one in belief.further]
        gone = [None] * max(sheet.most_further - len(further), 0)
        for number, beside in enumerate([*further, *gone], 1):
            sheet.drawings(stamp, [beside], number)

    def close(self) -> None:
        """Send the remaining data; the viewer stays open."""
        with suppress(ViewerError):  # the user may have closed the window
            close(self._recording, _CLOSE_S)

    def _take(self, until_ns: int) -> Poses | None:
        """The poses up to ``until_ns`` that belong to no earlier belief; None without any."""
        rows = [] if self._last is None else [self._last]
        while self._waiting and self._waiting[0].stamp_ns <= until_ns:
            rows.append(self._waiting.popleft())
        self._last = rows[-1] if rows else None
        return Poses.collect(rows) if rows else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
