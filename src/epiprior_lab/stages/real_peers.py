"""Stage `peers` of the second pipeline: rankers of others on the photographs of one set."""

from __future__ import annotations

import argparse
from pathlib import Path

from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.photographs.peer_matching import write_peer_matches
from epiprior_lab.pairsets import read_pair_set
from epiprior_lab.params import PHOTOGRAPHS, load_params


def main() -> None:
    """Write ``data/peers/<set>/<ranker>/<pair_id>.npz``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--set", required=True, dest="name")
    name: str = parser.parse_args().name
    params = load_params(PHOTOGRAPHS)
    write_peer_matches(
        read_pair_set(Path("data/real") / name).pairs,
        params.evaluate.peers or (),
        Path("data/peers") / name,
        workers=default_workers(),
        store=Path("data/.tasks/peers") / name,
    )


if __name__ == "__main__":
    main()
