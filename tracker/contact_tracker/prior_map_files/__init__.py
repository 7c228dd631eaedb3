"""Files and arguments that say what the user knows, read into ``prior_map.PriorMap``."""

from contact_tracker.prior_map_files.loading import knowledge_from, load_knowledge

__all__ = ["knowledge_from", "load_knowledge"]
