"""Reading prior knowledge from files and arguments into ``prior_map.PriorMap``."""

from contact_tracker.prior_map_files.loading import knowledge_from, load_knowledge

__all__ = ["knowledge_from", "load_knowledge"]
