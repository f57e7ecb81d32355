"""Six household objects as solids, in millimeters, standing on z = 0.

Like LineMOD's, they have large plain surfaces in few colors. Their sizes are met exactly when
they are meshed; here they only have the right proportions.
"""

from __future__ import annotations

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
    moved,
    painted,
    prism,
    sphere,
    subtract,
    torus,
    union,
)

BLACK = (0.07, 0.07, 0.08)
WHITE = (0.93, 0.92, 0.89)
SILVER = (0.66, 0.68, 0.70)
RED = (0.72, 0.11, 0.12)
YELLOW = (0.93, 0.74, 0.16)


def can() -> Solid:
    """A watering can: spout towards +y, handle arching over the opening."""
    axis = -41.0
    body = cylinder((0, axis, 0), (0, axis, 128), 50, 46, rounding=7)
    opening = cylinder((0, axis, 116), (0, axis, 140), 38)
    handle = intersect(
        torus((0, axis, 138), (1, 0, 0), 47, 6.5), half_space((0, 0, 122), (0, 0, -1))
    )
    spout = capsule((0, 0, 30), (0, 72, 80), 13, 8)
    rose = cylinder((0, 66, 76), (0, 84, 90), 8, 21, rounding=2)
    band = intersect(
        half_space((0, 0, 34), (0, 0, 1)), half_space((0, 0, 22), (0, 0, -1)), _grown(body, 1)
    )
    label = ellipsoid((50, axis, 78), (14, 24, 24))
    dot = ellipsoid((50, axis, 78), (14, 10, 10))
    parts = colored_parts(
        (body, RED),
        (handle, (0.24, 0.30, 0.18)),
        (spout, RED),
        (rose, YELLOW),
        (cylinder((0, axis, 116), (0, axis, 140), 38), (0.35, 0.05, 0.06)),
    )
    return Solid(
        sdf=union(
            subtract(body, opening),
            intersect(handle, _grown(opening, -2.5, outside=True)),
            union(spout, rose, smooth=4),
            smooth=5,
        ),
        color=painted(parts, (band, WHITE), (label, WHITE), (dot, YELLOW)),
        bounds=np.array([[-60, -105, -8], [60, 110, 205]]),
        edge_length=3.2,
        faces=2600,
        specular=0.35,
        shininess=0.5,
    )


def cam() -> Solid:
    """A reflex camera: lens towards +y, grip on -x, viewfinder on top."""
    body = box((0, -40, 37), (136, 58, 74), rounding=9)
    grip = capsule((-56, -26, 12), (-56, -26, 66), 17)
    hump = prism([(-24, 62), (24, 62), (13, 88), (-13, 88)], 1, -66, -14, rounding=5)
    eyepiece = box((0, -68, 80), (26, 12, 16), rounding=3)
    dial = cylinder((44, -42, 70), (44, -42, 84), 13, rounding=2)
    button = cylinder((-52, -30, 70), (-52, -30, 81), 8, rounding=2)
    barrel = cylinder((6, -14, 38), (6, 66, 38), 35, 32, rounding=2)
    ring = cylinder((6, 6, 38), (6, 22, 38), 37.5, rounding=2)
    hood = cylinder((6, 52, 38), (6, 70, 38), 35.5, rounding=2)
    bowl = sphere((6, 88, 38), 33)
    plate = intersect(_grown(body, 1), half_space((0, 0, 56), (0, 0, -1)))
    window = box((48, -12, 50), (24, 12, 12))
    stripe = box((24, -12, 15), (12, 90, 8))
    screen = box((4, -69, 36), (62, 4, 40))
    leather = (0.15, 0.13, 0.12)
    parts = colored_parts(
        (body, leather),
        (grip, leather),
        (hump, SILVER),
        (eyepiece, BLACK),
        (dial, BLACK),
        (button, RED),
        (barrel, (0.24, 0.24, 0.26)),
        (ring, SILVER),
        (hood, BLACK),
        (bowl, (0.20, 0.30, 0.52)),
    )
    solid = union(
        union(body, grip, smooth=8),
        hump,
        eyepiece,
        dial,
        button,
        subtract(union(barrel, ring, hood), bowl),
        smooth=1.5,
    )
    off_lens = _grown(barrel, 3, outside=True)
    return Solid(
        sdf=intersect(solid, half_space((0, 0, 1.5), (0, 0, -1))),
        color=painted(
            parts,
            (intersect(plate, off_lens, _grown(dial, 1, True), _grown(button, 1, True)), SILVER),
            (intersect(window, off_lens), (0.85, 0.88, 0.80)),
            (intersect(stripe, off_lens, half_space((0, -16, 0), (0, -1, 0))), RED),
            (screen, (0.22, 0.30, 0.34)),
        ),
        bounds=np.array([[-85, -85, -8], [85, 85, 100]]),
        edge_length=2.6,
        faces=3000,
        specular=0.4,
        shininess=0.5,
    )


