"""Ape, cat and duck: three toy animals after LineMOD's, in millimeters, standing on z = 0."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from .solids import (
    Sdf,
    Solid,
    box,
    capsule,
    colored_parts,
    cylinder,
    ellipsoid,
    half_space,
    intersect,
    mirrored,
    moved,
    painted,
    sphere,
    subtract,
    torus,
    union,
)

BLACK, WHITE = (0.05, 0.05, 0.06), (0.95, 0.94, 0.91)


def _limb(*joints: tuple[float, float, float, float]) -> Sdf:
    """A chain of capsules through joints (x, y, z, radius)."""
    return union(*(capsule(a[:3], b[:3], a[3], b[3]) for a, b in pairwise(joints)), smooth=2.0)


def ape() -> Solid:
    """A seated ape that faces +x, its left hand at its chin."""
    floor = half_space((0, 0, 0), (0, 0, -1))
    body = union(
        ellipsoid((-8, 0, 26), (29, 30, 28)), ellipsoid((-5, 0, 46), (22, 25, 22)), smooth=10
    )
    head = union(
        ellipsoid((4, 0, 72), (18, 17, 20)),
        capsule((17, -8, 77), (17, 8, 77), 5.5),
        ellipsoid((20, 0, 65), (12, 12, 9)),
        smooth=5,
    )
    ears = mirrored(ellipsoid((2, 18, 71), (4, 5, 6)), axis=1)
    right_arm = _limb((-2, -22, 53, 9), (8, -31, 33, 8), (26, -26, 26, 7))
    left_arm = _limb((-2, 22, 53, 9), (13, 30, 36, 8), (26, 14, 51, 6.5), (29, 8, 55, 6))
    legs = mirrored(_limb((0, 20, 12, 11), (22, 26, 19, 9), (30, 20, 6, 7), (36, 19, 5, 6)), 1)
    mouth = box((33, 0, 61.5), (8, 13, 1.4))
    shape = subtract(
        intersect(union(body, head, ears, right_arm, left_arm, legs, smooth=4), floor),
        mouth,
        smooth=1,
    )

    fur, skin = (0.30, 0.19, 0.12), (0.80, 0.60, 0.42)
    face = intersect(
        union(ellipsoid((20, 0, 66), (15, 14, 10)), mirrored(sphere((19, 6, 74), 7.5), 1)),
        half_space((8, 0, 0), (-1, 0, 0)),
    )
    color = painted(
        fur,
        (ellipsoid((24, 0, 34), (22, 15, 19)), skin),
        (ellipsoid((-36, 0, 40), (18, 17, 24)), (0.52, 0.48, 0.44)),
        (right_arm, fur),
        (left_arm, fur),
        (face, skin),
        (mirrored(sphere((20, 6.2, 73.5), 4.4), 1), WHITE),
        (mirrored(sphere((22.5, 5.8, 73), 2.8), 1), BLACK),
        (mirrored(sphere((32, 3, 69), 1.9), 1), (0.2, 0.1, 0.08)),
        (box((33, 0, 61.5), (10, 15, 2.6)), (0.45, 0.18, 0.15)),
        (mirrored(sphere((3, 22, 71), 4.2), 1), skin),
        (sphere((31, -26, 25), 9), skin),
        (sphere((31, 6, 56), 8), skin),
        (mirrored(intersect(sphere((38, 19, 3), 11), half_space((0, 0, 14), (0, 0, 1))), 1), skin),
    )
    bounds = np.array([(-45, -48, -5), (50, 48, 100)], dtype=float)
    return Solid(shape, color, bounds, edge_length=2.0, specular=0.15, shininess=0.2)


def cat() -> Solid:
    """A standing kitten along +y that turns its head towards +x."""
    floor = half_space((0, 0, 0), (0, 0, -1))
    body = union(
        capsule((0, -30, 42), (0, 20, 44), 17, 18), ellipsoid((0, 20, 40), (19, 18, 21)), smooth=6
    )
    front = mirrored(_limb((12, 24, 36, 10), (14, 32, 14, 8), (14.5, 37, 8, 10)), 0)
    hind = mirrored(_limb((12, -32, 38, 13), (15, -44, 18, 9), (15.5, -36, 8, 10)), 0)
    tail = _limb((0, -44, 46, 8), (-4, -54, 60, 7), (-11, -57, 76, 6), (-21, -54, 88, 6.5))
    # The head is made looking along +x about its own center, then turned and put on the neck.
    skull = union(
        ellipsoid((0, 0, 0), (28, 33, 27)), ellipsoid((21, 0, -10), (12, 17, 10)), smooth=6
    )
    ear = intersect(
        cylinder((-2, 16, 12), (-4, 29, 42), 16, 1.5), half_space((-9, 0, 0), (-1, 0, 0)), smooth=2
    )
    ear = subtract(ear, cylinder((10, 18, 12), (2, 27, 38), 11, 1.0), smooth=1)
    ears = mirrored(ear, 1)
    center, turn = (3, 32, 76), (0, 0, 52)
    head = moved(union(skull, ears, smooth=3), center, turn)
    collar = torus((2, 27, 54), (0.1, 0.5, 1), 17, 3.5)
    bell = sphere((14, 42, 48), 5)
    shape = intersect(
        union(union(body, front, hind, tail, head, smooth=5), collar, bell, smooth=1), floor
    )

    orange, stripe = (0.85, 0.52, 0.22), (0.48, 0.24, 0.08)
    stripes = [(box((0, y, 66), (60, 6, 44), 2), stripe) for y in (-40.0, -27.0, -14.0, -1.0)]
    rings = [(sphere(c, 9.5), stripe) for c in ((-3, -53, 57), (-9, -57, 74))]
    inner_ears = intersect(
        mirrored(cylinder((11, 18, 12), (2, 27, 38), 11.3, 1.3), 1),
        half_space((0, 0, 21.5), (0.25, 0, -1)),
    )
    muzzle = mirrored(ellipsoid((26, 6, -11), (11, 11, 8)), 1)
    eyes, pupils = mirrored(sphere((25, 12, 3), 6.5), 1), mirrored(sphere((29, 11.5, 3), 4.4), 1)
    glints = mirrored(sphere((31.2, 9.6, 5.8), 1.9), 1)
    forehead = [
        (moved(box((14, y, 24), (26, 3.5, 12), 1), center, turn), stripe) for y in (-8.0, 0.0, 8.0)
    ]
    coat = painted(
        orange,
        *stripes,
        (ellipsoid((6, 44, 36), (16, 16, 20)), WHITE),
        (half_space((0, 0, 12), (0, 0, 1)), WHITE),
        *rings,
        (sphere((-20, -53, 92), 12), WHITE),
        (moved(sphere((0, 0, 4), 36), center, turn), orange),
        *forehead,
        (moved(inner_ears, center, turn), (0.92, 0.62, 0.58)),
        (moved(muzzle, center, turn), WHITE),
        (moved(eyes, center, turn), (0.42, 0.62, 0.22)),
        (moved(pupils, center, turn), BLACK),
        (moved(glints, center, turn), WHITE),
        (moved(ellipsoid((32, 0, -5.5), (4, 4, 3)), center, turn), (0.85, 0.35, 0.38)),
        (moved(box((31, 0, -13), (6, 1.3, 9)), center, turn), stripe),
        (torus((2, 27, 54), (0.1, 0.5, 1), 17, 4.3), (0.12, 0.25, 0.65)),
        (sphere((14, 42, 48), 5.8), (0.95, 0.80, 0.20)),
    )
    bounds = np.array([(-50, -75, -5), (50, 75, 130)], dtype=float)
    return Solid(shape, coat, bounds, edge_length=2.3, specular=0.2, shininess=0.3)


def duck() -> Solid:
    """A bath duck that faces +x."""
    floor = half_space((0, 0, 2), (0, 0, -1))
    body = union(
        ellipsoid((-2, 0, 25), (46, 36, 25)),
        ellipsoid((16, 0, 30), (28, 29, 24)),
        capsule((-34, 0, 32), (-48, 0, 50), 13, 4),
        smooth=10,
    )
    wings = mirrored(
        union(
            moved(ellipsoid((0, 0, 0), (23, 8, 13)), (-5, 32, 31), (-12, 12, 8)),
            moved(ellipsoid((0, 0, 0), (9, 5, 7)), (-27, 31, 37), (-12, 25, 8)),
            smooth=4,
        ),
        1,
    )
    head = union(sphere((19, 0, 62), 23), capsule((14, 0, 83), (5, 0, 87), 4, 2.5), smooth=5)
    beak = union(
        moved(ellipsoid((0, 0, 0), (15, 15, 5)), (42, 0, 59), (0, -12, 0)),
        moved(ellipsoid((0, 0, 0), (11, 11, 4)), (40, 0, 52), (0, 10, 0)),
        smooth=1,
    )
    plumage = union(union(body, wings, smooth=2), head, smooth=6)
    shape = intersect(union(plumage, beak, smooth=2), floor)

    yellow = (0.98, 0.80, 0.10)
    color = painted(
        colored_parts((plumage, yellow), (beak, (0.93, 0.38, 0.06))),
        (mirrored(ellipsoid((36, 12, 70), (8, 6.5, 7.5)), 1), WHITE),
        (mirrored(sphere((38.5, 11, 70), 5), 1), BLACK),
        (mirrored(sphere((40.5, 8.8, 73.0), 1.8), 1), WHITE),
        (mirrored(sphere((49, 4, 65), 1.8), 1), (0.55, 0.18, 0.03)),
        (mirrored(box((-18, 42, 29), (22, 20, 2.4), 0.5), 1), (0.80, 0.50, 0.03)),
        (mirrored(box((-14, 42, 36), (22, 20, 2.4), 0.5), 1), (0.80, 0.50, 0.03)),
    )
    bounds = np.array([(-62, -48, -5), (65, 48, 98)], dtype=float)
    return Solid(shape, color, bounds, edge_length=2.2, specular=0.4, shininess=0.5)
