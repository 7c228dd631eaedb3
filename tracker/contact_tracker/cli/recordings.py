"""The recordings of a command, from files and folders given by the user."""

from contact_tracker.errors import UsageError


def recordings(logs: list[str], command: str) -> list[str]:
    """Files as given, folders replaced by the recordings in them; each once."""
    from contact_tracker.batch.finding import recordings_in

    if "-" in logs:
        raise UsageError(f"{command} reads a recording twice: name a file, not -")
    return list(dict.fromkeys(name for log in logs for name in recordings_in(log)))
