"""Test and validation sets of the comparative study.

Every scene samples its textures, arrangement and camera path from the set's seed and the scene's
number, so sets of different seeds share only the objects. The shipped weights were trained on the
seeds 3, 7001 and 8001.
"""

from dataclasses import replace
from pathlib import Path

from ...core.errors import InputError
from ..datagen.generate import GenerateConfig, generate

LMO_OBJECTS = ("ape", "can", "cat", "driller", "duck", "eggbox", "glue", "holepuncher")
"""The objects of LM-O, all of them in every scene of the Occlusion-style test."""

_LINEMOD = GenerateConfig(
    out=Path("linemod"),
    scenes=26 * 13,
    views=26,
    scene="linemod",
    sampling="hand-held",
    references=4,
    split="test",
    seed=8003,
    depth=True,
    depth_noise=True,
    masks=False,
    jpeg_quality=95,
    annotations="basic",
)

_OCCLUSION = replace(
    _LINEMOD,
    out=Path("occlusion"),
    scenes=40,
    views=31,
    objects=LMO_OBJECTS,
    scene="heap",
    references=3,
    seed=8002,
)

TEST_SETS = {
    "linemod": _LINEMOD,
    "occlusion": _OCCLUSION,
    "linemod-validation": replace(
        _LINEMOD, out=Path("linemod-validation"), scenes=4 * 13, seed=9001
    ),
    "occlusion-validation": replace(
        _OCCLUSION, out=Path("occlusion-validation"), scenes=8, seed=9002
    ),
}
"""The two test sets by name, and a validation set like each.

LineMOD-style: each of 13 objects is the target of 26 sequences in light clutter, 4 reference views
each. Occlusion-style: 40 sequences of 3 reference views of dense clutter of LM-O's 8 objects, all
upright; those with a visible fraction >= 0.1 are targets. Second views follow 1, 5 and 10 frames
after the reference view. Depth is that of a simulated Kinect."""


def ensure_test_set(name: str, root: Path, quick: bool = False, workers: int = 2) -> Path:
    """Renders missing scenes of a test or validation set.

    Args:
        name: one of :data:`TEST_SETS`.
        root: parent folder of the set.
        quick: only a few sequences, as a smoke test.
        workers: number of rendering processes.

    Returns:
        The folder of the BOP dataset; its split is "test".

    Raises:
        InputError: if the set is unknown, or its folder has other settings.
    """
    if name not in TEST_SETS:
        raise InputError(f"test set must be one of {', '.join(TEST_SETS)}, got {name!r}")
    config = replace(TEST_SETS[name], out=Path(root) / TEST_SETS[name].out, workers=workers)
    if quick:
        config = replace(
            config,
            out=config.out.with_name(f"{name}-quick"),
            scenes=1 if config.scene == "heap" else 3,
            views=1 + max(config.gaps),
            references=1,
        )
    generate(config)
    return config.out
