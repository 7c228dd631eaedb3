"""Model parameters: typed, validated on load, one TOML file per kind of sensor (docs/models.md)."""

import tomllib
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any, Final

from contact_tracker.errors import ModelError


@dataclass(frozen=True)
class Noise:
    """Standard deviations of one pose; they start the estimate, which then follows the stream itself."""

    sigma_position_m: float
    sigma_rotation_rad: float
    floor_position_m: float
    """Deviation of real contacts from ideal geometry, which no averaging removes."""
    floor_rotation_rad: float
    outlier_sigmas: float


@dataclass(frozen=True)
class Motion:
    """Yardstick of free motion."""

    memory_s: float
    """Time over which the strength of the motion is averaged."""
    body_radius_m: float
    """Lever with which free rotation moves a point of the object."""


@dataclass(frozen=True)
class Geometry:
    """Scales of the weak priors."""

    reach_m: float
    """Distance of touching points from the body's origin."""


@dataclass(frozen=True)
class Transitions:
    """Rates of change between the states, per second."""

    leave_per_s: float
    """How often a contact ends."""
    skip: float
    """Weight of a change that skips constraints, relative to one that gains or loses one."""
    initial_f_f: float
    """Probability that the recording starts in f-f: things lie on faces."""


@dataclass(frozen=True)
class Search:
    """What is kept of the hypotheses."""

    window_s: float
    """Poses older than this are summed up, not looked at again."""
    margin_nats: float
    """Hypotheses this much worse than the best are dropped."""


@dataclass(frozen=True)
class Model:
    """All parameters of the tracker."""

    name: str
    tick_s: float
    noise: Noise
    motion: Motion
    geometry: Geometry
    transitions: Transitions
    search: Search


_UNIT_INTERVAL: Final = {"skip", "initial_f_f"}


def load_model(name_or_path: str = "default") -> Model:
    """Load a shipped preset by name or a TOML file by path.

    Raises
    ------
    ModelError : names the key and the reason.
    """
    text = _read(name_or_path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ModelError(name_or_path, f"not TOML: {error}") from error
    model: Model = _build(Model, table, "")
    return model


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(p.name.removesuffix(".toml") for p in _presets().iterdir() if p.name.endswith(".toml"))


def _presets() -> Any:
    packaged = resources.files("contact_tracker") / "models"
    if packaged.is_dir():
        return packaged
    return Path(__file__).parents[2] / "models"  # a checkout: the presets stand at its top level


def _read(name_or_path: str) -> str:
    path = Path(name_or_path)
    if name_or_path in preset_names():
        text: str = (_presets() / f"{name_or_path}.toml").read_text()
        return text
    if not path.is_file():
        raise ModelError(
            "--model", f"{name_or_path!r} is neither a file nor one of {', '.join(preset_names())}"
        )
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError("--model", f"cannot read {name_or_path}: {error}") from error


def _build(kind: Any, table: Any, prefix: str) -> Any:
    """A frozen value of type ``kind`` from a TOML table, every key checked."""
    if not isinstance(table, dict):
        raise ModelError(prefix or "model", "must be a table")
    known = {f.name: f.type for f in fields(kind)}
    for key in table:
        if key not in known:
            raise ModelError(f"{prefix}{key}", f"unknown; known are {', '.join(known)}")
    values = {}
    for key, wanted in known.items():
        if key not in table:
            raise ModelError(f"{prefix}{key}", "missing")
        values[key] = _value(wanted, table[key], f"{prefix}{key}")
    return kind(**values)


def _value(wanted: Any, value: Any, key: str) -> Any:
    if wanted is str:
        if not isinstance(value, str):
            raise ModelError(key, f"must be a string, not {value!r}")
        return value
    if wanted is not float:
        return _build(wanted, value, f"{key}.")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ModelError(key, f"must be a number, not {value!r}")
    limit = 1.0 if key.rpartition(".")[2] in _UNIT_INTERVAL else float("inf")
    if not 0.0 < value < limit:
        raise ModelError(key, f"must lie between 0 and {limit:g}, not {value!r}")
    return float(value)
