"""Whatever is given in the place of an argument is used or refused in one line of the package."""

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import contact_tracker as ct
from mcap_logs import poses_topic, smooth_poses, write_log

FEW = 60
NO_PATHS = (None, True, 3, b"a", [], {}, "a\0b")
NO_TEXTS = (True, 3, 1j, b"a", [], {})
NO_NUMBERS = (True, np.True_, 1j, math.nan, math.inf, -1.0, 10**400, "1", b"1", [], {})
NO_DEVIATIONS = (3, True, (1e-3,), (1j, 1j), (True, True), (math.nan, 1e-3), ("1", "1"), (10**400, 1), "1mm")
NO_TABLES = (None, True, 3, "text", Path("a"), [])
NO_NAMES = (True, 3, "x", {}, (1, 2, 3, 4), ("x", "y", "z", None))
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

    def arrays(self, **changed: Any) -> ct.Trajectory:
        columns = {"stamps": self.stamp_ns, "positions_m": self.position_m, "quaternions": self.quat_xyzw}
        return ct.Trajectory.from_arrays(**columns | {"unit": "ns"} | changed)

    def measured(self, **changed: Any) -> ct.Wrenches:
        zeros = np.zeros((FEW, 3))
        return ct.Wrenches(**{"stamp_ns": self.stamp_ns, "force_n": zeros, "moment_nm": zeros} | changed)


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Given:
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


