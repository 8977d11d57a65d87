"""The experiments of the DiffTaichi paper as one command: `python -m tai.paper`.

    python -m tai.paper                     # --quick: all, ten minutes at most on two cores
    python -m tai.paper --only toi flat     # some of them; --list shows their names
    python -m tai.paper --full              # all iterations of the paper: hours
    python -m tai.paper --resume            # goes on where a run stopped

It runs the programs of the folder `examples`, reads what they print and write, compares it with
what the paper says, and writes a page of it, `paper.md` and `paper.html` with pictures.
"""
