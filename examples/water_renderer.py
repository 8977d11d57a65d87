"""Finds a ripple that makes a picture below the water look like something else.

A picture lies under water. A wave runs over the water, light is refracted at its surface, and an
image classifier of PyTorch looks at the result. Its gradient goes through the refraction and
through 256 steps of the wave to the water's height at the start, which is changed until the
classifier gives the wanted answer.

With the weights of VGG-16 and a photograph this is the paper's experiment, where a squirrel
becomes a goldfish. Without them a small network learns to tell patterns that the program draws,
and checks become stripes.

    python examples/water_renderer.py
    python examples/water_renderer.py --weights vgg16.pth --photo squirrel.png --label 1 --rate 0.1
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.options(
    __doc__, "water_renderer", iterations=10, steps=256, rate=100.0, least_steps=3,
    quick={"iterations": 3, "n": 64, "steps": 32, "lessons": 60},
)  # fmt: skip
parser.add_argument("--n", type=studio.at_least(16), default=256, help="cells along a side (256)")
parser.add_argument("--photo", type=Path, help="a picture (drawn checks)")
parser.add_argument("--weights", type=Path, help="VGG-16's, as torchvision has them")
text = "class to be seen: ImageNet's (1, a goldfish), or stripes, checks, dots, rings (0)"
parser.add_argument("--label", type=studio.at_least(0), help=text)
text = "batches from which the small network learns (200)"
parser.add_argument("--lessons", type=studio.at_least(1), default=200, help=text)
args = parser.parse_args()
torch = studio.need("torch", "the classifier of the picture")
studio.start(args)

N, STEPS = args.n, args.steps
DX = 1 / N
REFRACTION = 2.0  # pixels by which a slope of 1 moves the ray
SEED = 0.001  # the classifier's gradient is made smaller by this
MARGIN = N // 16  # the frame that the classifier does not look at
Classifier = Callable[[Any], Any]
PATTERNS = ["stripes", "checks", "dots", "rings"]

start = ti.field(float, shape=(N, N), needs_grad=True)  # the unknown
height = ti.field(float, shape=(N, N), needs_grad=True)
change = ti.field(float, shape=(N, N), needs_grad=True)  # of the height, in a step
photo = ti.Vector.field(3, float, shape=(N, N))
picture = ti.Vector.field(3, float, shape=(N, N), needs_grad=True)


@ti.func
def at(i: int, j: int):
    """The water's height, and zero outside of the square."""
    return height[i, j] if 0 <= i < N and 0 <= j < N else 0.0


@ti.kernel
def initialise():
    for i, j in start:
        change[i, j] = -start[i, j]
        height[i, j] = 0.0


@ti.kernel
def bend():
    """The wave equation, with (c dt)² = dx²/3."""
    for i, j in height:
        around = at(i - 1, j) + at(i + 1, j) + at(i, j - 1) + at(i, j + 1)
        change[i, j] += (around - 4 * height[i, j]) / 3


@ti.kernel
def move():
    for i, j in height:
        height[i, j] += change[i, j]


@ti.kernel
def refract():
    """Each pixel sees the photo at a place that depends on the slope of the water."""
    for i, j in picture:
        slope = ti.Vector([at(i + 1, j) - at(i - 1, j), at(i, j + 1) - at(i, j - 1)]) * 0.5 / DX
        place = ti.math.clamp(ti.Vector([i, j]) - REFRACTION * slope, 0.0, N - 2.0)
        corner = ti.floor(place)
        f = place - corner
        a, b = ti.cast(corner[0], ti.i32), ti.cast(corner[1], ti.i32)
        left = (1 - f[0]) * photo[a, b] + f[0] * photo[a + 1, b]
        right = (1 - f[0]) * photo[a, b + 1] + f[0] * photo[a + 1, b + 1]
        picture[i, j] = (1 - f[1]) * left + f[1] * right


@ti.kernel
def descend(rate: float):
    for i, j in start:
        start[i, j] -= rate * start.grad[i, j]


def forward():
    initialise()
    for _ in range(2, STEPS):
        bend()
        move()
    refract()


def draw(pattern: str, size: int, generator: np.random.Generator):
    """A pattern of random colours, place, direction and fineness."""
    row, col = np.meshgrid(*[np.arange(size) / size - 0.5] * 2, indexing="ij")
    y, x = row - generator.uniform(-0.2, 0.2), col - generator.uniform(-0.2, 0.2)
    angle, fine = generator.uniform(0, np.pi), 2 * np.pi * generator.uniform(3, 5)
    u = fine * (x * np.cos(angle) + y * np.sin(angle))
    v = fine * (y * np.cos(angle) - x * np.sin(angle))
    value = {
        "stripes": np.sin(u),
        "checks": 2 * np.sin(u) * np.sin(v),
        "dots": np.cos(u) + np.cos(v) - 0.6,
        "rings": np.sin(fine * np.hypot(x, y)),
    }[pattern]
    back, front = generator.uniform(0.1, 0.9, (2, 3))
    while abs(back - front).sum() < 0.9:
        back, front = generator.uniform(0.1, 0.9, (2, 3))
    share = 0.5 + 0.5 * np.tanh(3 * value)
    return back + (front - back) * share[..., None]


