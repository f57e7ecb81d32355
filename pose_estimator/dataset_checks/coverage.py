"""What `check-data` checked, and what it could not check because the dataset does not have it."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..bop.scene import Scene

NEEDS: Mapping[str, str] = {
    "poses (scene_gt.json)": "evaluate and train-estimator need them",
    "masks (mask_visib)": "poses are compared with boxes alone, and train-estimator needs masks",
    "boxes and visible fractions (scene_gt_info.json)": "they are computed from masks; without "
    "masks too, every object counts as visible",
    "depth maps (depth)": "only rgbd and training its stage points need them",
}
"""Optional part of a scene -> what it is needed for."""


@dataclass
class Coverage:
    """Counts what was checked.

    Attributes:
        objects: number of models.
        scenes: split -> number of readable scenes.
        annotations: number of poses.
        images: number of images checked.
        projections: number of projections compared.
        skipped: number of scenes with mostly wrong poses, whose cameras and pairs are not checked.
        lacking: (part of `NEEDS`, split) -> number of scenes without it.
    """

    objects: int = 0
    scenes: Counter[str] = field(default_factory=Counter)
    annotations: int = 0
    images: int = 0
    projections: int = 0
    skipped: int = 0
    lacking: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add(self, scene: Scene) -> None:
        """Counts a readable scene and the optional parts that it lacks."""
        split, rows = scene.folder.parent.name, scene.annotations
        self.scenes[split] += 1
        self.annotations += len(rows.obj_id)
        there = (
            scene.gt_path.is_file(), (scene.folder / "mask_visib").is_dir(), rows.has_info,
            bool(scene.depths),
        )  # fmt: skip
        # Without poses there is nothing that masks and boxes could belong to.
        for part, has in zip(NEEDS, there, strict=True):
            if not has and (there[0] or part != "masks (mask_visib)"):
                self.lacking[part, split] += 1

    def notes(self) -> list[str]:
        """Returns one sentence for each part that was not checked."""
        notes = []
        if self.skipped:
            notes.append(
                f"camera poses and pairs of {counted(self.skipped, 'scene')} were not checked: "
                "most object poses are wrong. Correct these first, and check again"
            )
        if self.annotations and not self.projections:
            notes.append(
                "no pose was compared with an image: that needs models, and masks or boxes. Units, "
                "axes, camera matrices and annotations may be wrong"
            )
        for part, need in NEEDS.items():
            counts = [
                f"{number} of {counted(self.scenes[split], 'scene')} of {split}"
                for (lacking, split), number in self.lacking.items()
                if lacking == part
            ]
            if counts:
                notes.append(f"no {part} in {', '.join(counts)}; {need}")
        return notes

    def records(self) -> list[dict[str, Any]]:
        """Returns records of a results file: the counts, and what was not checked."""
        counts = {"images_checked": self.images, "projections_compared": self.projections}
        return [
            *({"metric": name, "value": value, "unit": "1"} for name, value in counts.items()),
            *(
                {"metric": "not_checked", "value": 1, "unit": "1", "problem": note}
                for note in self.notes()
            ),
        ]

    def __str__(self) -> str:
        """The counts in one line."""
        scenes = self.scenes.total()
        return (
            f"{counted(self.objects, 'object')}, {counted(scenes, 'scene')}; checked "
            f"{counted(self.images, 'image')}, compared {counted(self.projections, 'projection')}"
        )


def counted(number: int, noun: str) -> str:
    """Returns number and noun, such as "1 scene" and "2 scenes"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
