"""Pictures of particles in three dimensions, by a few kernels.

Each particle is a small ball. The balls are put into a buffer of depths as the camera sees them,
the nearest one winning (`atomic_min`), and into another one as the light sees them, for shadows.
The surface is then smoothed, lit and shaded where its neighbourhood is in the way (ambient
occlusion), above a floor that fades into the background.

    splatter = Splatter(width=640, height=360, radius=0.005)
    pixels = splatter.picture(positions, colours)
"""

from typing import Any

import numpy as np
import tai as ti

Place = tuple[float, float, float]
FAR = 2**62
SUPERSAMPLING = 2
SHADOW_TEXELS = 700
SHADOW_EXTENT = 2.2
AMBIENT, SUN = 0.55, 0.6


def unit(vector: Any) -> Any:
    return np.asarray(vector, float) / np.linalg.norm(vector)


@ti.func
def bits(depth: Any, p: int):
    """Depth and particle in one number, ordered by depth."""
    return (ti.cast(depth * 1e7, ti.i64) << 32) + p


@ti.data_oriented
class Splatter:
    """A camera, a light and a floor.

    Args:
        width, height: of the pictures, in pixels.
        radius: of a particle.
        eye, target: the place of the camera, and the point that it looks at.
        floor: height of the floor.
        background: colour behind the floor, three numbers from 0 to 1.
    """

    def __init__(
        self,
        width: int = 640,
        height: int = 360,
        radius: float = 0.006,
        eye: Place = (0.0, 0.62, 1.75),
        target: Place = (0.35, 0.13, 0.45),
        floor: float = 0.047,
        light: Place = (-0.5, 1.0, 0.45),
        background: Place = (0.957, 0.945, 0.918),
    ):
        self.width, self.height = SUPERSAMPLING * width, SUPERSAMPLING * height
        self.radius, self.floor = radius, floor
        self.focal = 1.6 * self.width
        forward = unit(np.subtract(target, eye))
        right = unit(np.cross(forward, (0, 1, 0)))
        sun = unit(light)
        across = unit(np.cross(sun, (0, 0, 1)))
        self.eye, self.centre = ti.Vector(list(eye)), ti.Vector(list(target))
        self.forward, self.right = ti.Vector(forward.tolist()), ti.Vector(right.tolist())
        self.up = ti.Vector(np.cross(right, forward).tolist())
        self.sun, self.across = ti.Vector(sun.tolist()), ti.Vector(across.tolist())
        self.along = ti.Vector(np.cross(sun, across).tolist())
        self.background = ti.Vector(list(background))
        size = (self.width, self.height)
        self.nearest = ti.field(ti.i64, size)
        self.depth, self.smoothed = (ti.field(ti.f32, size) for _ in range(2))
        self.shadow = ti.field(ti.f32, (SHADOW_TEXELS, SHADOW_TEXELS))
        self.pixels = ti.Vector.field(3, ti.f32, size)

    def picture(self, positions: Any, colours: Any) -> Any:
        """The particles as bytes (height, width, 3).

        Args:
            positions: (particles, 3).
            colours: (particles, 4): red, green and blue from 0 to 1, and gloss.
        """
        self.nearest.fill(FAR)
        self.shadow.fill(1e9)
        positions = np.ascontiguousarray(positions, np.float32)
        self.splat(positions)
        self.splat_shadow(positions)
        self.read_depth()
        for _ in range(2):
            self.smooth(self.depth, self.smoothed)
            self.smooth(self.smoothed, self.depth)
        self.shade(np.ascontiguousarray(colours, np.float32))
        fine = self.pixels.to_numpy().swapaxes(0, 1)[::-1]
        s = SUPERSAMPLING
        rows, columns = self.height // s, self.width // s
        coarse = fine.reshape(rows, s, columns, s, 3).mean((1, 3))
        return (255 * np.clip(coarse, 0, 1) ** (1 / 1.1)).astype(np.uint8)

    @ti.kernel
    def splat(self, positions: ti.types.ndarray):
        for p in range(positions.shape[0]):
            way = ti.Vector([positions[p, 0], positions[p, 1], positions[p, 2]]) - self.eye
            z = way.dot(self.forward)
            scale = self.focal / z
            x = way.dot(self.right) * scale + 0.5 * self.width
            y = way.dot(self.up) * scale + 0.5 * self.height
            r = self.radius * scale
            for i in range(ti.max(int(x - r), 0), ti.min(int(x + r) + 1, self.width)):
                for j in range(ti.max(int(y - r), 0), ti.min(int(y + r) + 1, self.height)):
                    rest = 1 - ((i - x) ** 2 + (j - y) ** 2) / r**2
                    if rest > 0:
                        depth = z - self.radius * ti.sqrt(rest)
                        ti.atomic_min(self.nearest[i, j], bits(depth, p))

    @ti.func
    def seen_by_sun(self, where: Any):
        """Texel and depth of a place, as the light sees it."""
        way = where - self.centre
        texels = SHADOW_TEXELS / SHADOW_EXTENT
        u = way.dot(self.across) * texels + SHADOW_TEXELS / 2
        v = way.dot(self.along) * texels + SHADOW_TEXELS / 2
        return u, v, -way.dot(self.sun)

    @ti.kernel
    def splat_shadow(self, positions: ti.types.ndarray):
        for p in range(positions.shape[0]):
            where = ti.Vector([positions[p, 0], positions[p, 1], positions[p, 2]])
            u, v, depth = self.seen_by_sun(where)
            r = self.radius * SHADOW_TEXELS / SHADOW_EXTENT
            for i in range(ti.max(int(u - r), 0), ti.min(int(u + r) + 1, SHADOW_TEXELS)):
                for j in range(ti.max(int(v - r), 0), ti.min(int(v + r) + 1, SHADOW_TEXELS)):
                    ti.atomic_min(self.shadow[i, j], depth)

    @ti.kernel
    def read_depth(self):
        for i, j in self.depth:
            self.depth[i, j] = ti.cast(self.nearest[i, j] >> 32, ti.f32) * 1e-7

    @ti.kernel
    def smooth(self, source: ti.template, result: ti.template):
        """Takes the bumps of single balls out, and keeps the edges of the body."""
        for i, j in source:
            here, total, weights = source[i, j], 0.0, 0.0
            if self.nearest[i, j] < FAR:
                for a in range(ti.max(i - 4, 0), ti.min(i + 5, self.width)):
                    for b in range(ti.max(j - 4, 0), ti.min(j + 5, self.height)):
                        jump = (source[a, b] - here) / (2.5 * self.radius)
                        weight = ti.max(0.0, 1 - jump * jump)
                        total += weight * source[a, b]
                        weights += weight
                here = total / weights
            result[i, j] = here

    @ti.func
    def ray(self, i: int, j: int):
        """The way from the eye through a pixel, of depth 1."""
        x, y = (i - 0.5 * self.width) / self.focal, (j - 0.5 * self.height) / self.focal
        return self.forward + x * self.right + y * self.up

    @ti.func
    def place(self, i: int, j: int):
        return self.eye + self.depth[i, j] * self.ray(i, j)

    @ti.func
    def lit(self, where: Any):
        """How much of the light comes through, from 0 to 1."""
        u, v, depth = self.seen_by_sun(where)
        through, count = 0.0, 0.0
        for a in range(-3, 4):
            for b in range(-3, 4):
                i, j = int(u) + a, int(v) + b
                if 0 <= i < SHADOW_TEXELS and 0 <= j < SHADOW_TEXELS:
                    count += 1.0
                    if self.shadow[i, j] > depth - 2 * self.radius:
                        through += 1.0
        return through / count if count > 0 else 1.0

    @ti.func
    def open_around(self, i: int, j: int, depth: Any):
        """Ambient light: how many of the places around are not in front."""
        hidden = 0.0
        for k in range(24):
            angle, reach = 2.4 * k, 5 * self.radius * ti.sqrt((k + 0.5) / 24)
            pixels = reach * self.focal / depth * 3
            a = ti.math.clamp(i + int(pixels * ti.cos(angle)), 0, self.width - 1)
            b = ti.math.clamp(j + int(pixels * ti.sin(angle)), 0, self.height - 1)
            ahead = depth - self.depth[a, b]
            if 1.5 * self.radius < ahead < 25 * self.radius:
                hidden += 1.0
        return 1 - 0.75 * hidden / 24

    @ti.kernel
    def shade(self, colours: ti.types.ndarray):
        for i, j in self.pixels:
            way = self.ray(i, j)
            colour = self.background
            if self.nearest[i, j] < FAR:
                here = self.place(i, j)
                p = ti.cast(self.nearest[i, j] & 0xFFFFFFFF, ti.i32)
                # The flatter one of the slopes to both sides: no normals across an edge.
                right, left = self.place(i + 1, j) - here, here - self.place(i - 1, j)
                up, down = self.place(i, j + 1) - here, here - self.place(i, j - 1)
                across = right if right.norm() < left.norm() else left
                upward = up if up.norm() < down.norm() else down
                normal = across.cross(upward).normalized(1e-9)
                sun = ti.max(normal.dot(self.sun), 0.0) * self.lit(
                    here + 1.5 * self.radius * normal
                )
                ambient = (
                    AMBIENT * (0.8 + 0.2 * normal[1]) * self.open_around(i, j, self.depth[i, j])
                )
                base = ti.Vector([colours[p, 0], colours[p, 1], colours[p, 2]])
                half = (self.sun - way.normalized()).normalized()
                shine = colours[p, 3] * ti.max(normal.dot(half), 0.0) ** 40
                colour = base * (ambient + SUN * 1.25 * sun) + shine * sun
            elif way[1] < 0:
                z = (self.floor - self.eye[1]) / way[1]
                here = self.eye + z * way
                light = 0.72 + 0.28 * self.lit(here)
                light *= 0.5 + 0.5 * self.open_around(i, j, z)
                fade = ti.exp(-2.0 * ti.max((here - self.centre).norm() - 0.35, 0.0))
                line = 1.0
                for d in ti.static((0, 2)):
                    off = ti.abs(here[d] * 10 - ti.round(here[d] * 10))
                    line = ti.min(line, ti.math.clamp(off * 18, 0.94, 1.0))
                colour = self.background * (1 - fade + fade * light * line)
            self.pixels[i, j] = colour
