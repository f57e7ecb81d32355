"""Bench vise, driller, hole puncher and iron: after LineMOD's, in millimeters, on z = 0."""

from __future__ import annotations

import numpy as np

from .solids import (
    Solid,
    box,
    capsule,
    colored_parts,
    cylinder,
    half_space,
    intersect,
    mirrored,
    moved,
    painted,
    prism,
    sphere,
    subtract,
    torus,
    union,
)

BLACK, WHITE = (0.07, 0.07, 0.08), (0.93, 0.93, 0.90)
STEEL, RED, YELLOW = (0.66, 0.67, 0.69), (0.80, 0.10, 0.08), (0.95, 0.78, 0.10)


def benchvise() -> Solid:
    """A bench vise whose screw comes out along +x; its base has three bolt lugs."""
    base = cylinder((-12, 0, 0), (-12, 0, 16), 50, 47, rounding=3)
    lugs = union(
        *(
            cylinder(
                (-12 + 47 * np.cos(a), 47 * np.sin(a), 0),
                (-12 + 47 * np.cos(a), 47 * np.sin(a), 12),
                14,
                rounding=2,
            )
            for a in np.radians([90.0, 200.0, 340.0])
        )
    )
    bolts = [
        (sphere((-12 + 47 * np.cos(a), 47 * np.sin(a), 14), 7), STEEL)
        for a in np.radians([90.0, 200.0, 340.0])
    ]
    pedestal = cylinder((-12, 0, 12), (-12, 0, 105), 36, 26)
    fixed = prism(
        [(-104, 128), (-104, 154), (-60, 158), (-40, 200), (-6, 214), (2, 214), (2, 98), (-55, 98)],
        axis=1,
        low=-30,
        high=30,
        rounding=4,
    )
    anvil = box((-80, 0, 150), (54, 50, 18), 3)
    slide = box((28, 0, 122), (110, 36, 40), 3)
    sliding = prism(
        [(28, 214), (36, 214), (62, 192), (74, 140), (74, 98), (28, 98)],
        axis=1,
        low=-30,
        high=30,
        rounding=4,
    )
    jaws = union(box((3, 0, 198), (10, 74, 36), 1), box((27, 0, 198), (10, 74, 36), 1))
    screw = cylinder((60, 0, 119), (104, 0, 119), 11, rounding=2)
    nut = cylinder((86, 0, 119), (109, 0, 119), 16, rounding=3)
    bar = capsule((98, -48, 103), (98, 48, 135), 5)
    knobs = union(sphere((98, -50, 102), 10), sphere((98, 50, 136), 10))
    cast = union(union(base, lugs, smooth=4), pedestal, fixed, anvil, sliding, smooth=8)
    steel = union(slide, jaws, screw, nut, bar)
    shape = union(cast, steel, knobs, smooth=1.5)

    blue, dark = (0.10, 0.26, 0.52), (0.30, 0.31, 0.33)
    grooves = [(box((15, 0, z), (40, 90, 2.0)), dark) for z in (188.0, 196.0, 204.0)]
    color = painted(
        colored_parts((cast, blue), (steel, STEEL), (knobs, RED)),
        *bolts,
        *[(intersect(jaws, groove), paint) for groove, paint in grooves],
        (box((-80, 0, 162), (60, 60, 12)), STEEL),
        (box((-40, 32, 138), (46, 12, 24), 1), YELLOW),
        (box((-40, 32, 143), (38, 12, 4)), BLACK),
        (box((-46, 32, 134), (26, 12, 4)), BLACK),
        (box((52, -32, 150), (18, 12, 34), 1), WHITE),
        (box((52, -32, 158), (12, 12, 10)), RED),
        (torus((-12, 0, 40), (0, 0, 1), 34, 4.0), dark),
    )
    bounds = np.array([(-118, -72, -6), (120, 72, 228)], dtype=float)
    return Solid(shape, color, bounds, edge_length=4.0, specular=0.5, shininess=0.5)


