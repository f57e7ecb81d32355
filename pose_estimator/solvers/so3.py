"""The rotation nearest to a matrix, with a gradient that stays finite.

Horn's closed form (Journal of the Optical Society of America A, 1987): the entries of a rotation
are quadratic forms in its unit quaternion, hence so is the trace of R^T M, and the eigenvector of
its largest eigenvalue is the quaternion of the nearest rotation. Unlike with a
singular value decomposition, no determinant correction is needed, and it takes half the time.
"""

from functools import lru_cache
from typing import Any

import torch
from torch.autograd.function import once_differentiable


def project_to_so3(matrices: torch.Tensor) -> torch.Tensor:
    """The rotations nearest to matrices (..., 3, 3) in the Frobenius norm.

    The gradient is that of the polar decomposition. Unlike the quaternion's it is finite at equal
    singular values, where averages of rotations are.
    """
    if torch.is_grad_enabled() and matrices.requires_grad:
        return _ProjectToSO3.apply(matrices)
    return _nearest(matrices)


def _nearest(matrices: torch.Tensor) -> torch.Tensor:
    forms = _quadratic_forms(matrices.dtype, matrices.device)
    trace = (matrices.reshape(-1, 9) @ forms).view(-1, 4, 4)
    quaternion = torch.linalg.eigh(trace).eigenvectors[..., -1]
    products = quaternion[:, :, None] * quaternion[:, None]
    return (products.view(-1, 16) @ forms.T).view(matrices.shape)


class _ProjectToSO3(torch.autograd.Function):
    """M = R P with R a rotation and P symmetric; see ``project_to_so3``."""

    @staticmethod
    def forward(ctx: Any, matrices: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        rotation = _nearest(matrices)
        ctx.save_for_backward(rotation, matrices)
        return rotation

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        rotation, matrices = ctx.saved_tensors
        back = rotation.transpose(-1, -2)
        stretch, axes = torch.linalg.eigh(back @ matrices)
        # dR = R W with W skew and W P + P W = R^T dM - dM^T R; in the basis of P's eigenvectors
        # the left side is W_ij (p_i + p_j). A sum near zero means the rotation about that axis is
        # undefined; its gradient is bounded.
        sums = stretch[..., :, None] + stretch[..., None, :]
        sums = sums.clamp_min(1e-12).maximum(1e-3 * stretch[..., -1:, None])
        inner = axes.transpose(-1, -2) @ back @ grad @ axes
        skew = (inner - inner.transpose(-1, -2)) / sums
        return rotation @ axes @ skew @ axes.transpose(-1, -2)


@lru_cache(maxsize=16)
def _quadratic_forms(dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Quadratic forms (9, 16) of a rotation's entries, by row, in its quaternion (w, x, y, z)."""
    # Tensors made in inference mode cannot be used in training.
    with torch.inference_mode(False):
        forms = torch.zeros(3, 3, 4, 4, dtype=dtype, device="cpu")
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            p, q, r = 1 + i, 1 + j, 1 + k
            signs = torch.tensor([1, 1, -1, -1], dtype=dtype, device="cpu")
            forms[i, i, [0, p, q, r], [0, p, q, r]] = signs
            for row, column, sign in ((i, j, -1), (j, i, 1)):  # 2 (q_p q_q -+ w q_r)
                forms[row, column, [p, q], [q, p]] = 1
                forms[row, column, [0, r], [r, 0]] = sign
        return forms.view(9, 16).to(device)
