"""Which beliefs of a stream are worth a line: a contact that is new, and one that has become settled."""

from contact_tracker.outputs.text import is_settled
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief


class Changes:
    """What was told last: ``label``, and whether as ``settled``."""

    def __init__(self) -> None:
        self.label: Contact | None = None
        self.settled = False

    def takes(self, belief: Belief) -> bool:
        """Whether the next belief is worth a line; it is the last one from then on."""
        changed, settles = belief.contact is not self.label, is_settled(belief)
        is_news = changed or (settles and not self.settled)
        self.label, self.settled = belief.contact, settles or (self.settled and not changed)
        return is_news