def update(place: int, value: Any) -> Any:
    pose: list[Any] = [1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
    pose[place] = value
    return ct.Tracker().update(*pose)


def in_arrays(name: str, of: Callable[[Given], np.ndarray]) -> dict[str, Callable[[Given], Any]]:
    """One array of the wrong kind."""
    kinds = {
        "complex": lambda given: of(given).astype(complex),
        "bool": lambda given: of(given) > 0,
        "text": lambda given: of(given).astype(str),
        "complex objects": lambda given: of(given).astype(complex).astype(object),
        "bool objects": lambda given: (of(given) > 0).astype(object),
        "ragged": lambda given: [[1, 2, 3], [1]],
        "nothing": lambda given: None,
        "of another shape": lambda given: of(given)[:, None, None],
    }
    return {
        f"from_arrays({name}: {kind})": lambda given, make=make: given.arrays(**{name: make(given)})
        for kind, make in kinds.items()
    }


CALLS: dict[str, tuple[Callable[[Given, Any], Any], tuple[Any, ...]]] = {
    "read(path)": (lambda _, value: ct.read(value), NO_PATHS),
    **{
        f"read({name})": (lambda given, value, name=name: ct.read(given.log, **{name: value}), NO_TEXTS)
        for name in ("topic", "child", "relative_to", "unit")
    },
    "read(parent)": (lambda given, value: ct.read(given.log, parent=value, child="a"), NO_TEXTS),
    "from_arrays(order)": (lambda given, value: given.arrays(order=value), (None, *NO_TEXTS)),
    "from_arrays(unit)": (lambda given, value: given.arrays(unit=value), (None, *NO_TEXTS)),
    "from_arrays(lengths)": (
        lambda given, value: given.arrays(positions_m=given.position_m[:value]),
        (0, 1, FEW - 1),
    ),
    "from_dataframe(table)": (lambda _, value: ct.Trajectory.from_dataframe(value), NO_TABLES),
    **{
        f"from_dataframe({name})": (
            lambda given, value, name=name: ct.Trajectory.from_dataframe(given.table, **{name: value}),
            values,
        )
        for names, values in ((("stamp", "unit"), NO_TEXTS), (("position_m", "quat_xyzw"), NO_NAMES))
        for name in names
    },
    "from_dataframe(lengths)": (
        lambda given, value: ct.Trajectory.from_dataframe({**given.table, "y": value}),
        (np.zeros(3), np.zeros((FEW, 3)), np.array(0.0)),
    ),
    "Trajectory(poses)": (lambda _, value: ct.Trajectory(value), (None, 3, "text", [], [1, 2])),
    "segment(trajectory)": (lambda _, value: ct.segment(value), (None, True, 3, b"a", [], 1j)),
    **{
        f"{name}({argument})": (
            lambda given, value, call=call, argument=argument: call(given, **{argument: value}),
            values,
        )
        for name, call in (
            ("segment", lambda given, **options: ct.segment(given.trajectory, **options)),
            ("Tracker", lambda _, **options: ct.Tracker(**options)),
        )
        for argument, values in (
            ("model", NO_PATHS),
            ("known", NO_KNOWLEDGE),
            ("noise", NO_DEVIATIONS),
            ("accuracy", NO_DEVIATIONS),
        )
    },
    "segment(wrench)": (
        lambda given, value: ct.segment(given.log, wrench=value),
        (True, 3, b"a", [], "/none"),
    ),
    "segment(mass_kg)": (
        lambda given, value: ct.segment(given.trajectory, wrench=given.wrenches, mass_kg=value),
        (*NO_NUMBERS, 0.0),
    ),
    "segment(mass_kg without wrench)": (
        lambda given, value: ct.segment(given.trajectory, mass_kg=value),
        (1.0,),
    ),
    "segment(progress)": (
        lambda given, value: ct.segment(given.trajectory, progress=value),
        (3, "print", []),
    ),
    "compare(second)": (lambda given, value: ct.compare(given.result, value), (None, 3, b"a", [])),
    "evaluate(labels)": (lambda given, value: ct.evaluate(given.result, value), (*NO_PATHS, "none.csv")),
    "evaluate(result)": (lambda given, value: ct.evaluate(value, given.log), (None, 3, "a", [])),
    "plot(ax)": (lambda given, value: given.result.plot(ax=value), (True, 3, "text", [])),
    "plot(labels)": (lambda given, value: given.result.plot(labels=value), (True, 3, b"a", "none.csv")),
    "PlanFollower(plan)": (lambda _, value: ct.PlanFollower(value), (None, 3, "plan.toml", [])),
    "PlanFollower.update(belief)": (
        lambda given, value: ct.PlanFollower(given.result.plan).update(value),
        (None, 3, "f-f", []),
    ),
    "Plan.read(path)": (lambda _, value: ct.Plan.read(value), (*NO_PATHS, "none.toml")),
    "Map.load(path)": (lambda _, value: ct.Map.load(value), (*NO_PATHS, "none.toml")),
    "Result.load(path)": (lambda _, value: ct.Result.load(value), (*NO_PATHS, "none.contacts")),
    "Tracker(lag_s)": (lambda _, value: ct.Tracker(lag_s=value), (*NO_NUMBERS, None, 1e3)),
    "update(stamp_ns)": (lambda _, value: update(0, value), (None, True, np.True_, 1.5, 1j, "1", [1])),
    "update(position_m)": (
        lambda _, value: update(1, value),
        (
            None,
            3,
            "xyz",
            (1, 2),
            (1, 2, 1j),
            np.zeros(3, complex),
            (True, 0, 0),
            ("1", "2", "3"),
            (10**400, 0, 0),
        ),
    ),
    "update(quat_xyzw)": (lambda _, value: update(2, value), (None, 3, (0, 0, 1), (0, 0, 0, 1j), "0001")),
    "Wrenches(stamp_ns)": (
        lambda given, value: given.measured(stamp_ns=value),
        (None, 3, "text", np.zeros(FEW), np.zeros(FEW, bool), np.zeros(3, int)),
    ),
    **{
        f"Wrenches({name})": (
            lambda given, value, name=name: given.measured(**{name: value}),
            (None, 3, "text", np.zeros((FEW, 3), complex), np.zeros((FEW, 3), bool), np.zeros((FEW, 2))),
        )
        for name in ("force_n", "moment_nm")
    },
    **{
        f"{name}(path)": (
            lambda given, value, name=name: getattr(given.result, name)(value),
            (*NO_PATHS, "", "a.none", "none/a.csv", "none/a.parquet", "none/a.html", "none/a.mcap"),
        )
        for name in ("save", "to_parquet", "to_html", "to_mcap")
    },
    "save(a folder)": (
        lambda given, value: given.result.save(given.folder / value),
        ("folder.csv", "log.mcap/a.csv"),
    ),
    **{
        f"{name}(rows)": (lambda given, value, name=name: getattr(given.result, name)(value), (None, 3, []))
        for name in ("to_pandas", "to_arrow")
    },
    "Tracker.load(path)": (
        lambda given, value: ct.Tracker.load(given.folder / value if isinstance(value, str) else value),
        (*NO_PATHS, "none", "folder.csv", "text.mcap", "log.mcap/a"),
    ),
    "Tracker.save(path)": (
        lambda given, value: ct.Tracker().save(given.folder / value if isinstance(value, str) else value),
        (*NO_PATHS, "none/a", "folder.csv", "log.mcap/a"),
    ),
}
ARRAYS = (
    in_arrays("stamps", lambda given: given.stamp_ns)
    | in_arrays("positions_m", lambda given: given.position_m)
    | in_arrays("quaternions", lambda given: given.quat_xyzw)
)


def faults(call: Callable[..., Any], *arguments: Any) -> Iterator[str]:
    """One line if the call is not refused as it has to be."""
    try:
        call(*arguments)
    except ct.ContactTrackerError as error:
        if "\n" in str(error) or not str(error):
            yield f"more than one line: {error}"
    except Exception as error:
        yield f"{type(error).__name__}: {error}"
    else:
        yield "accepted"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda given: ct.segment(given.table, unit="mm"), r"from_dataframe\(table, unit='mm'\)\)$"),
        (lambda given: ct.segment(given.log, topic="/a"), r"contact_tracker.read\(path, topic=./a.\)"),
        (lambda given: ct.segment(given.log, nois=1), "segment has no argument nois; did you mean noise?"),
        (lambda given: ct.read(given.log, frame="a"), "read has no argument frame; did you mean child?"),
        (lambda given: given.arrays(units="mm"), "did you mean unit?"),
        (lambda given: ct.Tracker(unit="mm"), "Tracker has no argument unit; there are model"),
        (lambda given: ct.evaluate(given.result, {}, map={}), "evaluate has no argument map; there are"),
    ],
)  # fmt: skip
def test_an_argument_that_there_is_not_is_named(
    given: Given, call: Callable[[Given], Any], message: str
) -> None:
    with pytest.raises(TypeError, match=message) as raised:
        call(given)
    assert isinstance(raised.value, ct.ContactTrackerError)


