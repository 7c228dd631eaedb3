"""Commands that messages propose are those of the user, with what names and values of columns allow."""

import shlex
from pathlib import Path

import pytest

from contact_tracker.cli.main import build_parser
from contact_tracker.config.table_reading import reading_of
from contact_tracker.errors import UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log


def refusal(path: Path, columns: str, values: str, *words: str) -> str:
    """Of a table with the same row again and again, by a command line."""
    path.write_text(f"t,x,y,z,{columns}\n" + "".join(f"{0.01 * i},1,2,3,{values}\n" for i in range(9)))
    args = build_parser().parse_args(list(words))
    with pytest.raises(UnreadableRecording) as raised:
        open_log(str(path), table=args.table)
    return str(raised.value)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("segment a.csv -o out.png --states f-f,e-f", "segment a.csv -o out.png --states f-f,e-f"),
        ("segment --unit=mm -o 'a b.png' a.csv", "segment -o 'a b.png' a.csv --unit mm"),
        ("live a.csv --rate 2 --known map.toml --json", "live a.csv --rate 2 --known map.toml --json"),
        ("info a.csv --unit mm -v", "info a.csv -v --unit mm"),
        ("view a.csv b.csv --save x.rrd", "view a.csv b.csv --save x.rrd"),
        ("compare a.csv b.csv --time-unit ms -o x.png", "compare a.csv b.csv -o x.png --time-unit ms"),
        ("batch folder -o dataset", "segment {path}"),  # the command for one file
    ],
)
def test_a_proposed_command_is_the_users_own(tmp_path: Path, words: str, expected: str) -> None:
    path = tmp_path / "a.csv"
    text = refusal(path, "roll,pitch,yaw", "170,2,3", *shlex.split(words))
    assert f"read them by contact-tracker {expected.format(path=path)} --euler xyz:deg." in text


def test_a_proposed_command_reads_files_whose_names_begin_with_a_dash(tmp_path: Path) -> None:
    text = refusal(tmp_path / "-a.csv", "roll,pitch,yaw", "170,2,3", "segment", "-v", "--", "-a.csv")
    command = "segment -v --euler xyz:deg -- -a.csv"
    assert f"read them by contact-tracker {command}." in text
    args = build_parser().parse_args(shlex.split(command))
    assert (args.table.euler, args.table.given) == ("xyz:deg", ("segment", "-v", "--", "-a.csv"))


@pytest.mark.parametrize(
    ("columns", "values", "ways"),
    [
        ("roll,pitch,yaw", "0.1,0.2,0.3", ["--euler xyz:deg", "--euler xyz:rad"]),
        ("roll,pitch,yaw", "0.1,-170,0.3", ["--euler xyz:deg"]),
        ("roll [rad],pitch [rad],yaw [rad]", "0.1,0.2,0.3", ["--euler xyz:rad"]),
        ("euler_x,euler_y,euler_z", "0.1,100,0.3", ["--euler xyz:deg"]),
        ("rx,ry,rz", "0.1,0.2,0.3", ["--rotation-vector", "--euler xyz:rad", "--euler xyz:deg"]),
        ("rx,ry,rz", "0.1,-170,0.3", ["--euler xyz:deg"]),
        ("rvec_x,rvec_y,rvec_z", "0.1,0.2,0.3", ["--rotation-vector"]),
        ("rvec_x,rvec_y,rvec_z", "0.1,-170,0.3", []),
    ],
)
def test_no_reading_is_proposed_that_names_or_values_contradict(
    tmp_path: Path, columns: str, values: str, ways: list[str]
) -> None:
    text = refusal(tmp_path / "a.csv", columns, values, "segment", "a.csv")
    commands = " or ".join(f"contact-tracker segment a.csv {way}" for way in ways)
    assert commands in text
    assert text.count("contact-tracker") == len(ways)
    assert ways or "as in 'rvec_x [deg]'" in text


def test_an_index_without_a_name_is_proposed_as_the_time(tmp_path: Path) -> None:
    """As pandas writes one, of times but not of numbers of rows."""
    path, pose = tmp_path / "a.csv", "x,y,z,qw,qx,qy,qz"
    for step, way in (
        ("0.1", "if its first column, which has no name, is the time"),
        ("1", "it has no times"),
    ):
        rows = [f"{float(step) * i:g},0.{i},0,0,1,0,0,0" for i in range(9)]
        path.write_text("\n".join([f",{pose}", *rows, ""]))
        with pytest.raises(UnreadableRecording, match=f"{way}: read them by contact-tracker segment"):
            open_log(str(path))
    assert len(Poses.collect(open_log(str(path), table=reading_of("time=c0", time_unit="s")))) == 9
