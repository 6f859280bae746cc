"""Stage `peers`: rankers of others on the photographs of one set."""

import argparse
from pathlib import Path

from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.peers import write_peer_matches
from epiprior_lab.evaluation.protocol import PEERS, pairs_of
from epiprior_lab.params import PHOTOGRAPHS, load_params


def main() -> None:
    """Write ``data/peers/<group>/<peer>/<pair_id>.npz``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--params", type=Path, default=PHOTOGRAPHS)
    parser.add_argument("--group", required=True)
    arguments = parser.parse_args()
    own, group = load_params(arguments.params).evaluate, str(arguments.group)
    store = Path("data/.tasks/peers") / group
    write_peer_matches(pairs_of(own, group), own.peers or (), PEERS / group, workers=default_workers(), store=store)


if __name__ == "__main__":
    main()
