"""Training of the networks of every method (the command ``train-estimator``).

Start at ``train_estimator.py``: the order of the stages, from dataset to weights file; its options
are in ``config.py``. ``stages.py`` (detector, 2D features), ``volume_stage.py``,
``cascade_stage.py`` and ``point_stage.py`` hold what each stage draws, its loss and its validation
metrics; ``losses.py`` the paper's losses. ``trainer.py`` is the loop, ``distributed.py`` training
on several processes, ``transfer.py`` starting from other weights.
"""
