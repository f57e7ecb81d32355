"""Cut-and-paste on training crops: other objects before the target, other backgrounds behind it.

Objects are cut out by their visible masks and pasted, as in PVNet (Peng et al., CVPR 2019, section
4.1) after Dwibedi et al., "Cut, Paste and Learn", ICCV 2017. The target keeps its place in the
crop, so its pose stays what it was; only what is seen of it changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...assets.collage import draw_collage, draw_leaf
from ...core.errors import InputError
from .crops import STORED_SIDE, CropPack

BANK = 384
"""How many crops are kept decoded to be pasted; decoding one again would cost more than pasting."""

_COLLAGE_SIDE = 320
"""Side of drawn backgrounds in pixels: the width of the detector's frames."""

_MIN_SOURCE_VISIBILITY = 0.7
"""Visibility from which a target is whole enough to be cut out."""

_MIN_VISIBLE_SHARE = 0.35
"""Share of the target's visible pixels that an occluder must leave, or it is not pasted."""


@dataclass(frozen=True)
class CutAndPasteConfig:
    """How often crops are changed.

    Attributes:
        occlude: probability that another object is pasted over the crop.
        background: probability that everything but the target is replaced.
        collages: share of the new backgrounds that are drawn (``collage``) instead of cut out.
    """

    occlude: float = 0.0
    background: float = 0.0
    collages: float = 0.0


