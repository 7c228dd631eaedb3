"""Parameters of the tracker and their TOML files; folder and names of the shipped files."""

from pathlib import Path


def shipped() -> Path:
    """The folder of the presets."""
    packaged = Path(__file__).parents[1] / "models"
    if packaged.is_dir():
        return packaged
    return Path(__file__).parents[3] / "models"  # a checkout: the presets are at its top level


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(preset.stem for preset in shipped().iterdir() if preset.suffix == ".toml")