def driller() -> Solid:
    """A cordless drill that stands on its battery and points along +x."""
    motor = union(
        cylinder((-108, 0, 172), (24, 0, 172), 33, 31, rounding=9),
        box((-40, 0, 160), (110, 50, 50), 12),
        smooth=6,
    )
    collar = cylinder((18, 0, 172), (52, 0, 172), 28, 25, rounding=2)
    chuck = union(
        cylinder((48, 0, 172), (84, 0, 172), 22, rounding=2),
        cylinder((80, 0, 172), (108, 0, 172), 21, 11, rounding=2),
    )
    bit = cylinder((100, 0, 172), (119, 0, 172), 5, rounding=1)
    grip = prism(
        [(-62, 155), (-18, 155), (-22, 120), (-26, 60), (-22, 40), (-70, 40), (-64, 90)],
        axis=1,
        low=-19,
        high=19,
        rounding=7,
    )
    trigger = box((-14, 0, 130), (18, 20, 34), 5)
    battery = prism(
        [(-72, 6), (-72, 38), (-64, 46), (24, 46), (32, 32), (32, 6)],
        axis=1,
        low=-37,
        high=37,
        rounding=6,
    )
    switch = box((-55, 0, 202), (26, 20, 12), 3)
    green_parts = union(motor, grip, smooth=8)
    shape = union(
        union(green_parts, battery, smooth=4), collar, chuck, bit, trigger, switch, smooth=1.5
    )

    green, dark, pale = (0.06, 0.42, 0.34), (0.16, 0.17, 0.18), (0.55, 0.57, 0.58)
    vents = [
        (mirrored(box((x, 34, 172), (4, 24, 30), 1), 1), dark) for x in (-96.0, -87.0, -78.0, -69.0)
    ]
    flutes = [
        (moved(box((66, 23, 0), (26, 8, 5)), (0, 0, 172), (angle, 0, 0)), dark)
        for angle in range(0, 360, 45)
    ]
    marks = [
        (moved(box((36, 27, 0), (12, 8, 2.5)), (0, 0, 172), (angle, 0, 0)), WHITE)
        for angle in range(15, 375, 30)
    ]
    color = painted(
        colored_parts(
            (motor, green),
            (grip, dark),
            (battery, dark),
            (collar, dark),
            (chuck, pale),
            (bit, STEEL),
            (trigger, RED),
            (switch, RED),
        ),
        (box((-46, 0, 103), (28, 60, 56), 8), (0.30, 0.31, 0.33)),
        *vents,
        *flutes,
        *marks,
        (box((-28, 36, 174), (62, 24, 22), 2), WHITE),
        (box((-34, 36, 177), (42, 24, 8), 1), RED),
        (box((-24, 36, 167), (50, 24, 3)), dark),
        (box((-28, -36, 174), (70, 24, 10), 2), YELLOW),
        (box((-21, 40, 26), (60, 20, 20), 2), YELLOW),
        (box((-21, 40, 26), (44, 20, 7)), BLACK),
        (box((-21, -40, 26), (80, 20, 7), 2), green),
        (box((37, 0, 22), (16, 44, 12), 2), RED),
    )
    bounds = np.array([(-118, -46, -6), (128, 46, 222)], dtype=float)
    return Solid(shape, color, bounds, edge_length=3.8, specular=0.3, shininess=0.4)


def holepuncher() -> Solid:
    """An office hole punch that opens towards +x; the paper goes in between base and cheeks."""
    base = prism(
        [(47, 30), (34, 51), (-34, 51), (-47, 38), (-47, -38), (-34, -51), (34, -51), (47, -30)],
        axis=2,
        low=0,
        high=10,
        rounding=3,
    )
    cheeks = mirrored(
        prism(
            [(-38, 8), (-38, 50), (-10, 58), (8, 46), (8, 26), (-6, 20), (-6, 8)],
            axis=1,
            low=30,
            high=40,
            rounding=1.5,
        ),
        1,
    )
    back = box((-31, 0, 26), (10, 78, 44), 2)
    plate = prism(
        [(-48, -45), (8, -45), (38, -38), (48, -24), (48, 24), (38, 38), (8, 45), (-48, 45)],
        axis=2,
        low=-6.5,
        high=6.5,
        rounding=3,
    )
    tilt = ((2, 0, 68), (0, -20, 0))
    lever = moved(subtract(plate, box((14, 0, 0), (14, 40, 40), 5), smooth=2), *tilt)
    skirt = moved(mirrored(box((-18, 43, -10), (48, 7, 20), 2), 1), *tilt)
    pins = mirrored(cylinder((-4, 35, 8), (-4, 35, 60), 5), 1)
    hinge = cylinder((-27, -50, 47), (-27, 50, 47), 6, rounding=1)
    handle = union(lever, skirt, smooth=3)
    shape = union(base, cheeks, back, handle, pins, hinge, smooth=2)

    blue, dark = (0.10, 0.22, 0.60), (0.13, 0.13, 0.15)
    label = moved(box((-24, 20, 7), (26, 34, 8), 1), *tilt)
    print_lines = [(moved(box((x, 20, 7), (3, 26, 8)), *tilt), dark) for x in (-31.0, -24.0, -17.0)]
    logo = moved(cylinder((-24, -24, 0), (-24, -24, 12), 9), *tilt)
    grip = moved(box((45, 0, 7), (16, 120, 14)), *tilt)
    ruler = [
        (box((44, y, 10), (8 if i % 2 else 14, 1.8, 4)), WHITE)
        for i, y in enumerate(np.arange(-45.0, 46.0, 10.0))
    ]
    color = painted(
        colored_parts(
            (base, dark),
            (cheeks, STEEL),
            (back, STEEL),
            (handle, blue),
            (pins, STEEL),
            (hinge, STEEL),
        ),
        (grip, dark),
        (label, WHITE),
        *print_lines,
        (logo, RED),
        *ruler,
    )
    bounds = np.array([(-62, -64, -6), (64, 64, 104)], dtype=float)
    return Solid(shape, color, bounds, edge_length=2.8, specular=0.4, shininess=0.4)


