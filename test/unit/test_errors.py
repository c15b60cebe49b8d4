# SPDX-License-Identifier: Apache-2.0
"""Errors name the missing library, and none is long."""

import pytest

from tactile_hand_ros.errors import shortened
from tactile_hand_ros.extras import MissingLibraryError, optional


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
