"""Files are written completely or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from coopqp.errors import OutputError
from coopqp.output import check_file, check_folder, write_files


def test_files_and_their_folders_are_written(tmp_path: Path) -> None:
    a, b = tmp_path / "new" / "deep" / "a.bin", tmp_path / "b.bin"
    assert write_files({a: b"1", b: b"22"}) == [a, b]
    assert (a.read_bytes(), b.read_bytes()) == (b"1", b"22")
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == ["a.bin", "b.bin"]


def test_files_have_the_modes_of_ordinary_files(tmp_path: Path) -> None:
    ordinary = tmp_path / "ordinary"
    ordinary.write_bytes(b"")
    (written,) = write_files({tmp_path / "written": b""})
    assert written.stat().st_mode == ordinary.stat().st_mode


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    good, blocked = tmp_path / "good.txt", tmp_path / "file" / "x.txt"
    good.write_bytes(b"old")
    (tmp_path / "file").write_bytes(b"not a folder")
    with pytest.raises(OutputError, match="not a folder"):
        write_files({good: b"new", blocked: b"new"})
    assert good.read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "good.txt"]


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        write_files({tmp_path / "a": b"1"})
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: Path, target: Path) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_files({tmp_path / "a": b"1"})
    assert list(tmp_path.iterdir()) == []


def test_destinations_are_checked_before_anything_is_made(tmp_path: Path) -> None:
    check_folder(tmp_path / "x" / "y")
    check_file(tmp_path / "x" / "y.json")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="it is a folder"):
        check_file(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file, not a folder"):
        check_folder(tmp_path / "file")


def test_a_folder_without_permission_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(OutputError, match=f"no permission on {tmp_path}"):
        check_folder(tmp_path / "new")
