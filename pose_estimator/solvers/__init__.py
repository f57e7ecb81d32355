"""Pose solvers: from keypoints to a rigid motion.

* 3D-3D: ``rigid.py`` (the three solvers by name), ``soft_ransac.py`` (the paper's solver, and
  Kabsch), ``three_point.py`` (closed-form hypotheses), ``so3.py`` (projection onto SO(3)).
* 2D-3D: ``pnp.py`` (one view), ``multi_view_pnp.py``, ``reprojection.py`` (their residuals).
* 2D-2D: ``triangulation.py`` (least squares), ``linear_triangulation.py`` (DLT).
"""
