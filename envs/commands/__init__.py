"""Commands that need both the simulator and the pose estimator.

``evaluate.py`` and ``compare.py`` render their test data first (``study_data.py`` has the study's);
``doctor.py`` checks the installation.
"""
