"""The frame of all simulators here: options, the loop of descent, pictures. No physics.

    options = studio.options(__doc__, "billiards", iterations=200, steps=1024, rate=0.01)
    options.add_argument("--in-place", action="store_true", help="state without a time axis")
    args = options.parse_args()
    studio.start(args)                          # ti.init
    ...                                         # fields of `float`, kernels
    def iteration(number):                      # one step of descent; returns its loss
        with ti.ad.Tape(loss):
            forward()
        descend()
        return loss[None]

    losses = studio.optimise(args, iteration, cue=x0, speed=v0)
    if args.picture:
        studio.animate(args, draw, range(0, args.steps, 8))

An interrupt (Ctrl-C, SIGTERM) keeps the learned fields, and `--resume` goes on there. An error that
the user can mend (an impossible size, a folder that cannot be written, a library that is not
installed) ends the program with one line and exit code 2.
"""

from .descent import optimise, table, take_best
from .memory import add_states, report_memory, tape
from .options import LARGEST_SEED, Options, at_least, fail, need, options, plain, start
from .pictures import (
    BLUE,
    GOLD,
    GREEN,
    INK,
    PAPER,
    PLUM,
    RED,
    SERIES,
    SOFT,
    TEAL,
    animate,
    blend,
    css,
    movie,
    picture,
    plot,
    plot_losses,
    shades,
    signed,
)

__all__ = [
    "BLUE",
    "GOLD",
    "GREEN",
    "INK",
    "LARGEST_SEED",
    "Options",
    "PAPER",
    "PLUM",
    "RED",
    "SERIES",
    "SOFT",
    "TEAL",
    "add_states",
    "animate",
    "at_least",
    "blend",
    "css",
    "fail",
    "movie",
    "need",
    "optimise",
    "options",
    "picture",
    "plain",
    "plot",
    "plot_losses",
    "report_memory",
    "shades",
    "signed",
    "start",
    "table",
    "take_best",
    "tape",
]
