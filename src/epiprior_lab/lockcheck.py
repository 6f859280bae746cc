"""Tell whether the locks of all pipelines belong to this code, these parameters and these committed results.

``dvc status`` needs the data, which a clean clone lacks. This check asks DVC for the hashes of what git holds (code,
parameters, models, reports), and compares cached data by what the lock says of them: a stage must have read what the
stage before it wrote. Photographs, which git does not hold, are left out.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from epiprior.errors import EpipriorError

# Folder of each pipeline, from the root, and the command that runs it.
PIPELINES = {"": "make repro", "benchmarks/real": "make real DATA=FOLDER", "benchmarks/sfm": "make sfm DATA=FOLDER"}


class LockError(EpipriorError):
    """The pipeline's files cannot be read, or there is no lock."""


def check_lock(root: Path, pipeline: str = "") -> dict[str, list[str]]:
    """Return what differs between a pipeline's ``dvc.lock`` and the working tree, by stage.

    `root` is the folder of ``.dvc``, `pipeline` a key of `PIPELINES`; a difference reads ``"src/epiprior: modified"``.
    LockError if there is no ``dvc.lock``, or DVC cannot read the pipeline.
    """
    os.environ["DVC_NO_ANALYTICS"] = "1"
    from dvc.exceptions import DvcException
    from dvc.repo import Repo

    lock, definition = root / pipeline / "dvc.lock", Path(pipeline) / "dvc.yaml"
    if not lock.is_file():
        raise LockError(f"{lock}: no such file; run the pipeline and commit it")
    try:
        with Repo(str(root)) as repo:
            cached = {Path(out.fs_path): out for stage in repo.index.stages for out in stage.outs if out.use_cache}
            stages = [stage for stage in repo.index.stages if Path(stage.path_in_repo) == definition]
            found = {stage.name: sorted(_differences(stage, cached, root.resolve())) for stage in stages}
            locked = (yaml.safe_load(lock.read_text(encoding="utf-8")) or {}).get("stages", {})
            found |= {name: ["in dvc.lock, not in dvc.yaml"] for name in locked.keys() - found.keys()}
    except DvcException as error:
        raise LockError(f"{root}: DVC cannot read the pipeline: {error}") from error
    return {name: lines for name, lines in found.items() if lines}


def _differences(stage: Any, cached: dict[Path, Any], root: Path) -> Iterator[str]:
    """Yield what differs between a stage in the lock and in the tree."""
    if stage.cmd_changed:
        yield "command: modified"
    for entry in (*stage.deps, *stage.outs):
        path = Path(entry.fs_path)
        writer = cached.get(path)
        if writer is not None:
            if not entry.hash_info:
                yield f"{entry}: not in dvc.lock"
            elif entry.hash_info != writer.hash_info:
                yield f"{entry}: the lock says that its stage wrote {writer.hash_info.value}"
        elif path.is_relative_to(root) and not any(path.is_relative_to(folder) for folder in (root / "data", *cached)):
            yield from _described(entry.workspace_status())


def _described(status: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Flatten DVC's status, which is nested for parameters."""
    for name, value in status.items():
        if isinstance(value, dict):
            yield from _described(value, f"{name}: ")
        else:
            yield f"{prefix}{name}: {value}"