def iron() -> Solid:
    """A steam iron on its sole plate, tip towards +x, the cord leaving it at the back."""
    sole_outline = [
        (124, 0),
        (110, 16),
        (84, 32),
        (44, 46),
        (0, 53),
        (-60, 55),
        (-108, 52),
        (-118, 40),
        (-118, -40),
        (-108, -52),
        (-60, -55),
        (0, -53),
        (44, -46),
        (84, -32),
        (110, -16),
    ]
    sole = prism(sole_outline, axis=2, low=0, high=12, rounding=3)
    waist = [(0.93 * x - 2, 0.86 * y) for x, y in sole_outline]
    body = intersect(
        prism(waist, axis=2, low=8, high=90, rounding=8),
        half_space((112, 0, 12), (0.60, 0, 0.80)),
        mirrored(half_space((0, 46, 12), (0, 0.94, 0.34)), 1),
        smooth=12,
    )
    handle = union(
        capsule((-92, 0, 62), (-98, 0, 118), 17, 16),
        capsule((-98, 0, 120), (-20, 0, 127), 15, 14),
        capsule((-20, 0, 127), (34, 0, 112), 14, 15),
        capsule((34, 0, 112), (50, 0, 56), 15, 20),
        smooth=10,
    )
    dial = cylinder((-22, 0, 70), (-22, 0, 84), 22, 20, rounding=2)
    buttons = union(
        cylinder((22, 7, 118), (27, 7, 134), 6, rounding=2),
        cylinder((22, -7, 118), (27, -7, 134), 6, rounding=2),
    )
    nozzle = cylinder((66, 0, 50), (88, 0, 46), 9, 6, rounding=1)
    cord = union(
        capsule((-104, 10, 108), (-119, 24, 108), 8, 6),
        capsule((-119, 24, 108), (-121, 36, 96), 6, 5),
        smooth=2,
    )
    shell = union(body, handle, smooth=12)
    shape = union(shell, sole, dial, buttons, nozzle, cord, smooth=2)

    violet, pale, dark = (0.30, 0.22, 0.62), (0.90, 0.91, 0.93), (0.14, 0.14, 0.17)
    tank = intersect(half_space((10, 0, 0), (-1, 0, 0)), half_space((0, 0, 60), (0, 0, 1)))
    color = painted(
        colored_parts(
            (handle, violet),
            (intersect(body, tank), (0.42, 0.68, 0.88)),
            (body, pale),
            (sole, STEEL),
            (dial, dark),
            (buttons, YELLOW),
            (nozzle, dark),
            (cord, dark),
        ),
        (half_space((0, 0, 12.4), (0, 0, 1)), STEEL),
        (intersect(half_space((0, 0, 20), (0, 0, 1)), half_space((0, 0, 13), (0, 0, -1))), violet),
        (capsule((-86, 0, 136), (-30, 0, 141), 8), dark),
        (box((-60, 44, 40), (54, 30, 18), 2), WHITE),
        (box((-66, 44, 43), (34, 30, 6)), RED),
        (box((-60, 44, 35), (44, 30, 3)), dark),
        (box((-60, -44, 40), (70, 30, 10), 2), violet),
        (box((-14, 0, 86), (14, 4, 8)), RED),
    )
    bounds = np.array([(-138, -66, -6), (138, 66, 152)], dtype=float)
    return Solid(shape, color, bounds, edge_length=4.0, specular=0.4, shininess=0.5)
