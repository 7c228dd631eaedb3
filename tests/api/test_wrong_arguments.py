"""Whatever is given in the place of an argument is used or refused in one line of the package."""

import math
import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import contact_tracker as ct
from mcap_logs import poses_topic, smooth_poses, write_log

FEW = 60
NO_PATHS = (None, True, 3, b"a", [], {}, "a\0b")
NO_TEXTS = (True, 3, 1j, b"a", [], {}, np.zeros((FEW, 8)), smooth_poses(FEW))
NO_NUMBERS = (True, np.True_, 1j, math.nan, math.inf, -1.0, 10**400, 10**5000, "1", b"1", [], {})
NO_DEVIATIONS = (3, True, (1e-3,), (1j, 1j), (True, True), (math.nan, 1e-3), ("1", "1"), (10**400, 1), "1mm")
NO_ARRAYS: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda values: values.astype(complex),
    lambda values: values > 0,
    lambda values: values.astype(str),
    lambda values: values.astype(complex).astype(object),
    lambda values: (values > 0).astype(object),
    lambda values: values[:, None, None],
    lambda _: [[1, 2, 3], [1]],
    lambda _: None,
)
NO_VECTORS = (None, 3, "text", np.zeros((FEW, 3), complex), np.zeros((FEW, 3), bool), np.zeros((FEW, 2)))
NO_PLACES = (
    None,
    {0: 1.0},
    3,
    "xyz",
    (1, 2),
    (1, 2, 1j),
    np.zeros(3, complex),
    (True, 0, 0),
    [*"123"],
    (9**400, 0, 0),
)
NO_TABLES = (None, True, 3, "text", Path("a"), [], {}, {"a": 1}, {1: [2]}, pd.DataFrame(), smooth_poses(3))
NO_COLUMNS = (None, 3, "text", [[1, 2], [3]], {"a": 1}, Rotation.identity(FEW), smooth_poses(FEW))
NO_ROWS = (None, 3, [], "row" * 1000, np.zeros((2, 2)), pd.DataFrame({"a": [1]}))
NO_NAMES = (True, 3, "x", {"x": 3}, (1, 2, 3, 4), {"x": None})
NO_KNOWLEDGE = (3, b"a", [], {1: 2}, {"up": 3}, {"up": {"direction": [0, 0, 1j]}}, {"up": {1: 2}})


class Given(NamedTuple):
    """Arguments that are right."""

    log: Path
    folder: Path
    stamp_ns: np.ndarray
    position_m: np.ndarray
    quat_xyzw: np.ndarray
    trajectory: ct.Trajectory
    result: ct.Result
    wrenches: ct.Wrenches

    @property
    def table(self) -> dict[str, np.ndarray]:
        names = ("stamp_ns", "x", "y", "z", "qx", "qy", "qz", "qw")
        return dict(zip(names, (self.stamp_ns, *self.position_m.T, *self.quat_xyzw.T), strict=True))

    def parts_of_time(self, nanosec: Any) -> dict[str, Any]:
        return {"sec": np.arange(FEW), "nanosec": nanosec} | {
            k: self.table[k] for k in self.table if k != "stamp_ns"
        }

    @property
    def columns(self) -> dict[str, np.ndarray]:
        return {"stamps": self.stamp_ns, "positions_m": self.position_m, "quaternions": self.quat_xyzw}

    def arrays(self, **changed: Any) -> ct.Trajectory:
        return ct.Trajectory.from_arrays(**self.columns | {"unit": "ns"} | changed)

    def measured(self, **changed: Any) -> ct.Wrenches:
        zeros = np.zeros((FEW, 3))
        return ct.Wrenches(**{"stamp_ns": self.stamp_ns, "force_n": zeros, "moment_nm": zeros} | changed)


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Given:
    folder, poses = tmp_path_factory.mktemp("arguments"), smooth_poses(FEW)
    (folder / "folder.csv").mkdir()
    (folder / "text.mcap").write_text("text")
    trajectory = ct.Trajectory(poses)
    zeros = np.zeros((FEW, 3))
    return Given(
        write_log(folder / "log.mcap", [poses_topic(poses)]),
        folder,
        *(poses.stamp_ns, poses.position_m, poses.quat_xyzw),
        trajectory,
        ct.segment(trajectory),
        ct.Wrenches(poses.stamp_ns, zeros, zeros),
    )


def update(stamp_ns: Any = 1, position_m: Any = (0, 0, 0), quat_xyzw: Any = (0, 0, 0, 1)) -> Any:
    return ct.Tracker().update(stamp_ns, position_m, quat_xyzw)


def beside(*names: str) -> tuple[Callable[[Given], Path], ...]:
    return tuple(lambda given, name=name: given.folder / name for name in names)


