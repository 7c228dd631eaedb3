"""The requirements of pyproject.toml agree with the oldest and latest releases that CI installs."""

import re
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="a source distribution has no CI")


def required() -> list[Requirement]:
    """All requirements except the package itself, which is in one of its extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"].values()
    texts = [*project["build-system"]["requires"], *project["project"]["dependencies"], *chain(*extras)]
    return [one for text in texts if (one := Requirement(text)).name != "contact-tracker"]


def locked(name: str) -> dict[str, set[Version]]:
    """Releases by the name of the package; several where systems or Pythons differ."""
    found: dict[str, set[Version]] = {}
    text = (ROOT / ".ci" / f"locked-{name}.txt").read_text(encoding="utf-8")
    for package, version in re.findall(r"^([\w.-]+)==([\w.]+)", text, re.MULTILINE):
        found.setdefault(canonicalize_name(package), set()).add(Version(version))
    return found


def test_the_oldest_releases_are_the_lower_bounds() -> None:
    releases = locked("oldest")
    for requirement in required():
        (lower,) = [Version(s.version) for s in requirement.specifier if s.operator == ">="]
        # the next release, if there is none of that number
        oldest = min(v for v in releases[canonicalize_name(requirement.name)] if v >= lower)
        assert oldest.release[: len(lower.release)] == lower.release, requirement


def test_the_latest_releases_are_admitted() -> None:
    releases = locked("latest")
    for requirement in required():
        for version in releases[canonicalize_name(requirement.name)]:
            assert requirement.specifier.contains(version), requirement


@pytest.mark.parametrize("name", ["oldest", "latest"])
def test_every_release_has_hashes(name: str) -> None:
    text = (ROOT / ".ci" / f"locked-{name}.txt").read_text(encoding="utf-8")
    entries = re.split(r"\n(?=\S)", text.strip())
    assert entries.pop(0).startswith("#")
    assert len(entries) > 30
    assert all("--hash=sha256:" in entry for entry in entries)
    assert "://" not in text
