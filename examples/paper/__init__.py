"""The experiments of the DiffTaichi paper as one command: `python -m tai paper`.

    python -m tai paper                     # --quick: all, ten minutes at most on two cores
    python -m tai paper --only toi flat     # some of them; --list shows their names
    python -m tai paper --full              # all iterations of the paper: hours
    python -m tai paper --resume            # continues an interrupted run

Runs the programs of the folder `examples`, compares their output with the paper, and writes a
page of results, `paper.md` and `paper.html`, with images.
"""
