"""The recordings that a command reads one by one, from the files and folders that the user names."""

from pathlib import Path

from contact_tracker.errors import UnreadableRecording, UsageError


def recordings(logs: list[str], command: str) -> list[str]:
    """Files as given, folders replaced by the recordings in them; each once."""
    names: dict[str, None] = {}
    for log in logs:
        if log == "-":
            raise UsageError(f"{command} reads a recording twice: name a file, not -")
        if not Path(log).is_dir():
            names[log] = None
            continue
        inside = sorted(str(path) for path in Path(log).rglob("*") if path.suffix.lower() == ".mcap")
        if not inside:
            raise UnreadableRecording(f"{log}: this folder holds no .mcap file")
        names.update(dict.fromkeys(inside))
    return list(names)
