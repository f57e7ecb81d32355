"""Training losses: heat maps, boxes, vector fields, keypoint distributions and poses."""

import torch
from torch import Tensor
from torch.nn import functional as F

from ..networks.features import Features2D


def heat_map_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """CenterNet's focal loss (Zhou et al. 2019, equation 1), mean over the batch.

    Args:
        logits: (B, N, H, W).
        heat: (B, N, H, W) targets in 0..1, exactly 1 at the centers.
    """
    probability = torch.sigmoid(logits).clamp(1e-5, 1 - 1e-5)
    positive = heat >= 0.999
    at_center = -torch.log(probability) * (1 - probability) ** 2
    elsewhere = -torch.log(1 - probability) * probability**2 * (1 - heat) ** 4
    total = torch.where(positive, at_center, elsewhere).sum()
    return total / positive.sum().clamp(min=1)


def box_loss(regression: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """L1 loss of center offset and size where ``weight`` (B, N, H, W) is set."""
    difference = (regression - target).abs() * weight.unsqueeze(2)
    return difference.sum() / (3 * weight.sum()).clamp(min=1)


def direction_loss(directions: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """PVNet's smooth L1 loss of the unit vectors, over the object's visible pixels.

    Args:
        directions: (B, 9, 2, G, G) raw vectors.
        target: (B, 9, 2, G, G) unit vectors.
        mask: (B, G, G) weights, 1 on the object.
    """
    difference = F.smooth_l1_loss(directions, target, reduction="none", beta=0.2)
    weighted = difference.sum(2).mean(1) * mask
    # Each crop counts the same, however little of the object it shows.
    return (weighted.sum((1, 2)) / mask.sum((1, 2)).clamp(min=8)).mean()


def features_loss(
    out: Features2D, mask: Tensor, directions: Tensor
) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of mask and vector field, and its terms.

    Args:
        out: of B crops.
        mask: (B, G, G) covered fraction of each cell by the visible object.
        directions: (B, 9, 2, G, G) target unit vectors.
    """
    mask_loss = F.binary_cross_entropy_with_logits(out.mask_logits.float(), mask)
    direction = direction_loss(out.directions.float(), directions, (mask > 0.4).float())
    return mask_loss + 2 * direction, {"mask": mask_loss, "direction": direction}


def distribution_loss(
    log_probability: Tensor,
    cells: Tensor,
    keypoints: Tensor,
    sigma: Tensor,
    *,
    predicted_first: bool = False,
) -> Tensor:
    """KL divergence between predicted distributions Q_v and Gaussians Q_k at the true keypoints.

    Args:
        log_probability: (B, 9, V) predicted, normalized over V voxels.
        cells: (B, V, 3) voxel centers, m.
        keypoints: (B, 9, 3) true keypoints, m.
        sigma: (B,) standard deviation of the target, m.
        predicted_first: D(Q_v || Q_k), as the paper has it, instead of D(Q_k || Q_v), which has
            gradients wherever the truth is.
    """
    distance = torch.cdist(keypoints, cells)
    target = torch.log_softmax(-0.5 * (distance / sigma[:, None, None]) ** 2, -1)
    first, second = (log_probability, target) if predicted_first else (target, log_probability)
    return (first.exp() * (first - second)).sum(-1).mean()


def keypoint_loss(predicted: Tensor, keypoints: Tensor, scale: Tensor) -> Tensor:
    """Mean distance of keypoints (B, 9, 3) in units of ``scale`` (B,), usually the diameter."""
    distance = torch.linalg.vector_norm(predicted - keypoints, dim=-1)
    return (distance / scale[:, None]).mean()


def pose_loss(
    rotation: Tensor, translation: Tensor, T_true: Tensor, scale: Tensor, alpha: float = 0.3
) -> Tensor:
    """The paper's pose loss, |t - t'| + alpha |R'R^T - I|_F, with t in units of ``scale``.

    Args:
        rotation: (B, 3, 3) predicted.
        translation: (B, 3) predicted, m.
        T_true: (B, 4, 4).
        scale: (B,), m.
        alpha: weight of the rotation.
    """
    shift = torch.linalg.vector_norm(translation - T_true[:, :3, 3], dim=-1) / scale
    identity = torch.eye(3, dtype=rotation.dtype, device=rotation.device)
    rotation_error = torch.linalg.matrix_norm(
        T_true[:, :3, :3] @ rotation.transpose(1, 2) - identity
    )
    return (shift + alpha * rotation_error).mean()
