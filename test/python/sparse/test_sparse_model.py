"""Random trees and random sequences of actions against dictionaries and sets.

`make fuzz-sparse` runs ten thousand sequences; these are some with fixed seeds, and the trees
that failed once.
"""

import random
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "fuzz"
sys.path.insert(0, str(FUZZ))

import configurations  # noqa: E402
import sparse_sequences as sequences  # noqa: E402
from sparse_trees import random_forest  # noqa: E402

# An append to a list of a field with an offset; writes to another field at equal indices.
FAILED_ONCE = [107, 155, 162, 166]


@pytest.mark.parametrize("seed", FAILED_ONCE)
def test_trees_that_failed_once(seed, tmp_path):
    sequences.run_seed(seed, 10, tmp_path, offline_cache=False)


@pytest.mark.parametrize("seed", range(10000, 10030))
def test_trees_behave_as_the_model(seed, tmp_path):
    where = configurations.draw(seed, configurations.default_targets())
    print(where)
    with where.chosen():
        sequences.run_seed(seed, 10, tmp_path, offline_cache=False, **where.options)


def test_trees_are_of_all_kinds():
    """The seeds draw all the kinds that they are for."""
    forests = [random_forest(random.Random(seed)) for seed in range(200)]
    levels = [level for forest in forests for level in forest.levels]
    fields = [spec for forest in forests for spec in forest.fields]
    kinds = {level.kind for level in levels}
    assert kinds == {"dense", "pointer", "bitmasked", "hash", "dynamic"}
    nested = {(level.parent.kind, level.kind) for level in levels if level.parent}
    assert len(nested) == 25
    assert max(len(level.path()) for level in levels) == 4
    assert {spec.element for spec in fields} == {(), (2,), (3,), (2, 2)}
    assert any(spec.is_split for spec in fields)
    assert any(spec.offset for spec in fields)
    assert any(spec.needs_grad for spec in fields)
    assert any(len(forest.tops) > 1 for forest in forests)


def test_a_wrong_program_is_noticed(tmp_path):
    """The comparison itself: a value that the model does not know of."""
    runner = sequences.Runner(0, tmp_path, offline_cache=False)
    spec = runner.forest.fields[0]
    runner.play([])
    runner.of(spec)[tuple(spec.first)] = 5
    with pytest.raises(sequences.Mismatch):
        runner._check("check")