def eggbox() -> Solid:
    """A box of six eggs, equal to itself after half a turn about z."""
    pulp = (0.70, 0.66, 0.58)
    plan = box((0, 0, 30), (150, 107, 400), rounding=34)
    rim = intersect(box((0, 0, 35), (150, 107, 9), rounding=2), plan)
    cups = union(
        *(
            cylinder((x, y, 0), (x, y, 36), 15.5, 23, rounding=3)
            for x in (-46, 0, 46)
            for y in (-25, 25)
        ),
        smooth=3,
    )
    core = box((0, 0, 28), (112, 66, 26), rounding=8)
    domes = union(
        *(ellipsoid((x, y, 40), (24, 26, 27)) for x in (-43, 0, 43) for y in (-22, 22)), smooth=10
    )
    top = intersect(
        union(domes, box((0, 0, 50), (92, 58, 30), rounding=8), smooth=8),
        half_space((0, 0, 69), (0, 0, 1)),
        smooth=3,
    )
    label = box((0, 0, 69), (66, 36, 24))
    inner = box((0, 0, 69), (58, 28, 24))
    egg = ellipsoid((0, 0, 66), (14, 9, 16))
    return Solid(
        sdf=union(rim, cups, core, top, smooth=3),
        color=painted(
            colored_parts((rim, (0.60, 0.56, 0.49)), (cups, pulp), (core, pulp), (top, pulp)),
            (label, WHITE),
            (inner, (0.16, 0.42, 0.24)),
            (egg, YELLOW),
        ),
        bounds=np.array([[-84, -62, -8], [84, 62, 80]]),
        edge_length=2.6,
        faces=3000,
        specular=0.05,
        shininess=0.1,
    )


def glue() -> Solid:
    """A flat bottle with a nozzle, equal to itself after half a turn about z."""
    body = intersect(
        box((0, 0, 52), (36.7, 78, 150), rounding=17.5),
        box((0, 0, 59), (36.7, 78, 118), rounding=4),
    )
    shoulder = ellipsoid((0, 0, 108), (15, 31, 22))
    neck = cylinder((0, 0, 110), (0, 0, 138), 12)
    cap = union(
        cylinder((0, 0, 130), (0, 0, 146), 15, rounding=2),
        cylinder((0, 0, 143), (0, 0, 173), 11, 5.5, rounding=2),
        smooth=2,
    )
    label = _slab(26, 96)
    stripe = _slab(52, 66)
    border = union(_slab(24, 28), _slab(94, 98))
    blob = union(ellipsoid((18, 0, 80), (8, 16, 9)), ellipsoid((-18, 0, 80), (8, 16, 9)))
    return Solid(
        sdf=union(body, shoulder, neck, cap, smooth=3),
        color=painted(
            colored_parts((body, WHITE), (shoulder, WHITE), (neck, WHITE), (cap, RED)),
            (label, (0.13, 0.24, 0.50)),
            (stripe, YELLOW),
            (border, RED),
            (blob, WHITE),
        ),
        bounds=np.array([[-26, -46, -8], [26, 46, 182]]),
        edge_length=2.2,
        faces=2400,
        specular=0.4,
        shininess=0.6,
    )


