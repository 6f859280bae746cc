"""Functions that do their work and are watched."""


def note_calls(monkeypatch, owner, name):
    """Return a list that gets the arguments and options of every call of a function, which goes on as before."""
    calls, function = [], getattr(owner, name)

    def noted(*arguments, **options):
        calls.append((arguments, options))
        return function(*arguments, **options)

    monkeypatch.setattr(owner, name, noted)
    return calls
