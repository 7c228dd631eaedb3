"""Files of results, whole or not at all: what they replace, its mode, and no remains."""

import os
import stat
from pathlib import Path
from unittest.mock import Mock

import pytest

from contact_tracker import files
from contact_tracker.files import whole_file

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes, links and signals as POSIX has them")


def write(target: Path, text: str = "new") -> None:
    with whole_file(target) as temporary:
        temporary.write_text(text)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_whole_file_replaces_only_when_done(tmp_path) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    with pytest.raises(FileNotFoundError), whole_file(target) as temporary:
        temporary.write_text((tmp_path / "absent").read_text())
    assert target.read_text() == "old"
    with whole_file(target) as temporary:
        temporary.write_text("new")
        assert target.read_text() == "old"
        assert not list(tmp_path.glob("*.csv"))[1:], "what is unfinished does not look like a result"
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]


def test_a_whole_file_goes_where_a_link_points(tmp_path) -> None:
    (tmp_path / "link.csv").symlink_to("real.csv")
    write(tmp_path / "link.csv")
    assert (tmp_path / "real.csv").read_text() == "new"
    assert (tmp_path / "link.csv").is_symlink()


@pytest.mark.parametrize("linked", [False, True], ids=["itself", "linked"])
@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path.name)])
def test_only_regular_files_are_replaced(tmp_path, make, linked) -> None:
    """A folder, a pipe (instead of devices, which must not be replaced here), and a link in a circle."""
    target = odd = tmp_path / "odd.csv"
    make(odd)
    if linked:
        target = tmp_path / "link.csv"
        target.symlink_to("odd.csv")
    before = (odd.lstat().st_mode, odd.lstat().st_ino)
    with pytest.raises(OSError, match=r"it is (a folder|not a regular file)") as refused, whole_file(target):
        pytest.fail("nothing is to be written that cannot go anywhere")
    assert refused.value.filename == str(target)
    assert (odd.lstat().st_mode, odd.lstat().st_ino) == before
    assert {p.name for p in tmp_path.iterdir()} == {"odd.csv", target.name}


def test_a_planted_link_is_not_written_through(tmp_path, monkeypatch) -> None:
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


def test_a_replaced_temporary_file_does_not_become_the_result(tmp_path) -> None:
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
def test_the_mode_of_what_is_replaced_is_kept(tmp_path, before) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    target.chmod(before)
    with whole_file(target) as temporary:
        assert mode(temporary) & 0o077 == 0, "others read nothing of it before that is decided"
        temporary.write_text("new")
    assert (target.read_text(), mode(target)) == ("new", before)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize(
    ("before", "refused", "after"),
    [(0o640, False, 0o640), (0o660, True, 0o600), (0o664, True, 0o644), (0o674, True, 0o644)],
)
def test_the_owner_and_group_of_a_file_are_kept(tmp_path, before, refused, after, monkeypatch) -> None:
    """Or if the group cannot be kept, the new group has the rights of others."""
    target = tmp_path / "out.csv"
    target.write_text("old")
    owner = os.getuid() if refused else 12345
    os.chown(target, owner, 54321)
    target.chmod(before)
    if refused:
        monkeypatch.setattr(files.os, "fchown", Mock(side_effect=PermissionError(1, "not permitted")))
    write(target)
    there = target.stat()
    group = os.getegid() if refused else 54321
    assert (target.read_text(), there.st_uid, there.st_gid, mode(target)) == ("new", owner, group, after)


def test_an_interrupt_while_the_temporary_file_is_made_leaves_nothing(tmp_path, monkeypatch) -> None:
    open_file = os.open

    def interrupted(*arguments: object, **options: object) -> int:
        os.close(open_file(*arguments, **options))
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "out.csv"):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mask", [0o022, 0o027, 0o002])
def test_a_new_file_has_the_mode_that_the_user_asks_for(tmp_path, mask) -> None:
    before = os.umask(mask)
    try:
        write(tmp_path / "out.csv")
    finally:
        os.umask(before)
    assert mode(tmp_path / "out.csv") == 0o666 & ~mask


@pytest.mark.parametrize("name", ["x" * 251 + ".csv", "é" * 125 + ".csv", "\udcff" * 251 + ".csv", "\n.csv"])
def test_any_name_that_a_file_may_have_can_be_written(tmp_path, name) -> None:
    target = tmp_path / name
    write(target)
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == [name]


def test_a_name_that_no_file_may_have_is_refused_before_any_work(tmp_path) -> None:
    with pytest.raises(OSError, match="too long"), whole_file(tmp_path / ("x" * 300 + ".csv")):
        pytest.fail("nothing can come of it")
