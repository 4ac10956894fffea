# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or not there."""

import pytest

from skyhaul.whole import whole


@pytest.mark.parametrize("fault", [KeyboardInterrupt, OSError, ValueError])
def test_what_breaks_off_leaves_the_file_that_was_there(tmp_path, fault):
    def write_half(path):
        with whole(path) as part:
            part.write_text("half")
            raise fault

    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(fault):
        write_half(path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_gets_its_name_at_the_end(tmp_path):
    path = tmp_path / "a.txt"
    with whole(path) as part:
        part.write_text("all")
        assert not path.exists()
    assert path.read_text() == "all"
    assert list(tmp_path.iterdir()) == [path]


def test_a_fault_before_anything_is_written_is_passed_on(tmp_path):
    with pytest.raises(FileNotFoundError), whole(tmp_path / "none" / "a") as part:
        part.write_text("x")
