"""Model files: complete, or refused with key and reason."""

import os
import time
import tomllib
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path

import pytest

from contact_tracker.config import preset_names
from contact_tracker.config.loading import MAY_BE_ZERO, load_model
from contact_tracker.config.parameters import Model
from contact_tracker.errors import ModelError, UsageError
from contact_tracker_lab.calibration.parameters import model_text

MODELS = Path(__file__).resolve().parents[2] / "models"
DEFAULT = tomllib.loads((MODELS / "default.toml").read_text(encoding="utf-8"))


MAY_BE_LEFT_OUT = {
    (None, "poses_per_tick"),
    ("motion", "initial_autocorrelation"),
    *(("systematic", key) for key in ("position_m", "rotation_rad", "length_m", "angle_rad")),
    *(("noise", key) for key in ("wander_position_m", "wander_rotation_rad", "wander_s", "estimate_share")),
}


def toml(table, prefix=""):
    """The table as TOML, sections last."""
    rows = [f"{k} = {_toml_value(v)}" for k, v in table.items() if not isinstance(v, dict)]
    for key, value in table.items():
        if isinstance(value, dict):
            rows += [f"[{prefix}{key}]", toml(value, f"{prefix}{key}.")]
    return "\n".join(rows)


def _toml_value(value):
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def numbers(kind=Model, prefix=""):
    """Names (section, key) of all numbers of the model."""
    rows = []
    for field in fields(kind):
        if is_dataclass(field.type):
            rows += [(field.name, f.name) for f in fields(field.type) if f.type is float]
        elif field.type is float:
            rows.append((None, field.name))
    return rows


def changed(section, key, value):
    """The default model's table with one value changed, or taken away (None)."""
    table = {k: dict(v) if isinstance(v, dict) else v for k, v in DEFAULT.items()}
    inner = table if section is None else table.setdefault(section, {})
    inner.pop(key, None)
    if value is not None:
        inner[key] = value
    return table


def loaded(tmp_path, text):
    """The model in a file with this text."""
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    return load_model(str(path))


def refused(tmp_path, text):
    """The error that a file with this text raises."""
    with pytest.raises(ModelError) as caught:
        loaded(tmp_path, text)
    assert isinstance(caught.value, UsageError)
    assert "\n" not in str(caught.value)
    assert caught.value.key in str(caught.value)
    assert caught.value.reason in str(caught.value)
    return caught.value


EVERYWHERE = [
    (True, "must be a number, not bool"),
    ([1.0], "must be a number, not list"),
    (float("inf"), "must be more than"),
    (10**400, "must be more than"),
]
"""As one check sees all numbers, tried with one of them."""
each_number = pytest.mark.parametrize(
    ("section", "key"), numbers(), ids=[".".join(filter(None, row)) for row in numbers()]
)


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_are_called_what_they_are(name):
    model = load_model(name)
    assert model.name == name
    assert model.search.window_s > model.tick_s > 0.0
    assert hash(model) == hash(load_model(name))


@pytest.mark.parametrize("name", sorted({*preset_names()} - {"impacts"}))
def test_presets_differ_in_what_their_sensors_differ_in(name):
    """All other values are those of the default."""
    sensor = {"sigma_position_m", "sigma_rotation_rad"}
    preset, default = asdict(load_model(name)), asdict(load_model())
    for table in (preset, default):
        table.pop("name")
        table["noise"] = {k: v for k, v in table["noise"].items() if k not in sensor}
    assert preset == default


SEEN = {"begins": {"free": 2.0}, "moving_s": {"f-f": 3.5}, "changes": {"f-f": {"e-f": 1.5}, "free": {}}}


def with_seen(table):
    return toml(DEFAULT | {"transitions": DEFAULT["transitions"] | {"counts": table}})


def test_missing_entries_in_a_table_of_contacts_are_zero(tmp_path):
    seen = loaded(tmp_path, with_seen(SEEN)).transitions.counts
    assert seen.begins == (0.0,) * 6 + (2.0,)
    assert seen.moving_s == (3.5, *(0.0,) * 6)
    assert seen.changes[0] == (0.0, 1.5, *(0.0,) * 5)
    assert seen.changes[1:] == ((0.0,) * 7,) * 6


