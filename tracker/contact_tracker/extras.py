"""Import of libraries of extras; a missing one is reported in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

from contact_tracker.errors import MissingExtra


@contextmanager
def extra(name: str, purpose: str) -> Iterator[None]:
    """A context for imports of libraries of the extra ``name``, needed for ``purpose``.

    Raises
    ------
    MissingExtra
        A library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "a library").partition(".")[0]
        raise MissingExtra(f"{purpose} needs {library}: pip install 'contact-tracker[{name}]'") from None


def module_of_extra(module: str, name: str, purpose: str) -> ModuleType:
    """The ``module`` of a library of the extra ``name``; raises as ``extra`` does."""
    with extra(name, purpose):
        return import_module(module)
