"""The ways to an estimate; a module of its own, since the command line must not wait for compiled libraries."""

from typing import Literal

Mode = Literal["preprocess", "standard", "cascade"]
