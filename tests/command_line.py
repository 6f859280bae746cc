"""The command line with a stand-in for the library, and programs of their own, for tests of the commands."""

import os
import subprocess
import sys

from typer.testing import CliRunner

import epiprior
from epiprior import RankedMatches
from epiprior.cli import app
from synthetic import make_estimate, make_pair

PAIR = make_pair(seed=1)


def run_command(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def run_python(code, **environment):
    """Run code in a fresh interpreter, and return the program that ended well."""
    command, where = [sys.executable, "-c", code], os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, check=True, env=where, timeout=300)


def one_line(result):
    (line,) = result.stderr.splitlines()
    return line


def refused(*arguments):
    """Return the only line on stderr of a command that ends with exit code 2."""
    result = run_command(*arguments)
    assert result.exit_code == 2
    return one_line(result)


class FakeLibrary:
    """Stands in for the library: notes how it is called, returns or raises what the test puts in."""

    def __init__(self, monkeypatch):
        self.calls = []
        self.estimate, self.sets = make_estimate(PAIR), (PAIR.matches,)
        answers = {"estimate_fundamental": lambda: self.estimate, "rank_matches": self._ranked}
        for name, answer in (answers | {"standard_matches": lambda: PAIR.matches}).items():
            monkeypatch.setattr(epiprior, name, self._function(name, answer), raising=False)

    def _ranked(self):
        return RankedMatches(sets=self.sets, standard=PAIR.matches, seconds={}, preset="default")

    def _function(self, name, answer):
        def function(image1, image2, **options):
            self.calls.append((name, options | {"images": (image1, image2)}))
            if isinstance(found := answer(), Exception):
                raise found
            return found

        return function

    def options(self, name="estimate_fundamental"):
        return next(options for called, options in reversed(self.calls) if called == name)