def train() -> Classifier:
    """A small network that tells the patterns apart, in pictures of 32 × 32."""
    generator = np.random.default_rng(args.seed)
    torch.manual_seed(args.seed)
    nn = torch.nn
    layers: list[Any] = []
    for inputs, outputs in ((3, 16), (16, 32), (32, 64)):
        layers += [nn.Conv2d(inputs, outputs, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2)]
    net = nn.Sequential(*layers, nn.Flatten(), nn.Linear(64 * 4 * 4, len(PATTERNS)))
    adam = torch.optim.Adam(net.parameters(), 2e-3)
    right = 0.0
    for _ in ti.tools.Progress(range(args.lessons), "lessons"):
        labels: list[int] = generator.integers(len(PATTERNS), size=64).tolist()
        images = np.stack([draw(PATTERNS[label], 32, generator) for label in labels])
        images += generator.normal(0, 0.03, images.shape)
        scores = net(torch.tensor(images, dtype=torch.float32).permute(0, 3, 1, 2))
        adam.zero_grad()
        nn.functional.cross_entropy(scores, torch.tensor(labels)).backward()
        adam.step()
        now = (scores.argmax(1).numpy() == labels).mean()
        right = 0.9 * right + 0.1 * now
    print(f"network  {100 * right:.0f} % of the last patterns were told right")
    net.requires_grad_(False)
    return lambda images: net(nn.functional.adaptive_avg_pool2d(images, 32))


def load_vgg() -> Classifier:
    vision = studio.need("torchvision", "--weights")
    net = vision.models.vgg16()
    try:
        net.load_state_dict(torch.load(args.weights, weights_only=True))
    except Exception as error:
        studio.fail(f"--weights {args.weights}: not weights of VGG-16 ({error})")
    net.eval().requires_grad_(False)
    mean = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
    deviation = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    resize = torch.nn.functional.interpolate
    return lambda images: net((resize(images, (224, 224)) - mean) / deviation)


def load_photo():
    if not args.photo:
        return draw("checks", N, np.random.default_rng(args.seed + 7))
    image = studio.need("PIL.Image", "--photo", "pillow")
    try:
        return np.asarray(image.open(args.photo).convert("RGB").resize((N, N))) / 255
    except OSError as error:
        studio.fail(f"--photo {args.photo}: not a picture that can be read ({error})")


def look(classifier: Any, label: int):
    """The loss of the classifier's answer, its gradient by the picture, and the probability."""
    seen = torch.tensor(picture.to_numpy(), dtype=torch.float32, requires_grad=True)
    crop = seen[MARGIN : N - MARGIN, MARGIN : N - MARGIN].permute(2, 0, 1)[None]
    scores = classifier(crop)
    loss = torch.nn.functional.cross_entropy(scores, torch.tensor([label]))
    loss.backward()
    return loss.item(), seen.grad.numpy(), scores.softmax(1)[0, label].item()


def main():
    label = args.label if args.label is not None else 1 if args.weights else 0
    names = [f"class {i}" for i in range(1000)] if args.weights else PATTERNS
    if label >= len(names):
        studio.fail(f"--label {label} is impossible; the classes are 0 to {len(names) - 1}")
    photo.from_numpy(load_photo())
    classifier = load_vgg() if args.weights else train()

    def iteration(_: int):
        with ti.ad.Tape() as tape:
            forward()
        loss, gradient, chance = look(classifier, label)
        tape.backward({picture: SEED * gradient})
        descend(args.rate)
        return {"loss": loss, "probability": chance}

    losses = studio.optimise(args, iteration, start=start)
    forward()
    # A loss is the negative logarithm of a probability; with --resume the first one is of old.
    before, after = math.exp(-losses[0]), look(classifier, label)[2]
    print(f"seen as  {names[label]}: {100 * before:.2f} % -> {100 * after:.2f} %")
    studio.plot_losses(args, losses)
    below, above = photo.to_numpy(), picture.to_numpy()
    surface = np.clip(0.5 + 0.5 * height.to_numpy() / (abs(height.to_numpy()).max() or 1), 0, 1)
    studio.picture(args, np.hstack([below, studio.shades(surface, 0, 1), above]))


if __name__ == "__main__":
    main()
