"""Cut-and-paste augmentation of training crops: occluders and backgrounds from other crops.

Objects are cut out by their visible masks and pasted, as in PVNet (Peng et al., CVPR 2019, section
4.1) after Dwibedi et al., "Cut, Paste and Learn", ICCV 2017. The pose of the target in the crop is
unchanged.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ...assets.collage import draw_collage, draw_leaf
from ...core.errors import InputError
from ...core.image_crop import similarity_matrix
from .crops import STORED_SIDE, CropPack

BANK_SIZE = 384
"""Number of crops that are kept decoded, since decoding takes longer than pasting."""

_COLLAGE_SIDE = 320
"""Side of drawn backgrounds in pixels: the width of the detector's frames."""

_MIN_SOURCE_VISIBILITY = 0.7
"""Minimum visibility of a target that is cut out."""

_MIN_VISIBLE_FRACTION = 0.35
"""Minimum fraction of the target's visible pixels that an occluder must leave visible."""


@dataclass(frozen=True)
class CutAndPasteConfig:
    """Probabilities of the augmentation.

    Attributes:
        occlude: probability that another object is pasted over the crop.
        background: probability that everything but the target is replaced.
        collages: fraction of the new backgrounds that are synthetic (``collage``).
    """

    occlude: float = 0.0
    background: float = 0.0
    collages: float = 0.0


class CropPaster:
    """Pastes parts of other crops into a crop.

    An occluder is always another object than the target, and a background comes from a frame
    without the target's object: a second instance would be a wrong label.

    Args:
        pack: the crops.
        targets: indices of the targets that may be cut out.
        config: probabilities.

    Raises:
        InputError: if nothing that is requested is possible: the dataset has one object only, or
            every frame shows all objects.
    """

    def __init__(self, pack: CropPack, targets: np.ndarray, config: CutAndPasteConfig):
        self.pack = pack
        self.config = config
        visible = targets[pack.visibility[targets] >= _MIN_SOURCE_VISIBILITY]
        rng = np.random.default_rng(0)
        self.bank = np.sort(rng.choice(visible, min(BANK_SIZE, len(visible)), replace=False))
        self._pieces: dict[int, np.ndarray] = {}
        drawn = BANK_SIZE if config.collages > 0 else 0
        self._collages = [draw_collage(rng, _COLLAGE_SIDE) for _ in range(drawn)]
        objects, frames = pack.object_index[self.bank], pack.frame_index[self.bank]
        numbers = range(len(pack.object_names))
        self._occluders = [self.bank[objects != number] for number in numbers]
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
        """Augments a crop with the configured probabilities.

        Args:
            crop: RGB uint8 (S, S, 3), around the target.
            mask: its visible mask, uint8 0 to 255 (S, S).
            depth: meters (S, S), 0 = unknown; or None.
            object_index: of the target.
            rng: random generator.

        Returns:
            New crop, mask and depth; the depth of pasted pixels is 0 (unknown).
        """
        backgrounds, occluders = self._backgrounds[object_index], self._occluders[object_index]
        possible = len(backgrounds) or len(self._collages)
        if rng.random() < self.config.background and possible:
            image = self._background(backgrounds, rng)
            crop = blend(_window(image, len(mask), rng), crop, mask)
            depth = None if depth is None else np.where(mask > 127, depth, np.float32(0))
        if rng.random() < self.config.occlude and len(occluders):
            piece = self._piece(int(occluders[rng.integers(len(occluders))]))
            radius, phi = rng.uniform(0.15, 0.45), rng.uniform(0, 2 * np.pi)
            place = np.array([0.5 + radius * np.cos(phi), 0.5 + radius * np.sin(phi)])
            scale, angle = np.exp(rng.uniform(-0.5, 0.2)), rng.uniform(-np.pi, np.pi)
            middle = np.full(2, (STORED_SIDE - 1) / 2)
            affine = similarity_matrix(scale, angle, place * len(mask), middle)
            moved = cv2.warpAffine(piece, affine[:2], mask.shape)
            over = np.ascontiguousarray(moved[..., 3])
            left = cv2.multiply(mask, 255 - over, scale=1 / 255)
            if cv2.sumElems(left)[0] >= _MIN_VISIBLE_FRACTION * cv2.sumElems(mask)[0]:
                crop, mask = blend(crop, np.ascontiguousarray(moved[..., :3]), over), left
                depth = None if depth is None else np.where(over > 0, np.float32(0), depth)
        return crop, mask, depth

    def paste_frame(self, image: np.ndarray, frame: int, rng: np.random.Generator) -> np.ndarray:
        """Puts a synthetic background or distractors behind all targets of a frame of the pack.

        Returns a new image (H, W, 3), or ``image`` itself if nothing is changed.
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
        """Adds distractors with the colors of objects and other shapes.

        Without them a detector takes a red car for LineMOD's ape.
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
        """Draws a square background: synthetic, or one of ``backgrounds``."""
        drawn = self.config.collages > 0 and rng.random() < self.config.collages
        if drawn or not len(backgrounds):
            return self._collages[rng.integers(len(self._collages))]
        return self._piece(int(backgrounds[rng.integers(len(backgrounds))]))[..., :3]

    def _piece(self, target: int) -> np.ndarray:
        """A stored crop with its mask as alpha channel, (192, 192, 4); cached."""
        if target not in self._pieces:
            self._pieces[target] = np.dstack([self.pack.crop(target), self.pack.mask(target)])
        return self._pieces[target]


def blend(below: np.ndarray, above: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Alpha-blends images, uint8 (H, W, 3), with ``alpha``, uint8 (H, W)."""
    weight = cv2.merge([alpha, alpha, alpha])
    return cv2.add(
        cv2.multiply(above, weight, scale=1 / 255),
        cv2.multiply(below, 255 - weight, scale=1 / 255),
    )


def _window(image: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    """A random window (side, side, 3) of an image, enlarged if it is smaller; flipped or not."""
    if side > len(image):
        image = cv2.resize(image, (side, side), interpolation=cv2.INTER_LINEAR)
    y, x = rng.integers(0, len(image) - side + 1, 2)
    window = image[y : y + side, x : x + side]
    return np.ascontiguousarray(window[:, ::-1] if rng.random() < 0.5 else window)