OF_MODEL = {"model": NO_PATHS, "known": NO_KNOWLEDGE, "noise": NO_DEVIATIONS, "accuracy": NO_DEVIATIONS}
NO_OUTPUTS = ("", "a.none", "none/a.csv", "none/a.parquet", "none/a.html", "none/a.mcap")
CALLS: dict[str, tuple[Callable[[Given], Callable[..., Any]], dict[str, tuple[Any, ...]]]] = {
    "read": (
        lambda given: lambda path=given.log, **more: ct.read(path, **more),
        {"path": NO_PATHS, **dict.fromkeys(("topic", "child", "relative_to", "unit"), NO_TEXTS)},
    ),
    "read a child": (lambda given: partial(ct.read, given.log, child="a"), {"parent": NO_TEXTS}),
    "from_arrays": (
        lambda given: given.arrays,
        {
            "order": (None, *NO_TEXTS),
            "unit": (None, *NO_TEXTS),
            **{
                name: tuple(lambda given, name=name, of=of: of(given.columns[name]) for of in NO_ARRAYS)
                for name in ("stamps", "positions_m", "quaternions")
            },
        },
    ),
    "from_arrays of other lengths": (
        lambda given: given.arrays,
        {"positions_m": tuple(lambda given, n=n: given.position_m[:n] for n in (0, 1, FEW - 1))},
    ),
    "from_dataframe": (
        lambda given: lambda table=given.table, **more: ct.Trajectory.from_dataframe(table, **more),
        {
            "table": NO_TABLES,
            "unit": NO_TEXTS,
            "columns": NO_NAMES,
        },
    ),
    "from_dataframe of other lengths": (
        lambda given: lambda y: ct.Trajectory.from_dataframe({**given.table, "y": y}),
        {"y": (np.zeros(3), np.zeros((FEW, 3)), np.array(0.0), np.zeros(FEW, "M8[s]"), *NO_COLUMNS)},
    ),
    "from_dataframe of seconds and nanoseconds": (
        lambda given: lambda nanosec: ct.Trajectory.from_dataframe(given.parts_of_time(nanosec)),
        {"nanosec": (np.zeros(3), np.full(FEW, "text"), np.zeros(FEW, complex), [None] * FEW, *NO_COLUMNS)},
    ),
    "Trajectory": (lambda _: ct.Trajectory, {"poses": (None, 3, "text", [], [1, 2])}),
    "segment": (
        lambda given: lambda trajectory=given.trajectory, **more: ct.segment(trajectory, **more),
        {
            "trajectory": (True, 1j, Rotation.identity(FEW), np.zeros((FEW, 7)), iter([1]), *NO_TABLES),
            **OF_MODEL,
            "progress": (3, "print", []),
        },
    ),
    "segment with a topic": (
        lambda given: partial(ct.segment, given.log),
        {"wrench": (True, 3, b"a", [], "/none")},
    ),
    "Tracker": (lambda _: ct.Tracker, {**OF_MODEL, "lag_s": (*NO_NUMBERS, None, 1e3)}),
    "Tracker of some states": (lambda _: ct.Tracker, {"states": (["f-x"], [])}),
    "Tracker.update": (
        lambda _: update,
        {
            "stamp_ns": (None, True, np.True_, 1.5, 1j, "1", [1]),
            "position_m": NO_PLACES,
            "quat_xyzw": (None, 3, (0, 0, 1), (0, 0, 0, 1j), "0001"),
        },
    ),
    "Tracker.load": (
        lambda _: ct.Tracker.load,
        {"path": (*NO_PATHS, *beside("none", "folder.csv", "text.mcap", "log.mcap/a"))},
    ),
    "Tracker.save": (
        lambda _: ct.Tracker().save,
        {"path": (*NO_PATHS, *beside("none/a", "folder.csv", "log.mcap/a"))},
    ),
    "compare": (lambda given: partial(ct.compare, given.result), {"second": (None, 3, b"a", [])}),
    "evaluate": (
        lambda given: lambda result=given.result, labels=given.log: ct.evaluate(result, labels),
        {"result": (None, 3, "a", []), "labels": (*NO_PATHS, "none.csv", *NO_TABLES[-2:])},
    ),
    "evaluate with meanings": (
        lambda given: partial(ct.evaluate, given.result, {"start": [0.0], "end": [0.1], "contact": ["a"]}),
        {"meanings": (3, "a", [1], {"a": 1}, {1: "any"}, np.zeros(3), pd.DataFrame({"a": ["any"]}))},
    ),
    "plot": (
        lambda given: given.result.plot,
        {"ax": (True, 3, "text", []), "labels": (True, 3, b"a", "none.csv")},
    ),
    "PlanFollower": (lambda _: ct.PlanFollower, {"plan": (None, 3, "plan.toml", [])}),
    "PlanFollower.update": (
        lambda given: ct.PlanFollower(given.result.plan).update,
        {"belief": (None, 3, "f-f", [])},
    ),
    "Plan.read": (lambda _: ct.Plan.read, {"path": (*NO_PATHS, "none.toml")}),
    "Map.load": (lambda _: ct.Map.load, {"path": (*NO_PATHS, "none.toml")}),
    "Result.load": (lambda _: ct.Result.load, {"path": (*NO_PATHS, "none.contacts")}),
    "Wrenches": (
        lambda given: given.measured,
        {
            "stamp_ns": (None, 3, "text", np.zeros(FEW), np.zeros(FEW, bool), np.zeros(3, int)),
            **dict.fromkeys(("force_n", "moment_nm"), NO_VECTORS),
        },
    ),
    **{
        name: (
            lambda given, name=name: getattr(given.result, name),
            {"path": (*NO_PATHS, *NO_OUTPUTS, *beside("folder.csv", "log.mcap/a.csv"))},
        )
        for name in ("save", "to_parquet", "to_html", "to_mcap")
    },
    "to_pandas": (lambda given: given.result.to_pandas, {"rows": NO_ROWS}),
    "to_arrow": (lambda given: given.result.to_arrow, {"rows": NO_ROWS}),
}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda given: ct.segment(given.table, unit="mm"), r"from_dataframe\(table, unit='mm'\)\)$"),
        (lambda given: ct.segment(given.log, topic="/a"), r"contact_tracker.read\(path, topic=./a.\)"),
        (lambda given: ct.segment(given.log, nois=1), "segment has no argument nois; did you mean noise?"),
        (lambda given: ct.read(given.log, frame="a"), "read has no argument frame; did you mean child?"),
        (lambda given: given.arrays(units="mm"), "did you mean unit?"),
        (lambda given: ct.Tracker(unit="mm"), "Tracker has no argument unit; there are model"),
        (
            lambda given: ct.Tracker().update(1, position=(0, 0, 0), quat_xyzw=(0, 0, 0, 1)),
            "Tracker.update has no argument position; did you mean position_m?",
        ),
        (lambda given: given.result.at(tim=1.0), "Result.at has no argument tim; did you mean time?"),
        (lambda given: given.result.to_pandas(row="ticks"), "argument row; did you mean rows?"),
        (lambda given: ct.Tracker.load(pat="a"), "Tracker.load has no argument pat; did you mean path?"),
        (lambda given: ct.Tracker().finish(now=1), "Tracker.finish has no argument now; there are none"),
        (lambda given: ct.evaluate(given.result, {}, map={}), "no argument map; did you mean meanings"),
    ],
)  # fmt: skip
def test_an_unknown_argument_is_named(given: Given, call: Callable[[Given], Any], message: str) -> None:
    with pytest.raises(TypeError, match=message) as raised:
        call(given)
    assert isinstance(raised.value, ct.ContactTrackerError)


