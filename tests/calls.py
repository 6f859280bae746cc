"""Functions that do their work and are watched, and calls that have to be refused."""

import pytest


def note_calls(monkeypatch, owner, name):
    """Return a list that gets the arguments and options of every call of a function, which goes on as before."""
    calls, function = [], getattr(owner, name)

    def noted(*arguments, **options):
        calls.append((arguments, options))
        return function(*arguments, **options)

    monkeypatch.setattr(owner, name, noted)
    return calls


def refused(error, message, call, *arguments, **options):
    """Check that a call raises an error whose text matches a message."""
    with pytest.raises(error, match=message):
        call(*arguments, **options)
