"""Chooses the pairs that the study draws and times."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import read_depth
from ..evaluation.evaluate_pairs import Estimator, read_views
from ..methods import METHOD_TABLE
from .activations import plot_activations
from .cost import BATCH
from .images import Example, draw_example
from .measure import StudySet
from .plan import BEST_GAP, Run, Work, choose_pairs


def draw_gallery(
    tests: Sequence[StudySet],
    estimators: Mapping[str, Estimator],
    objects: Mapping[str, ObjectModel],
    folder: Path,
    *,
    count: int,
    seed: int,
) -> None:
    """Draws Figures 5 and 6 for ``count`` random pairs of each test, in place of older ones."""
    for old in folder.glob("*.png"):
        old.unlink()
    rng = np.random.default_rng(seed)
    number = 0
    for test in tests:
        work = at_best_gap(test, objects)
        for chosen in rng.permutation(len(work))[:count]:
            number += 1
            example, depth = make_example(test, work[chosen], estimators, objects)
            draw_example(example, folder / f"example_{number}.png")
            plot_activations(example, estimators, depth, folder / f"insides_{number}.png")


def make_example(
    test: StudySet,
    work: Work,
    estimators: Mapping[str, Estimator],
    objects: Mapping[str, ObjectModel],
) -> tuple[Example, np.ndarray | None]:
    """Runs every method on one pair; returns the example and the reference's depth map."""
    pair, name = work
    model = objects[name]
    reference = test.dataset.scene(pair.scene_id)[pair.ref_image_id]
    truth = reference.annotation(model.obj_id)
    if truth is None:
        place = f"scene {pair.scene_id}, image {pair.ref_image_id} of {test.name}"
        raise InputError(f"{name} is not in {place}")
    title = (
        f"{name}, {test.name} test, sequence {pair.scene_id}, frames {pair.ref_image_id} "
        f"and {pair.second_image_id}, {100 * truth.visibility:.0f} % visible"
    )
    first, second = make_views(test, work, "mid")
    answers = {m: e.estimate(make_views(test, work, m), name) for m, e in estimators.items()}
    example = Example(title, model, first, second, truth.T_cam_obj, answers)
    return example, None if reference.depth_path is None else read_depth(reference)


def make_views(test: StudySet, work: Work, method: str) -> list[View]:
    """Reads the input of a method: one view or two, and depth if the method uses it."""
    pair, _ = work
    scene = test.dataset.scene(pair.scene_id)
    images = [scene[pair.ref_image_id], scene[pair.second_image_id]]
    row = METHOD_TABLE[method]
    return read_views(images[: row.views], pair.T_second_ref, depth=row.needs_depth)


def at_best_gap(test: StudySet, objects: Mapping[str, ObjectModel]) -> list[Work]:
    """Returns the pairs of a test with the widest gap; raises InputError if there are none."""
    work = choose_pairs(Run("main", test.name, "mid", gaps=(BEST_GAP,)), test.pairs, objects)
    if not work:
        raise InputError(f"the {test.name} test has no pair of gap {BEST_GAP}")
    return work


def timed_pairs(
    test: StudySet, objects: Mapping[str, ObjectModel]
) -> list[Callable[[str], tuple[list[View], str]]]:
    """Returns pairs to time, spread over the test: each reads a method's views and target."""
    work = at_best_gap(test, objects)
    indices = np.linspace(0, len(work) - 1, min(len(work), BATCH)).astype(int)
    return [lambda m, w=work[i]: (make_views(test, w, m), w[1]) for i in indices]  # type: ignore[misc]
