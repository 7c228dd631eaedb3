"""Temporary files of results: unpredictable names, mode of the replaced file, no remains."""

import os
import stat
from pathlib import Path

import pytest

from contact_tracker import files
from contact_tracker.files import whole_file

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes, links and signals as POSIX has them")


def write(target: Path, text: str = "new") -> None:
    with whole_file(target) as temporary:
        temporary.write_text(text)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_planted_link_is_not_written_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even if the name is known."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    monkeypatch.setattr(files.os, "urandom", lambda count: bytes(count))
    with whole_file(tmp_path / "out.csv") as temporary:
        pass
    temporary.symlink_to(victim)
    with pytest.raises(FileExistsError) as error, whole_file(tmp_path / "out.csv"):
        pytest.fail("there is something in the way")
    assert error.value.filename == str(tmp_path / "out.csv")
    assert victim.read_text() == "precious"


def test_a_replaced_temporary_file_does_not_become_the_result(tmp_path: Path) -> None:
    target, victim = tmp_path / "out.csv", tmp_path / "victim"
    target.write_text("old")
    victim.write_text("precious")

    def write_and_swap() -> None:
        with whole_file(target) as temporary:
            temporary.unlink()
            temporary.symlink_to(victim)

    with pytest.raises(OSError, match="another file"):
        write_and_swap()
    assert (target.read_text(), victim.read_text()) == ("old", "precious")
    assert not target.is_symlink()


@pytest.mark.parametrize("before", [0o640, 0o600, 0o444, 0o755])
def test_the_mode_of_what_is_replaced_is_kept(tmp_path: Path, before: int) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    target.chmod(before)
    with whole_file(target) as temporary:
        assert mode(temporary) & 0o077 == 0, "others read nothing of it before that is decided"
        temporary.write_text("new")
    assert (target.read_text(), mode(target)) == ("new", before)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
def test_the_owner_and_group_of_what_is_replaced_are_kept(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    os.chown(target, 12345, 54321)
    target.chmod(0o640)
    write(target)
    there = target.stat()
    assert (target.read_text(), there.st_uid, there.st_gid, mode(target)) == ("new", 12345, 54321, 0o640)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize(("before", "after"), [(0o660, 0o600), (0o664, 0o644), (0o674, 0o644)])
def test_if_the_group_cannot_be_kept_the_new_group_has_the_rights_of_others(
    tmp_path: Path, before: int, after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    os.chown(target, -1, 54321)
    target.chmod(before)

    def refuse(*_: int) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(files.os, "fchown", refuse)
    write(target)
    assert (target.read_text(), target.stat().st_gid, mode(target)) == ("new", os.getegid(), after)


def test_an_interrupt_while_the_temporary_file_is_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python raises it only when the call has returned, and the file is there."""
    open_file = os.open

    def interrupted(*arguments: object, **options: object) -> int:
        os.close(open_file(*arguments, **options))
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "out.csv"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_refused_by_the_last_check_is_kept(tmp_path: Path) -> None:
    target, checked = tmp_path / "out.csv", list[str]()

    def check() -> None:
        checked.append(target.read_text())
        raise OSError("not that one")

    def make() -> None:
        with whole_file(target, check) as temporary:
            temporary.write_text("new")
            assert not checked
            target.write_text("there since")

    with pytest.raises(OSError, match="not that one"):
        make()
    assert checked == [target.read_text()] == ["there since"]
    assert os.listdir(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("mask", [0o022, 0o027, 0o002])
def test_a_new_file_has_the_mode_that_the_user_asks_for(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        write(tmp_path / "out.csv")
    finally:
        os.umask(before)
    assert mode(tmp_path / "out.csv") == 0o666 & ~mask


@pytest.mark.parametrize("name", ["x" * 251 + ".csv", "é" * 125 + ".csv", "\udcff" * 251 + ".csv", "\n.csv"])
def test_any_name_that_a_file_may_have_can_be_written(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    write(target)
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == [name]


def test_a_name_that_no_file_may_have_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="too long"), whole_file(tmp_path / ("x" * 300 + ".csv")):
        pytest.fail("nothing can come of it")
