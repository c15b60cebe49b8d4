# SPDX-License-Identifier: Apache-2.0
"""A file or link is replaced atomically or not at all, and no planted link is followed."""

import os

import pytest

from tactile_hand_ros.files import replace_text


def test_text_takes_the_place_of_a_file_and_of_a_link_to_one(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    replace_text(file, "one")
    link.symlink_to(file)
    replace_text(link, "two")
    assert (file.read_text(), link.read_text()) == ("one", "two")
    assert not link.is_symlink()
    mask = os.umask(0o022)
    os.umask(mask)
    assert file.stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_full_disk_leaves_the_old_text_and_no_draft(tmp_path, small_disk):
    file = tmp_path / "file"
    replace_text(file, "old")
    with pytest.raises(OSError, match="too large"):
        replace_text(file, 2 * small_disk * "x")
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def test_a_link_planted_under_the_name_of_the_draft_is_not_followed(tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    monkeypatch.setattr(os, "urandom", bytes)  # an attacker has guessed the name
    draft = tmp_path / f".file.{bytes(8).hex()}"
    draft.symlink_to(victim)
    with pytest.raises(FileExistsError):
        replace_text(tmp_path / "file", "new")
    assert victim.read_text() == "precious" and not (tmp_path / "file").exists()


def test_a_text_is_on_the_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    """Otherwise a crash of the machine could leave an empty file."""
    file, sizes, sync = tmp_path / "file", [], os.fsync

    def watched(descriptor):
        assert not file.exists()
        sizes.append(os.fstat(descriptor).st_size)
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", watched)
    replace_text(file, "some")
    assert sizes == [4] and file.read_text() == "some"
