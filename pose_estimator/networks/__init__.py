"""Networks of all methods, in PyTorch.

* ``features.py`` (2D features and votes of a crop), on ``encoder.py`` and ``decoder.py``, read by
  ``voting.py``; ``detector.py`` finds objects in a frame.
* One network for each fusion: ``cascade.py`` on ``plane_sweep.py`` (early), ``volume.py`` (mid),
  ``point_voting.py`` on ``point_cloud.py`` (rgbd).
* ``container.py`` holds them; ``weights.py`` and ``quantization.py`` store them; ``inference.py``
  and ``fused.py`` run them.
"""
