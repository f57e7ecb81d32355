"""Networks of the agents and their files.

``predictor.py`` predicts the pose error after a second view, ``success_classifier.py`` whether a
pose is correct, ``candidates.py`` makes the predictor a feature extractor of SB3. ``algorithms.py``
lists algorithms and checks hyper-parameters; ``checkpoint.py`` reads and writes agent files.
"""
