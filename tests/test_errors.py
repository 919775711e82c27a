"""Errors: one line each, as exceptions of their kind, through a pickle too."""

from __future__ import annotations

import pickle

import pytest

from torchlight import errors

KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.TorchlightError)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_is_one_line_whatever_a_file_put_into_it(kind: type[errors.TorchlightError]) -> None:
    error = kind("a\nb.yaml: no such\u2028key\r\n")
    assert str(error) == "a b.yaml: no such key"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    with pytest.raises(kind):
        raise error


def test_a_file_error_is_an_os_error_without_a_number() -> None:
    error = errors.FormatError("a.exr: missing")
    assert isinstance(error, OSError)
    assert (error.errno, error.filename) == (None, None)
