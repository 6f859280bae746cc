"""Stage `peers`: rankers of others on the photographs of one set."""

from pathlib import Path

from epiprior_lab.evaluation.peers import write_peer_matches
from epiprior_lab.evaluation.protocol import PEERS, pairs_of
from epiprior_lab.params import PHOTOGRAPHS, load_params, read_arguments


def main() -> None:
    """Write ``data/peers/<group>/<peer>/<pair_id>.npz``."""
    arguments = read_arguments(main.__doc__, params=PHOTOGRAPHS, group=None)
    own, group = load_params(arguments.params).evaluate, str(arguments.group)
    store = Path("data/.tasks/peers") / group
    write_peer_matches(pairs_of(own, group), own.peers or (), PEERS / group, store)


if __name__ == "__main__":
    main()