@pytest.mark.parametrize(
    ("head", "message", "how"),
    [
        ("t,x,y,z,roll,pitch,yaw", "three angles", {}),
        ("t,cup_x,cup_y,cup_z,cup_rx,cup_ry,cup_rz", "angles or a rotation vector", {"child": "cup"}),
        ("frame,x,y,z,rvec_x,rvec_y,rvec_z", "with the rate of your poses", {}),
        ("unix_time,x,y,z,rvec_x,rvec_y,rvec_z", "'unix_time'", {}),
    ],
)
def test_a_refusal_proposes_the_call(tmp_path: Path, head: str, message: str, how: dict[str, str]) -> None:
    path = tmp_path / "it's {a} file.csv"
    rows = np.c_[np.arange(FEW), np.ones((FEW, 3)), np.linspace(0.0, 0.5, FEW), np.zeros((FEW, 2))]
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    with pytest.raises(ct.ContactTrackerError, match=message) as raised:
        ct.segment(ct.read(path, **how)) if how else ct.segment(path)
    assert not re.search("--|contact-tracker", str(raised.value))
    calls = re.findall(r"contact_tracker\.read\(.*?\)(?= or |, with|\. Orders|$)", str(raised.value))
    assert len(eval(calls[0], {"contact_tracker": ct})) == FEW


@pytest.mark.parametrize(("name", "argument"), [(name, one) for name in CALLS for one in CALLS[name][1]])
def test_a_wrong_argument_is_an_error_of_the_package(name, argument, given) -> None:
    call, values = CALLS[name]
    for value in values[argument]:
        wrong = value(given) if callable(value) else value
        with pytest.raises(ct.ContactTrackerError) as error:
            call(given)(**{argument: wrong})
        assert str(error.value), value
        assert "\n" not in str(error.value), value
        assert len(str(error.value)) < 600, value


def test_numbers_of_other_libraries_are_numbers(given) -> None:
    ct.Tracker(lag_s=Fraction(1, 2), noise=(np.float32(3e-4), Decimal("0.003")))
    update(position_m=np.zeros(3, np.float32))
    update(np.int32(7))
    objects = given.position_m.astype(object)
    objects[3] = None
    assert given.arrays(positions_m=objects).counts == {"nonfinite": 1}