@pytest.mark.parametrize(
    ("head", "message", "how"),
    [
        ("t,x,y,z,roll,pitch,yaw", "three angles", {}),
        ("t,cup_x,cup_y,cup_z,cup_rx,cup_ry,cup_rz", "angles or a rotation vector", {"child": "cup"}),
        ("frame,x,y,z,rvec_x,rvec_y,rvec_z", "with the rate of your frames", {}),
        ("unix_time,x,y,z,rvec_x,rvec_y,rvec_z", "'unix_time'", {}),
    ],
)
def test_a_refusal_in_python_proposes_the_call(
    tmp_path: Path, head: str, message: str, how: dict[str, str]
) -> None:
    """Which reads the poses when made as told."""
    path = tmp_path / "it's {a} file.csv"
    rows = np.c_[np.arange(FEW), np.ones((FEW, 3)), np.linspace(0.0, 0.5, FEW), np.zeros((FEW, 2))]
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    with pytest.raises(ct.ContactTrackerError, match=message) as raised:
        ct.segment(ct.read(path, **how)) if how else ct.segment(path)
    assert not re.search("--|contact-tracker", str(raised.value))
    if calls := re.findall(r"contact_tracker\.read\(.*?\)(?= or |, with|\. Orders|$)", str(raised.value)):
        assert len(eval(calls[0], {"contact_tracker": ct})) == FEW


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_an_error_of_the_package(name: str, given: Given) -> None:
    call, values = CALLS[name]
    wrong = [f"{value!r:.60}: {line}" for value in values for line in faults(call, given, value)]
    assert not wrong


def test_arrays_of_the_wrong_kind_are_an_error_of_the_package(given: Given) -> None:
    assert not [f"{name}: {line}" for name, call in ARRAYS.items() for line in faults(call, given)]


def test_numbers_of_other_libraries_are_numbers(given: Given) -> None:
    """Scalars and arrays that are not numpy's or Python's own floats."""
    from decimal import Decimal
    from fractions import Fraction

    ct.Tracker(lag_s=Fraction(1, 2), noise=(np.float32(3e-4), Decimal("0.003")))
    update(1, np.zeros(3, np.float32))
    update(0, np.int32(7))
    objects = given.position_m.astype(object)
    objects[3] = None
    assert given.arrays(positions_m=objects).counts == {"nonfinite": 1}
