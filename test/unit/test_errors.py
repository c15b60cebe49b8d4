# SPDX-License-Identifier: Apache-2.0
"""Errors give count, place and the missing library."""

import pytest

from tactile_hand_ros.errors import CollinearContactsError, shortened
from tactile_hand_ros.extras import MissingLibraryError, optional


def test_contacts_on_a_line_are_listed():
    error = CollinearContactsError.of([(0.0, 1.0, 0.25), (1.0, 2.0, 3.0)])
    assert "(0.0000, 1.0000, 0.2500), (1.0000, 2.0000, 3.0000) lie on one line" in str(error)


def test_a_missing_library_is_named_and_what_it_lacks_itself_is_not_hidden(tmp_path, monkeypatch):
    assert optional("json.decoder", "x").JSONDecoder
    with pytest.raises(MissingLibraryError, match=r"A figure needs .* no_such_lib, .* `pip inst"):
        optional("no_such_lib", "A figure")
    with pytest.raises(MissingLibraryError, match="library no_such_lib,"):
        optional("no_such_lib.part", "A figure")
    (tmp_path / "broken_lib.py").write_text("import no_such_lib")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="no_such_lib"):
        optional("broken_lib", "A figure")


def test_no_text_is_long_or_has_more_than_one_line():
    assert shortened("a \n b\t c") == "a b c"
    assert shortened("x" * 300) == "x" * 300
    assert shortened("x" * 301) == "x" * 297 + "..."
    assert shortened("y" * 61, 60) == "y" * 57 + "..."
    assert shortened(" " * 999 + "abc") == "a"
