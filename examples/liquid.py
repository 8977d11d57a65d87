"""A soft robot learns to walk with a pool of liquid on its back.

The robot of diffmpm3d.py, somewhat smaller, and thirteen thousand particles of liquid, which the
same grid couples: 15150 + 12996 particles. (The paper says 30 K + 13 K; its published program has
these.)

    python examples/liquid.py --steps 128 --iterations 10
    python examples/liquid.py                                  # the paper's: 512 slots
"""

import random

import studio
from diffmpm3d import Scene, Simulation, animate, learn, options


def main():
    args = options(__doc__, "liquid", iterations=501, rate=10.0).parse_args()
    studio.start(args)
    random.seed(args.seed)
    scene = Scene(args.density)
    scene.robot(block=0.08)
    scene.pool(corner=(0.1, 0.15, 0.1), size=(0.2, 0.05, 0.2))
    simulation = Simulation(scene, args.steps)
    print(f"robot    {simulation.solids} particles, {simulation.muscles} muscles")
    print(f"liquid   {simulation.count - simulation.solids} particles")
    learn(args, simulation)
    animate(args, simulation)


if __name__ == "__main__":
    main()