CONTACTS_TABLES = [
    ({"begins": {"f-g": 1.0}}, "begins.f-g", "did you mean f-"),
    ({"begins": {"f-f": -1.0}}, "begins.f-f", "zero or more"),
    ({"begins": {"f-f": float("nan")}}, "begins.f-f", "zero or more"),
    ({"begins": 3.0}, "begins", "table"),
    ({"moving_s": {"free": "long"}}, "moving_s.free", "number"),
    ({"moving_s": {"free": 10**400}}, "moving_s.free", "zero or more"),
    ({"changes": {"f-f": 1.0}}, "changes.f-f", "table"),
    ({"changes": {"f-f": {"up": 1.0}}}, "changes.f-f.up", "known are f-f"),
    ({"changes": {"free": {"free": 1.0}}}, "changes.free.free", "into itself"),
    ({"change": {}}, "change", "unknown"),
]
CHANGES = [
    (("search", "window_s", 0.01), "tick"),  # the window would be empty, or never end
    (("noise", "sigma_posision_m", 1.0), "sigma_position_m"),
    (("noise", "estimated", 1.0), ""),
    (("transitions", "skip", 1.5), ""),
    (("transitions", "initial_f_f", 1.0), ""),
    ((None, "tick_s", 1e-9), ""),
    ((None, "tick_s", 1e6), ""),
    ((None, "name", 7), ""),
    (("geometry", "reach_m", 1e-200), ""),
    (("geometry", "reach_m", 1e5), ""),  # a fit that far off is singular
    (("motion", "prior_predictive_share", 1.5), ""),
    (("noise", "floor_position_m", 1e-200), ""),
]
SECTIONS = [key for key, value in DEFAULT.items() if isinstance(value, dict)]
WRONG = [
    *(
        (with_seen(SEEN | table), f"transitions.counts.{key}", reason)
        for table, key, reason in CONTACTS_TABLES
    ),
    *(
        (with_seen({k: v for k, v in SEEN.items() if k != one}), f"transitions.counts.{one}", "missing")
        for one in SEEN
    ),
    *((toml(changed(*one)), ".".join(filter(None, one[:2])), reason) for one, reason in CHANGES),
    *((toml({k: v for k, v in DEFAULT.items() if k != one}), one, "missing") for one in SECTIONS),
    *((toml({one: 3.0} | {k: v for k, v in DEFAULT.items() if k != one}), one, "table") for one in SECTIONS),
    (toml(DEFAULT | {"extra": {"a": 1.0}}), "extra", "unknown"),
    (
        toml(changed("noise", "contact_rotation_rad", {"free": 0.001})),
        "noise.contact_rotation_rad.free",
        "free",
    ),
]


@pytest.mark.parametrize(("text", "key", "reason"), WRONG, ids=[f"{key}: {why}" for _, key, why in WRONG])
def test_what_is_wrong_is_named_with_its_reason(tmp_path, text, key, reason):
    error = refused(tmp_path, text)
    assert error.key == key or (reason == "table" and error.key.startswith(key))
    assert reason in str(error)


@each_number
def test_each_number_is_needed_typed_and_in_range(tmp_path, section, key):
    name = key if section is None else f"{section}.{key}"
    needed = [(None, "missing")] if (section, key) not in MAY_BE_LEFT_OUT else []
    for value, reason in (
        *needed,
        ("fast", "must be a number, not str"),
        *([] if name in MAY_BE_ZERO else [(0.0, "must be more than")]),
        (-1.0, "must be more than"),
        (float("nan"), "must be more than"),
        *(EVERYWHERE if key == "tick_s" else []),
    ):
        error = refused(tmp_path, toml(changed(section, key, value)))
        assert error.key == name
        assert reason in error.reason


@pytest.mark.parametrize(
    "text",
    ["tick_s = ", "[noise", "name = 'a'\nname = 'b'", f"tick_s = {'9' * 5000}", f"a = {'[' * 5000}"],
    ids=["no value", "open table", "twice", "endless number", "endless nesting"],
)
def test_what_is_not_toml_is_refused_with_the_file(tmp_path, text):
    assert "model.toml" in str(refused(tmp_path, text))


@pytest.mark.parametrize("name", ["no_such_model", "", ".", "no/such/model.toml", "x" * 5000, "a\0b"])
def test_what_is_neither_preset_nor_file_is_refused_with_the_presets(name):
    with pytest.raises(ModelError, match="default"):
        load_model(name)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(ModelError, match=r"binary\.toml"):
        load_model(str(binary))
    with pytest.raises(ModelError):
        load_model(str(tmp_path))
    if os.geteuid() != 0:
        binary.chmod(0)
        with pytest.raises(ModelError, match=r"binary\.toml"):
            load_model(str(binary))


def with_errors(**tables):
    return replace(load_model(), noise=replace(load_model().noise, **tables))


def test_errors_of_contacts_may_be_left_out_and_are_read_again(tmp_path):
    loose = loaded(tmp_path, toml(changed("noise", "contact_position_m", {"v-f": 0.001})))
    assert loose == with_errors(contact_position_m=(0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0))
    assert loaded(tmp_path, model_text(loose)) == loose


def test_optional_keys_have_defaults(tmp_path):
    model = loaded(tmp_path, toml(changed(None, "poses_per_tick", None)))
    assert (model.poses_per_tick, model.noise.estimated) == (1.5, True)
    given = loaded(tmp_path, toml(changed("noise", "estimated", False)))
    assert given.noise == load_model().with_noise(0.5e-3, 4e-3).noise
    assert loaded(tmp_path, model_text(given)) == given


ENDLESS = ("a" + ".a" * 20_000, "['a'" + " . a" * 20_000 + "]", "x = {a" + '."a"' * 20_000)
FILLINGS = ("\n", "{", "'", "a.", ",a", '{"')


@pytest.mark.parametrize(
    ("text", "reason", "most_s"),
    [
        *((f"{key} = 1\n", "parts", 2.0) for key in ENDLESS),  # the parser would take minutes
        *(
            ("x = 1 # " + "." * 100 + "\n!" + filling * (900_000 // len(filling)), "", 5.0)
            for filling in FILLINGS  # in quadratic time the search for such keys would take hours
        ),
    ],
    ids=[*(f"key {k}" for k in range(len(ENDLESS))), *map(repr, FILLINGS)],
)
def test_keys_of_endless_parts_are_refused_in_linear_time(tmp_path, text, reason, most_s):
    begin_s = time.process_time()
    assert reason in str(refused(tmp_path, text))
    assert time.process_time() - begin_s < most_s
