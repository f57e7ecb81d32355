"""The estimators, one method a file: ``single``, ``early``, ``late``, ``mid``, ``pnp``, ``rgbd``.

``frontend.py`` detects and encodes views, ``estimator.py`` is the base class, ``one_view.py`` and
``joint_pnp.py`` fit poses to votes, ``loading.py`` loads an estimator with its weights, and
``depth_agreement.py`` tells whether a depth map was of use. The command ``estimate`` is
``estimate_files.py``; ``view_files.py`` reads its input, ``view_checks.py`` doubts it.
"""
