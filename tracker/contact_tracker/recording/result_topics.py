"""The topics of a result that is written beside a recording (docs/conventions.md)."""

from typing import Final

BELIEF_TOPIC: Final = "/contact/belief"
FRAMES_TOPIC: Final = "/contact/frames"
SCENE_TOPIC: Final = "/contact/scene"
RESULT_TOPICS: Final = frozenset({BELIEF_TOPIC, FRAMES_TOPIC, SCENE_TOPIC})
