"""tai in deterministic mode: the cost of bit-identical results."""

import sys
from functools import partial

import peer_tai

if __name__ == "__main__":
    load = partial(peer_tai.load, deterministic=True)
    sys.exit(peer_tai.harness.main("tai_deterministic", load))