class CropPaster:
    """Pastes pieces of some targets' crops into the crops of others.

    An occluder is never of the target's own kind, and a background comes from a frame that does not
    show the target: a second instance would have to be found too.

    Args:
        pack: where the crops lie.
        targets: the targets that pieces may be cut from, as indices into the pack.
        config: how often.

    Raises:
        InputError: if nothing of what is asked for can be done: the dataset shows one object alone,
            or every frame shows all objects.
    """

    def __init__(self, pack: CropPack, targets: np.ndarray, config: CutAndPasteConfig):
        self.pack = pack
        self.config = config
        whole = targets[pack.visibility[targets] >= _MIN_SOURCE_VISIBILITY]
        rng = np.random.default_rng(0)
        self.bank = np.sort(rng.choice(whole, min(BANK, len(whole)), replace=False))
        self._pieces: dict[int, np.ndarray] = {}
        drawn = BANK if config.collages > 0 else 0
        self._collages = [draw_collage(rng, _COLLAGE_SIDE) for _ in range(drawn)]
        kinds, frames = pack.object_index[self.bank], pack.frame_index[self.bank]
        numbers = range(len(pack.object_names))
        self._occluders = [self.bank[kinds != number] for number in numbers]
        self._backgrounds = [
            self.bank[~np.isin(frames, pack.frame_index[pack.object_index == number])]
            for number in numbers
        ]
        shown = np.unique(pack.object_index[targets])
        needs: dict[str, list[np.ndarray]] = {}
        if config.occlude:
            needs["a second object to put before one"] = self._occluders
        if config.background and not self._collages:
            needs["a frame that lacks an object to put behind it"] = self._backgrounds
        possible = any(len(pieces[number]) for pieces in needs.values() for number in shown)
        if needs and not possible and not (config.background and self._collages):
            raise InputError(f"cut-and-paste needs {' or '.join(needs)}, and the dataset has none")

    def paste(
        self,
        crop: np.ndarray,
        mask: np.ndarray,
        depth: np.ndarray | None,
        object_index: int,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Changes one crop, or leaves it as it is.

        Args:
            crop: RGB uint8 (S, S, 3), around the target.
            mask: its visible mask, uint8 0 to 255 (S, S).
            depth: meters (S, S), 0 = unknown; or None.
            object_index: which object the target is.
            rng: source of randomness.

        Returns:
            New crop, mask and depth; the depth is unknown where something was pasted.
        """
        backgrounds, occluders = self._backgrounds[object_index], self._occluders[object_index]
        possible = len(backgrounds) or len(self._collages)
        if rng.random() < self.config.background and possible:
            image = self._background(backgrounds, rng)
            crop = blend(_window(image, len(mask), rng), crop, mask)
            depth = None if depth is None else np.where(mask > 127, depth, np.float32(0))
        if rng.random() < self.config.occlude and len(occluders):
            piece = self._piece(int(occluders[rng.integers(len(occluders))]))
            away, towards = rng.uniform(0.15, 0.45), rng.uniform(0, 2 * np.pi)
            place = np.array([0.5 + away * np.cos(towards), 0.5 + away * np.sin(towards)])
            scale, angle = np.exp(rng.uniform(-0.5, 0.2)), rng.uniform(-np.pi, np.pi)
            moved = cv2.warpAffine(
                piece, _paste_matrix(place * len(mask), scale, angle), mask.shape
            )
            over = np.ascontiguousarray(moved[..., 3])
            left = cv2.multiply(mask, 255 - over, scale=1 / 255)
            if cv2.sumElems(left)[0] >= _MIN_VISIBLE_SHARE * cv2.sumElems(mask)[0]:
                crop, mask = blend(crop, np.ascontiguousarray(moved[..., :3]), over), left
                depth = None if depth is None else np.where(over > 0, np.float32(0), depth)
        return crop, mask, depth

    def paste_frame(self, image: np.ndarray, frame: int, rng: np.random.Generator) -> np.ndarray:
        """Puts a drawn background or distractors behind all targets of a whole frame, or leaves it.

        Args:
            image: the frame at the detector's size, RGB uint8 (H, W, 3).
            frame: its number in the pack.
            rng: source of randomness.
        """
        if not self._collages:
            return image
        drawn, distracted = (rng.random() < self.config.background for _ in range(2))
        if not drawn and not distracted:
            return image
        height, width = image.shape[:2]
        low, high = np.searchsorted(self.pack.frame_index, [frame, frame + 1])
        shown = np.zeros((height, width), np.uint8)
        for target in range(low, high):
            back = np.linalg.inv(self.pack.to_stored[target] @ self.pack.frame_to_image[frame])
            mask = cv2.warpAffine(
                self.pack.mask(target), back[:2], (width, height), flags=cv2.INTER_AREA
            )
            np.maximum(shown, mask, out=shown)
        behind = image
        if drawn:
            collage = self._collages[rng.integers(len(self._collages))]
            behind = _window(collage, max(height, width), rng)[:height, :width]
            behind = np.ascontiguousarray(behind)
        if distracted:
            behind = self.add_distractors(behind, rng)
        return blend(behind, image, shown)

    def add_distractors(self, image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Adds distractors that have the colors of objects and not their shapes.

        A detector that has seen none takes a red car for LineMOD's ape.
        """
        height, width = image.shape[:2]
        out = image.copy()
        for _ in range(int(rng.integers(1, 6))):
            piece = self._piece(int(self.bank[rng.integers(len(self.bank))]))
            colors = piece[piece[..., 3] > 200][:, :3]
            center = rng.uniform(0, (width, height))
            radius = np.exp(rng.uniform(np.log(0.03), np.log(0.14))) * width
            for _ in range(int(rng.integers(1, 5)) if len(colors) else 0):
                color = colors[rng.integers(len(colors))] * rng.uniform(0.8, 1.2)
                place = center + rng.normal(0, 0.6 * radius, 2)
                size = radius * rng.uniform(0.3, 1.0)
                draw_leaf(out, rng, size, np.minimum(color, 255).tolist(), place)
        light = cv2.resize(
            rng.uniform(0.7, 1.2, (6, 8)).astype(np.float32), (width, height),
            interpolation=cv2.INTER_LINEAR,
        )  # fmt: skip
        changed = (out != image).any(-1)
        out[changed] = np.clip(out[changed] * light[changed][:, None], 0, 255).astype(np.uint8)
        return out

    def _background(self, backgrounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """What is put behind a target, square: drawn, or one of ``backgrounds``."""
        drawn = self.config.collages > 0 and rng.random() < self.config.collages
        if drawn or not len(backgrounds):
            return self._collages[rng.integers(len(self._collages))]
        return self._piece(int(backgrounds[rng.integers(len(backgrounds))]))[..., :3]

    def _piece(self, target: int) -> np.ndarray:
        """A stored crop with its mask as fourth channel, (192, 192, 4), decoded once."""
        if target not in self._pieces:
            self._pieces[target] = np.dstack([self.pack.crop(target), self.pack.mask(target)])
        return self._pieces[target]


def blend(below: np.ndarray, above: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Lays an image over another, uint8 (H, W, 3), as far as ``alpha`` says, uint8 (H, W)."""
    weight = cv2.merge([alpha, alpha, alpha])
    return cv2.add(
        cv2.multiply(above, weight, scale=1 / 255),
        cv2.multiply(below, 255 - weight, scale=1 / 255),
    )


def _paste_matrix(center: np.ndarray, scale: float, angle: float) -> np.ndarray:
    """The affine map (2, 3) that brings the middle of a stored crop to a place in another."""
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    linear = np.array([[cosine, -sine], [sine, cosine]])
    middle = np.full(2, (STORED_SIDE - 1) / 2)
    return np.column_stack([linear, center - linear @ middle])


def _window(image: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    """A random window (side, side, 3) of an image, mirrored or not; larger ones are scaled."""
    if side > len(image):
        image = cv2.resize(image, (side, side), interpolation=cv2.INTER_LINEAR)
    y, x = rng.integers(0, len(image) - side + 1, 2)
    window = image[y : y + side, x : x + side]
    return np.ascontiguousarray(window[:, ::-1] if rng.random() < 0.5 else window)
