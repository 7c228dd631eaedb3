"""Files and arguments that say what the user knows, read into ``knowledge.Knowledge``."""

from contact_tracker.known.loading import knowledge_from, load_knowledge

__all__ = ["knowledge_from", "load_knowledge"]
