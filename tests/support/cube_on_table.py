"""A cube and a table that are known."""

from contact_tracker.map.file import map_from

ACCURACY = {"sigma_position_m": 1e-4, "sigma_rotation_deg": 0.05}
CUBE_M = 0.2
TABLE = {"normal": [0, 0, 1], "offset_m": 0.0, "name": "table", **ACCURACY}
CUBE_ON_TABLE = map_from(
    {
        "environment": {"plane": [TABLE], "complete": True},
        "object": {"box": {"size_m": [CUBE_M] * 3, **ACCURACY}},
    }
)
