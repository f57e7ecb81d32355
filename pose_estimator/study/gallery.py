"""Chooses the pairs that the study draws and times."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import BopPair
from ..evaluation.evaluate_pairs import Estimator, read_views
from ..methods import METHOD_TABLE
from .cost import BATCH
from .images import Example, draw_gaps, draw_poses_of_methods
from .insides import plot_insides
from .measure import StudySet
from .plan import BEST_GAP, GAPS, Run, Work, choose_pairs

GALLERY = 5
"""Examples of each test in Figure 6."""


def draw_gallery(
    tests: Sequence[StudySet],
    estimators: Mapping[str, Estimator],
    objects: Mapping[str, ObjectModel],
    folder: Path,
    *,
    count: int,
    seed: int,
) -> None:
    """Draws Figures 3, 5 and 6 in place of older ones; the pairs are drawn at random.

    ``count`` is the number of pairs of each test in Figure 5; 0 draws nothing.
    """
    for old in folder.glob("*.png"):
        old.unlink()
    if not count:
        return
    rng = np.random.default_rng(seed)
    _draw_gaps(tests[0], folder / "gaps_1.png")
    examples, number = [], 0
    for test in tests:
        work = at_best_gap(test, objects)
        chosen = rng.permutation(len(work))[: max(count, GALLERY)]
        mine = [make_example(test, work[index], estimators, objects) for index in chosen]
        for example in mine[:count]:
            number += 1
            plot_insides(example, estimators, folder / f"fusions_{number}.png")
        examples += mine[:GALLERY]
    draw_poses_of_methods(examples, folder / "poses_1.png")


def _draw_gaps(test: StudySet, path: Path) -> None:
    """Draws the second views of the first reference that has one at every gap."""
    found: dict[tuple[int, int], dict[int, BopPair]] = {}
    for pair in test.pairs:
        assert pair.gap is not None
        seconds = found.setdefault((pair.scene_id, pair.ref_image_id), {})
        seconds.setdefault(pair.gap, pair)
        if set(GAPS) <= set(seconds):
            images = test.dataset.scene(pair.scene_id)
            views = {}
            for gap in GAPS:
                own = seconds[gap]
                shown = [images[own.ref_image_id], images[own.second_image_id]]
                reference, views[gap] = read_views(shown, own.T_second_ref, depth=False)
            draw_gaps(reference, views, path)
            return


def make_example(
    test: StudySet,
    work: Work,
    estimators: Mapping[str, Estimator],
    objects: Mapping[str, ObjectModel],
) -> Example:
    """Runs every method on one pair."""
    pair, name = work
    model = objects[name]
    reference = test.dataset.scene(pair.scene_id)[pair.ref_image_id]
    truth = reference.annotation(model.obj_id)
    if truth is None:
        place = f"scene {pair.scene_id}, image {pair.ref_image_id} of {test.name}"
        raise InputError(f"{name} is not in {place}")
    title = f"{name}\n{test.name}, {100 * truth.visibility:.0f} % seen"
    first, second = make_views(test, work, "mid")
    answers = {m: e.estimate(make_views(test, work, m), name) for m, e in estimators.items()}
    return Example(title, model, first, second, truth.T_cam_obj, answers)


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