def lamp() -> Solid:
    """A desk lamp: round foot, bent arm, shade that looks down towards +x."""
    foot = cylinder((-40, 0, 0), (-40, 0, 24), 59, 54, rounding=4)
    knob = cylinder((-14, -26, 20), (-14, -26, 34), 10, rounding=2)
    socket = cylinder((-62, 0, 20), (-62, 0, 38), 15, 10, rounding=2)
    arm = union(
        capsule((-62, 0, 26), (-84, 0, 118), 6.5), capsule((-84, 0, 118), (42, 0, 196), 6.5)
    )
    elbow = cylinder((-84, -13, 118), (-84, 13, 118), 13, rounding=2)
    inside_out = (cylinder((66, 0, 211), (70, 0, 135), 21, 38, rounding=2),)
    hollow = cylinder((68, 0, 184), (70.5, 0, 127), 20, 33.5)
    collar = cylinder((34, 0, 197), (58, 0, 197), 11, 13, rounding=2)
    bulb = union(sphere((70, 0, 152), 17), cylinder((68, 0, 188), (70, 0, 152), 10), smooth=4)
    shade = subtract(*inside_out, hollow)
    green, dark = (0.10, 0.36, 0.33), (0.16, 0.17, 0.18)
    return Solid(
        sdf=union(
            union(foot, socket, knob, smooth=3),
            union(arm, elbow, smooth=2),
            union(shade, bulb, collar),
            smooth=1.5,
        ),
        color=colored_parts(
            (foot, green),
            (socket, dark),
            (knob, RED),
            (arm, SILVER),
            (elbow, dark),
            (inside_out[0], green),
            (hollow, WHITE),
            (collar, dark),
            (bulb, (0.97, 0.90, 0.62)),
        ),
        bounds=np.array([[-112, -70, -8], [122, 70, 235]]),
        edge_length=3.0,
        faces=3000,
        specular=0.35,
        shininess=0.5,
    )


def phone() -> Solid:
    """A desk telephone: keys on the slope towards +y, the handset standing behind them."""
    base = prism([(-66, 7), (67, 7), (67, 16), (12, 48), (-66, 52)], 0, -46, 46, rounding=7)
    bar = box((0, -46, 112), (40, 24, 132), rounding=10)
    ear = union(
        cylinder((0, -44, 160), (0, -18, 160), 24, 21, rounding=4),
        cylinder((0, -44, 74), (0, -18, 74), 24, 21, rounding=4),
    )
    handset = moved(union(bar, ear, smooth=6), (0, 18, 5), (3, 0, 0))
    antenna = capsule((34, -42, 45), (34, -46, 112), 6, 5)

    def on_slope(x: float, along: float, width: float, length: float, height: float) -> Sdf:
        """A box lying on the slope, ``along`` from its middle upwards."""
        key = box((x, -along, 0), (width, length, height), rounding=1)
        return moved(key, (0, 43, 38), (-30.2, 0, 0))

    panel = on_slope(0, 0, 74, 56, 16)
    keys = union(
        *(on_slope(x, along, 15, 8.5, 24) for x in (-24, -3, 18) for along in (-21, -9, 3))
    )
    display = on_slope(-3, 19, 58, 12, 24)
    redial = on_slope(33.5, -9, 6, 32, 24)
    ivory, dark = (0.80, 0.74, 0.60), (0.22, 0.19, 0.18)
    parts = colored_parts((base, ivory), (handset, dark), (antenna, BLACK))
    return Solid(
        sdf=union(base, handset, antenna, smooth=3),
        color=painted(
            parts,
            (intersect(panel, half_space((0, 6, 0), (0, -1, 0))), (0.36, 0.33, 0.30)),
            (keys, WHITE),
            (display, (0.55, 0.68, 0.50)),
            (redial, RED),
        ),
        bounds=np.array([[-58, -86, -8], [58, 86, 205]]),
        edge_length=2.8,
        faces=3000,
        specular=0.3,
        shininess=0.4,
    )


def _grown(sdf: Sdf, by: float, outside: bool = False) -> Sdf:
    """A shape thickened by a distance, or all that lies outside of that."""
    sign = -1.0 if outside else 1.0
    return lambda p: sign * (sdf(p) - by)


def _slab(low: float, high: float) -> Sdf:
    """All between two heights."""
    return lambda p: np.abs(p[:, 2] - (low + high) / 2) - (high - low) / 2
